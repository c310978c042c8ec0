"""The kinds of motion of the emulated controller: one module for each, all of one shape.

A motion is given the set-point of the last cycle and makes the next one. It refuses to go on by
raising `Trouble`, of which the controller makes a protective stop.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from cell.errors import BackendError
from hil.emulator.interfaces import PERIOD

HARD = 30.0
"""Joint deceleration of stops [rad/s^2]: leaves room below the 40 rad/s^2 that clients may ask for, for
what the path's curvature adds."""
SOFT = 15.0
"""Joint deceleration when a command runs out or another one takes over [rad/s^2]."""
DT = PERIOD

Step = tuple[list[float], list[float], bool]
"""Joint angles [rad], joint speeds [rad/s], and whether there is more to come."""


class Trouble(BackendError):
    """A motion cannot go on; the message says why."""


class Motion(Protocol):
    """One commanded motion.

    Attributes:
        checked: its joint angles were checked beforehand, and it ends in time by itself.
    """

    checked: bool

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        """The next set-point after q [rad], qd [rad/s], with moves slowed down to `scaling`.

        Raises:
            Trouble: there is none.
        """
        ...


def towards(value: Sequence[float], target: Sequence[float], step: float) -> list[float]:
    """`target`, or as far on the straight line there as the largest component may change by `step`."""
    change = [b - a for a, b in zip(value, target, strict=True)]
    largest = max(abs(c) for c in change)
    if largest <= step:
        return [float(v) for v in target]
    k = step / largest
    return [a + k * c for a, c in zip(value, change, strict=True)]


def advance(q: Sequence[float], before: Sequence[float], after: Sequence[float]) -> list[float]:
    """Joint angles one cycle on, while the speed changes evenly."""
    return [a + 0.5 * DT * (b + c) for a, b, c in zip(q, before, after, strict=True)]
