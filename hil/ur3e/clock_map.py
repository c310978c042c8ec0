"""A device's clock in terms of ours: its stamps, moved by the least delayed of recent samples."""

from __future__ import annotations

import math

_BUCKET = 2.0
"""The least delay of the present and the last stretch of so many seconds counts [s]."""


class ClockMap:
    """Maps stamps of one device, whose clock may drift and may start again, to the wall clock.

    Args:
        longest: delays that differ by more are no delays: the device's clock stood still meanwhile [s].
    """

    def __init__(self, longest: float) -> None:
        self._longest = longest
        self._newest = -math.inf
        self._restart(0.0)

    def _restart(self, seen: float) -> None:
        self._since = seen
        self._now = self._before = math.inf

    def to_wall(self, stamp: float, seen: float) -> float:
        """When, by our clock, the device's clock showed `stamp`; the sample was seen at `seen` [s]."""
        if stamp < self._newest - 1e-9:  # the device was started again
            self._restart(seen)
        self._newest = stamp
        if seen - self._since > _BUCKET:
            self._since, self._before, self._now = seen, self._now, math.inf
        if seen - stamp - min(self._now, self._before) > self._longest and self._now < math.inf:
            self._restart(seen)
        self._now = min(self._now, seen - stamp)
        return stamp + min(self._now, self._before)
