"""When a path is where: straight stretches with trapezoidal speed, corners passed at constant speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Stretch:
    """A straight part of a path.

    Attributes:
        length: [m] or [rad] of path.
        speed, acceleration: largest, of path.
    """

    length: float
    speed: float
    acceleration: float


@dataclass(frozen=True)
class Corner:
    """The round part between two stretches, passed at constant speed.

    Attributes:
        length: of path; 0 for a stop on the waypoint.
        speed: largest, of path.
    """

    length: float
    speed: float


class TimeLaw:
    """Path length and path speed over time.

    Args:
        stretches: N of them. corners: the N - 1 between them.

    Attributes:
        duration: [s]. length: of the whole path.
    """

    def __init__(self, stretches: Sequence[Stretch], corners: Sequence[Corner]) -> None:
        speeds = _node_speeds(stretches, corners)
        self._pieces: list[tuple[float, float, float, float]] = []
        """Start time [s], path length, path speed and path acceleration at it."""
        self.duration = self.length = 0.0
        self._at = 0
        for k, stretch in enumerate(stretches):
            self._stretch(stretch, speeds[k], speeds[k + 1])
            if k < len(corners) and corners[k].length > 0.0:
                self._piece(corners[k].length / speeds[k + 1], speeds[k + 1], 0.0, corners[k].length)

    def at(self, t: float) -> tuple[float, float]:
        """Path length and path speed at `t` [s]; quickest where `t` moves on little by little."""
        if t >= self.duration:
            return self.length, 0.0
        pieces = self._pieces
        while self._at + 1 < len(pieces) and pieces[self._at + 1][0] <= t:
            self._at += 1
        while self._at > 0 and pieces[self._at][0] > t:
            self._at -= 1
        start, s, v, a = pieces[self._at]
        dt = t - start
        return s + dt * (v + 0.5 * a * dt), v + a * dt

    def _stretch(self, stretch: Stretch, v0: float, v1: float) -> None:
        a = stretch.acceleration
        peak = min(stretch.speed, math.sqrt(max(a * stretch.length + 0.5 * (v0 * v0 + v1 * v1), 0.0)))
        peak = max(peak, v0, v1)
        up, down = (peak * peak - v0 * v0) / (2 * a), (peak * peak - v1 * v1) / (2 * a)
        rest = stretch.length - up - down
        self._piece((peak - v0) / a, v0, a, up)
        if rest > 0.0:
            self._piece(rest / peak, peak, 0.0, rest)
        self._piece((peak - v1) / a, peak, -a, down)

    def _piece(self, duration: float, v: float, a: float, length: float) -> None:
        if duration > 0.0:
            self._pieces.append((self.duration, self.length, v, a))
            self.duration += duration
            self.length += length


def _node_speeds(stretches: Sequence[Stretch], corners: Sequence[Corner]) -> list[float]:
    """Speeds at the ends of the stretches that both neighbours can reach: forward, then backward."""
    out = [0.0, *(c.speed if c.length > 0.0 else 0.0 for c in corners), 0.0]
    for k, s in enumerate(stretches):
        out[k + 1] = min(out[k + 1], math.sqrt(out[k] ** 2 + 2 * s.acceleration * s.length))
    for k in range(len(stretches) - 1, -1, -1):
        s = stretches[k]
        out[k] = min(out[k], math.sqrt(out[k + 1] ** 2 + 2 * s.acceleration * s.length))
    return out


def for_duration(length: float, acceleration: float, duration: float) -> tuple[float, float]:
    """Speed and acceleration with which a path from rest to rest takes a given time [s].

    The acceleration given is kept if it suffices, otherwise the smallest that does is taken.
    """
    root = (acceleration * duration) ** 2 - 4 * acceleration * length
    if acceleration <= 0.0 or root < 0.0:
        return 2 * length / duration, 4 * length / duration**2
    return 0.5 * (acceleration * duration - math.sqrt(root)), acceleration
