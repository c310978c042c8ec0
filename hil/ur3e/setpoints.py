"""From the node's set-points (125 Hz) to the controller's (500 Hz). Pure, plain floats.

Every set-point says when it is to be reached. Between two the arm follows a cubic Hermite segment;
past the newest one it goes on at that one's speed, for the short time until the next arrives or the
driver brakes. Everything is played a little late, so that a node that is a few milliseconds late
is not noticed at all.
"""

from __future__ import annotations

import math

from hil.ur3e.block import Six

PLAY_DELAY = 0.004
"""How much later than ordered set-points are played [s]."""
_START_TOLERANCE = 0.02
"""The first set-point lies at most this far from the measured joints [rad]."""
_SPEED_TOLERANCE = 1.1
_SLACK = 2e-3
"""For rounding and for braking on the path [rad]."""


class SetPoints:
    """The set-points that are being followed.

    Args:
        q_max, qd_max: limits [rad], [rad/s].

    Attributes:
        newest: when the newest is to be reached [s]; -infinity before the first.
    """

    def __init__(self, q_max: Six, qd_max: Six) -> None:
        self._q_max, self._qd_max = q_max, qd_max
        self.clear()

    def clear(self) -> None:
        """Forget all: the next one is a first one."""
        self.newest = -math.inf
        self._t0 = 0.0
        self._q0: Six | None = None
        self._qd0: Six = (0.0,) * 6
        self._q1: Six = (0.0,) * 6
        self._qd1: Six = (0.0,) * 6

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
        if self._q0 is None:
            gap = max(abs(a - b) for a, b in zip(q, measured, strict=True))
            if gap > _START_TOLERANCE:
                return f"the first set-point lies {gap:.3f} rad away from the joints"
            self._t0, self._q0, self._qd0 = t, q, qd
        elif t <= self.newest:
            return ""  # the same one again
        else:
            elapsed = t - self.newest
            for i in range(6):
                jump = abs(q[i] - self._q1[i])
                if jump > _SPEED_TOLERANCE * self._qd_max[i] * elapsed + _SLACK:
                    return f"joint {i + 1} is told to jump by {jump:.3f} rad in {elapsed * 1e3:.0f} ms"
            self._t0, self._q0, self._qd0 = self.newest, self._q1, self._qd1
        self.newest, self._q1, self._qd1 = t, q, qd
        return ""

    def at(self, t: float) -> Six:
        """Joints [rad] at `t` [s]; raises ValueError before the first set-point."""
        if self._q0 is None:
            raise ValueError("there is no set-point yet")
        t -= PLAY_DELAY
        if t >= self.newest:
            ahead = t - self.newest
            a, b, c, d, e, f = self._q1
            va, vb, vc, vd, ve, vf = self._qd1
            return (
                a + va * ahead, b + vb * ahead, c + vc * ahead, d + vd * ahead, e + ve * ahead, f + vf * ahead
            )  # fmt: skip
        if t <= self._t0:
            return self._q0
        h = self.newest - self._t0
        s = (t - self._t0) / h
        w1 = s * s * (3.0 - 2.0 * s)
        w0 = 1.0 - w1
        m0 = h * s * (1.0 - s) * (1.0 - s)
        m1 = h * s * s * (s - 1.0)
        p0, p1, v0, v1 = self._q0, self._q1, self._qd0, self._qd1
        q = [w0 * p0[i] + w1 * p1[i] + m0 * v0[i] + m1 * v1[i] for i in range(6)]
        return q[0], q[1], q[2], q[3], q[4], q[5]
