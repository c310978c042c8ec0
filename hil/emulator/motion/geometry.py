"""Where a path is: lines, corners and arcs in the space of the joints or of the tool.

Each piece is parametrised by path length x from its start. In joint space that is the angle of the
joint that turns furthest [rad]; in tool space the way of the TCP [m], or its turn [rad] where that
is the larger number. Corners are parabolas: the rate of change goes evenly from that of one line to
that of the next, so a constant path speed means a constant acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hil.emulator.poses import (
    Frame,
    Quaternion,
    Vector,
    axes,
    conjugate,
    cross,
    dot,
    from_rotvec,
    multiply,
    norm,
    quaternion,
    rotvec,
    slerp,
)

Sixfold = list[float]
_TINY = 1e-9


class JointLine:
    """Straight in joint space from q0 to q1.

    Attributes:
        rate: change of the joints per path length, shape (6,).
    """

    def __init__(self, q0: Sequence[float], q1: Sequence[float]) -> None:
        way = [b - a for a, b in zip(q0, q1, strict=True)]
        self.length = max(abs(w) for w in way)
        self.end = [float(v) for v in q1]
        self._q0 = [float(v) for v in q0]
        self.rate = [w / self.length for w in way] if self.length > _TINY else [0.0] * 6

    def at(self, x: float) -> tuple[Sixfold, Sixfold]:
        """Joint angles and their change per path length."""
        if x >= self.length:
            return list(self.end), self.rate
        return [q + x * r for q, r in zip(self._q0, self.rate, strict=True)], self.rate


class JointCorner:
    """From `cut` before the end of one line to `cut` after the start of the next."""

    def __init__(self, before: JointLine, after: JointLine, cut: float) -> None:
        self.length = 2 * cut
        self._start = before.at(before.length - cut)[0]
        self._r0, self._r1 = before.rate, after.rate
        self.bend = max(abs(b - a) for a, b in zip(self._r0, self._r1, strict=True))
        """Change of the rate over the corner."""

    def at(self, x: float) -> tuple[Sixfold, Sixfold]:
        u = x / self.length
        rate = [a + u * (b - a) for a, b in zip(self._r0, self._r1, strict=True)]
        q = [s + x * (a + 0.5 * u * (b - a)) for s, a, b in zip(self._start, self._r0, self._r1, strict=True)]
        return q, rate


class ToolLine:
    """The TCP straight from one frame to another, turning evenly.

    Attributes:
        rate: twist per path length, shape (6,).
    """

    def __init__(self, start: Frame, end: Frame) -> None:
        p0, p1 = start[0], end[0]
        way = (p1[0] - p0[0], p1[1] - p0[1], p1[2] - p0[2])
        self.p0, self.p1 = p0, p1
        self.r0, self.r1 = quaternion(start), quaternion(end)
        turn = rotvec(multiply(self.r1, conjugate(self.r0)))
        self.length = max(norm(way), norm(turn))
        k = 1.0 / self.length if self.length > _TINY else 0.0
        self.rate = [k * v for v in (*way, *turn)]

    def at(self, x: float) -> tuple[Frame, Sixfold]:
        """Frame of the TCP and its twist per path length."""
        r, (a, b, c) = self.rate, self.p0
        turn = multiply(from_rotvec((x * r[3], x * r[4], x * r[5])), self.r0)
        return ((a + x * r[0], b + x * r[1], c + x * r[2]), *axes(turn)), r


class ToolCorner:
    """As `JointCorner`, for the TCP. The turn goes the way of a Bezier curve through three turns."""

    def __init__(self, before: ToolLine, after: ToolLine, cut: float) -> None:
        self.length = 2 * cut
        start, _ = before.at(before.length - cut)
        end, _ = after.at(cut)
        self._p = start[0]
        self._turns = quaternion(start), before.r1, quaternion(end)
        self._r0, self._r1 = before.rate, after.rate
        bend = [b - a for a, b in zip(self._r0, self._r1, strict=True)]
        self.bend = max(norm(bend[:3]), norm(bend[3:]))

    def at(self, x: float) -> tuple[Frame, Sixfold]:
        u, h = x / self.length, 1e-4
        turn = self._turn(u)
        before, after = self._turn(u - h), self._turn(u + h)
        spin = rotvec(multiply(after, conjugate(before)))
        k = 1.0 / (2 * h * self.length)
        r0, r1 = self._r0, self._r1
        p = [s + x * (a + 0.5 * u * (b - a)) for s, a, b in zip(self._p, r0[:3], r1[:3], strict=True)]
        move = [a + u * (b - a) for a, b in zip(r0[:3], r1[:3], strict=True)]
        return ((p[0], p[1], p[2]), *axes(turn)), [*move, *(k * v for v in spin)]

    def _turn(self, u: float) -> Quaternion:
        a, b, c = self._turns
        return slerp(slerp(a, b, u), slerp(b, c, u), u)


class ToolArc:
    """The TCP on the circle from one frame through a point to another frame, turning evenly."""

    def __init__(self, start: Frame, via: Vector, end: Frame) -> None:
        a, b = _minus(via, start[0]), _minus(end[0], start[0])
        n = cross(a, b)
        size = dot(n, n)
        if size < _TINY**2:
            raise ValueError("the three points of an arc lie on one line")
        # Centre of the circle through three points, from the first of them.
        k = 0.5 / size
        u, v = cross(n, a), cross(b, n)
        c = [k * (dot(b, b) * u[i] + dot(a, a) * v[i]) for i in range(3)]
        centre = (start[0][0] + c[0], start[0][1] + c[1], start[0][2] + c[2])
        spoke = _minus(start[0], centre)
        self._radius = norm(spoke)
        m = math.sqrt(size)
        axis = (n[0] / m, n[1] / m, n[2] / m)
        self._centre, self._x = centre, spoke
        self._y = cross(axis, spoke)
        last = _minus(end[0], centre)
        self._angle = math.atan2(dot(last, self._y), dot(last, spoke)) % (2 * math.pi)
        self._r0 = quaternion(start)
        self._turn = rotvec(multiply(quaternion(end), conjugate(self._r0)))
        self.length = self._radius * self._angle
        self.r1 = quaternion(end)

    def at(self, x: float) -> tuple[Frame, Sixfold]:
        u = x / self.length
        c, s = math.cos(u * self._angle), math.sin(u * self._angle)
        o, e, f = self._centre, self._x, self._y
        p = (o[0] + c * e[0] + s * f[0], o[1] + c * e[1] + s * f[1], o[2] + c * e[2] + s * f[2])
        k = 1.0 / self._radius
        move = [k * (c * f[i] - s * e[i]) for i in range(3)]
        t = self._turn
        turn = multiply(from_rotvec((u * t[0], u * t[1], u * t[2])), self._r0)
        return (p, *axes(turn)), [*move, *(v / self.length for v in t)]


def _minus(a: Sequence[float], b: Sequence[float]) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]
