"""From the node's set-points (125 Hz) to the controller's (500 Hz). Pure, plain floats.

Every set-point says when it is to be reached. Between two the arm follows a cubic Hermite segment;
past the newest one it goes on at that one's speed, for the short time until the next arrives or the
driver brakes. Everything is played a little late, so that a node that is a few milliseconds late
is not noticed at all.
"""

from __future__ import annotations

import math
from collections import deque

from hil.ur3e.block import Six

PLAY_DELAY = 0.004
"""How much later than ordered set-points are played [s]."""
_START_TOLERANCE = 0.02
"""The first set-point lies at most this far from the measured joints [rad]."""
_SPEED_TOLERANCE = 1.1
_SLACK = 2e-3
"""For rounding and for braking on the path [rad]."""
CATCH_UP = 1.03
"""How much faster than ordered the arm moves while it makes up for cycles that the driver missed.

Plans keep `motion.speed_margin` of the tool's cap, and this takes less than they leave."""
_KEPT = 8
"""Set-points that are remembered: those still to be played, also after a burst."""


class SetPoints:
    """The set-points that are being followed.

    Args:
        q_max, qd_max: limits [rad], [rad/s].

    Attributes:
        newest: when the newest is to be reached [s]; -infinity before the first.
        played: for which time set-points were last asked for by `play` [s]; -infinity before that.
    """

    def __init__(self, q_max: Six, qd_max: Six) -> None:
        self._q_max, self._qd_max = q_max, qd_max
        self.clear()

    def clear(self) -> None:
        """Forget all: the next one is a first one."""
        self.newest = self.played = -math.inf
        self._points: deque[tuple[float, Six, Six]] = deque(maxlen=_KEPT)

    def push(self, t: float, q: Six, qd: Six, measured: Six) -> str:
        """Take in a set-point to be reached at `t` [s]; what makes it implausible, else empty.

        Args:
            measured: joints now [rad]; a first set-point must lie there.
        """
        if not all(map(math.isfinite, (t, *q, *qd))):
            return "a set-point is not finite"
        for i in range(6):
            if abs(q[i]) > self._q_max[i] + _SLACK:
                return f"joint {i + 1} is told to go to {q[i]:.3f} rad"
            if abs(qd[i]) > _SPEED_TOLERANCE * self._qd_max[i]:
                return f"joint {i + 1} is told to move at {qd[i]:.2f} rad/s"
        if not self._points:
            gap = max(abs(a - b) for a, b in zip(q, measured, strict=True))
            if gap > _START_TOLERANCE:
                return f"the first set-point lies {gap:.3f} rad away from the joints"
        elif t <= self.newest:
            return ""  # the same one again
        else:
            elapsed, before = t - self.newest, self._points[-1][1]
            for i in range(6):
                jump = abs(q[i] - before[i])
                if jump > _SPEED_TOLERANCE * self._qd_max[i] * elapsed + _SLACK:
                    return f"joint {i + 1} is told to jump by {jump:.3f} rad in {elapsed * 1e3:.0f} ms"
        self.newest = t
        self._points.append((t, q, qd))
        return ""

    def play(self, now: float, period: float) -> Six:
        """Joints [rad] to send in the cycle at `now` [s], `period` [s] after the last if none was missed.

        After missed cycles the arm does not jump to where it should be: it catches up, a little faster.
        """
        late = self.played + CATCH_UP * period
        self.played = min(now, late) if self.played > -math.inf else now
        return self.at(self.played)

    def at(self, t: float) -> Six:
        """Joints [rad] at `t` [s]; raises ValueError before the first set-point."""
        if not self._points:
            raise ValueError("there is no set-point yet")
        t -= PLAY_DELAY
        t1, p1, v1 = self._points[-1]
        if t >= t1:
            ahead = t - t1
            return _six([p1[i] + v1[i] * ahead for i in range(6)])
        for k in range(len(self._points) - 2, -1, -1):
            t0, p0, v0 = self._points[k]
            if t >= t0:
                h = t1 - t0
                s = (t - t0) / h
                w1 = s * s * (3.0 - 2.0 * s)
                w0 = 1.0 - w1
                m0 = h * s * (1.0 - s) * (1.0 - s)
                m1 = h * s * s * (s - 1.0)
                return _six([w0 * p0[i] + w1 * p1[i] + m0 * v0[i] + m1 * v1[i] for i in range(6)])
            t1, p1, v1 = t0, p0, v0
        return p1


def _six(values: list[float]) -> Six:
    a, b, c, d, e, f = values
    return a, b, c, d, e, f
