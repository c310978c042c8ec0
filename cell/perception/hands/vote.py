"""A sign counts when it was seen often enough, lately, and without its opposite."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from cell.perception.hands.gesture import Gesture


@dataclass(frozen=True)
class VoteConfig:
    """When a sign counts.

    Attributes:
        votes, window: so many of the last `window` images must show the sign.
        hold: shortest time from the first to the last of those images [s].
        gap: longest time between two images; a longer one forgets everything [s].
        release: images in a row without the sign after which it is over.
    """

    votes: int = 3
    window: int = 5
    hold: float = 0.15
    gap: float = 0.35
    release: int = 3

    def __post_init__(self) -> None:
        if not (0 < self.votes <= self.window and self.hold >= 0 and self.gap > 0 and self.release > 0):
            raise ValueError(f"votes: need 0 < votes <= window, hold >= 0, gap > 0, release > 0; got {self}")


class GestureVote:
    """The sign of one hand over time.

    Attributes:
        gesture: the sign that counts now, or NONE.
    """

    def __init__(self, config: VoteConfig | None = None) -> None:
        self._config = config or VoteConfig()
        self._seen: deque[tuple[float, Gesture]] = deque(maxlen=self._config.window)
        self.gesture = Gesture.NONE

    def reset(self) -> None:
        """Forget everything."""
        self._seen.clear()
        self.gesture = Gesture.NONE

    def push(self, t: float, reading: Gesture, allowed: bool) -> Gesture:
        """Take in one image.

        Args:
            t: when it was taken [s]. One that is not newer than the last is ignored.
            reading: its sign; NONE also when no hand was found.
            allowed: whether a sign makes sense now (no onion in the hand, hand high enough).
                If not, everything is forgotten.

        Returns:
            The sign that counts now; NONE when in doubt, and while both signs were seen.
        """
        if self._seen and t <= self._seen[-1][0]:
            return self.gesture
        if not allowed or (self._seen and t - self._seen[-1][0] > self._config.gap):
            self.reset()
        if not allowed:
            return self.gesture
        self._seen.append((t, reading))
        up, down = ([s for s, g in self._seen if g is sign] for sign in (Gesture.UP, Gesture.DOWN))
        if up and down:
            self.gesture = Gesture.NONE
            return self.gesture
        times, sign = (up, Gesture.UP) if up else (down, Gesture.DOWN)
        last = [g for _, g in self._seen][-self._config.release :]
        if len(times) >= self._config.votes and times[-1] - times[0] >= self._config.hold - 1e-9:
            self.gesture = sign
        elif self.gesture is not Gesture.NONE and self.gesture not in last:
            self.gesture = Gesture.NONE
        return self.gesture
