"""Joint splines that are appended one by one: the points of a forwarded trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hil.emulator.motion import DT, Step

_ROUNDING = 1e-9
_CREEPING = 1e-5
"""Time at which a slowed down end counts as reached [s]."""
_SLOWING = 15.0
"""Deceleration before the end of a trajectory whose last point is not at rest [rad/s^2]."""
_FASTEST = 6.283185
"""Joint speed from which the way to slow down is reckoned [rad/s]."""


@dataclass(frozen=True)
class _Segment:
    start: float
    duration: float
    coefficients: tuple[tuple[float, ...], ...]
    """c0..c5 of each joint."""
    end: tuple[float, ...]
    end_speed: tuple[float, ...]
    last: bool


class Spline:
    """Cubic or quintic polynomials in time, which the speed slider stretches.

    Args:
        q, qd: where it starts from [rad], [rad/s].
    """

    checked = False

    def __init__(self, q: Sequence[float], qd: Sequence[float]) -> None:
        self._end, self._speed, self._bend = list(q), list(qd), [0.0] * 6
        self._segments: list[_Segment] = []
        self._t = self._total = 0.0
        self._rate = 1.0 if any(qd) else 0.0
        self._slow: float | None = None

    @property
    def left(self) -> float:
        """Time until the last point that it knows [s]."""
        return self._total - self._t

    @property
    def end(self) -> list[float]:
        """The last point that it knows [rad]."""
        return self._end

    def append(
        self, q: Sequence[float], qd: Sequence[float], qdd: Sequence[float] | None, t: float, last: bool
    ) -> None:
        """Go on to q [rad] with speed qd [rad/s] within t > 0 [s]; without qdd [rad/s^2] by a cubic."""
        rows = []
        for i in range(6):
            p, v, a = self._end[i], self._speed[i], self._bend[i]
            d = q[i] - p
            if qdd is None:
                c2 = (3 * d - (2 * v + qd[i]) * t) / t**2
                c3 = (-2 * d + (v + qd[i]) * t) / t**3
                rows.append((p, v, c2, c3, 0.0, 0.0))
            else:
                b = qdd[i]
                c3 = (20 * d - (8 * qd[i] + 12 * v) * t - (3 * a - b) * t**2) / (2 * t**3)
                c4 = (-30 * d + (14 * qd[i] + 16 * v) * t + (3 * a - 2 * b) * t**2) / (2 * t**4)
                c5 = (12 * d - 6 * (qd[i] + v) * t - (a - b) * t**2) / (2 * t**5)
                rows.append((p, v, 0.5 * a, c3, c4, c5))
        self._end, self._speed = [float(v) for v in q], [float(v) for v in qd]
        self._bend = [0.0] * 6 if qdd is None else [float(v) for v in qdd]
        self._segments.append(
            _Segment(self._total, t, tuple(rows), tuple(self._end), tuple(self._speed), last)
        )
        self._total += t

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        rate = scaling * self._slowed(max(abs(v) for v in qd))
        self._t += 0.5 * DT * (self._rate + rate)
        self._rate = rate
        if self.left <= (_ROUNDING if self._slow is None else _CREEPING):
            self._t = self._total
            speed = [0.0] * 6 if self._segments[-1].last else [rate * v for v in self._speed]
            return list(self._end), speed, False
        while self._segments[0].start + self._segments[0].duration <= self._t:
            self._segments.pop(0)
        segment = self._segments[0]
        t = self._t - segment.start
        place, speed = [], []
        for c0, c1, c2, c3, c4, c5 in segment.coefficients:
            place.append(c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))))
            speed.append(rate * (c1 + t * (2 * c2 + t * (3 * c3 + t * (4 * c4 + t * 5 * c5)))))
        return place, speed, True

    def _slowed(self, fastest: float) -> float:
        """Share of the pace at which the last segment can still come to rest at its end."""
        segment = self._segments[-1]
        if not segment.last or not any(segment.end_speed):
            return 1.0
        left = self.left
        if self._slow is None and left < _FASTEST / _SLOWING and fastest > (left - DT) * _SLOWING:
            self._slow = left + DT
        if self._slow is None:
            return 1.0
        return max(left / self._slow, 1e-3)
