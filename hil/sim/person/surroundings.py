"""What a person can see of the cell; the simulated world's own is `sight.Sight`."""

from __future__ import annotations

from typing import Protocol

from cell.frames import Array


class Surroundings(Protocol):
    """What a person can see of the cell."""

    signal: str

    def count(self) -> int:
        """Number of onions of the batch."""
        ...

    def place(self, onion: int) -> Array:
        """Centre of an onion in the world (3,) [m]."""
        ...

    def radius(self, onion: int) -> float:
        """[m]."""
        ...

    def free(self, onion: int) -> bool:
        """It lies on the belt, and the robot neither holds it nor has dealt with it."""
        ...

    def shows_blemish(self, onion: int, p_WE: Array) -> bool:
        """A blemish is on the side that eyes at `p_WE` see."""
        ...

    def blemished(self, onion: int) -> bool:
        """A blemish is anywhere."""
        ...

    def tool(self) -> Array:
        """The robot's tool centre point (3,) [m]."""
        ...
