"""Rigid frames and rotations as tuples of plain floats.

The controller handles a few small vectors 500 times a second, and numpy's overhead per call is far
above the arithmetic. A `Frame` is a position and the three axes of a rotation matrix.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

Vector = tuple[float, float, float]
Frame = tuple[Vector, Vector, Vector, Vector]
"""Origin [m] and the x, y and z axes of a frame, each in the axes of its parent."""
Quaternion = tuple[float, float, float, float]
"""w, x, y, z."""

IDENTITY: Frame = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_TINY = 1e-12


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Inner product of two vectors of 3."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def norm(a: Sequence[float]) -> float:
    """Length of a vector of 3."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def turn(frame: Frame, v: Sequence[float]) -> Vector:
    """A direction given in the axes of `frame`, in those of its parent."""
    _, x, y, z = frame
    a, b, c = v[0], v[1], v[2]
    return (
        x[0] * a + y[0] * b + z[0] * c,
        x[1] * a + y[1] * b + z[1] * c,
        x[2] * a + y[2] * b + z[2] * c,
    )


def turn_back(frame: Frame, v: Sequence[float]) -> Vector:
    """A direction given in the axes of the parent, in those of `frame`."""
    return dot(frame[1], v), dot(frame[2], v), dot(frame[3], v)


def compose(a: Frame, b: Frame) -> Frame:
    """X_AC of a = X_AB and b = X_BC."""
    p, q = a[0], turn(a, b[0])
    return (p[0] + q[0], p[1] + q[1], p[2] + q[2]), turn(a, b[1]), turn(a, b[2]), turn(a, b[3])


def invert(a: Frame) -> Frame:
    """X_BA of X_AB."""
    x, y, z = zip(a[1], a[2], a[3], strict=True)
    p = turn_back(a, a[0])
    return (-p[0], -p[1], -p[2]), x, y, z


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """The turn b followed, in the parent's axes, by the turn a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(a: Quaternion) -> Quaternion:
    """The turn back."""
    return a[0], -a[1], -a[2], -a[3]


def from_rotvec(v: Sequence[float]) -> Quaternion:
    """Axis times angle [rad] -> quaternion."""
    angle = norm(v)
    if angle < _TINY:
        return 1.0, 0.5 * v[0], 0.5 * v[1], 0.5 * v[2]
    k = math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), k * v[0], k * v[1], k * v[2]


def rotvec(q: Quaternion) -> Vector:
    """Quaternion -> axis times angle, 0..pi [rad]."""
    w, x, y, z = q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    s = math.sqrt(x * x + y * y + z * z)
    k = 2.0 * math.atan2(s, w) / s if s > _TINY else 2.0
    return k * x, k * y, k * z


def axes(q: Quaternion) -> tuple[Vector, Vector, Vector]:
    """The axes of a frame that is turned by q."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
    )


def quaternion(frame: Frame) -> Quaternion:
    """The turn of a frame (Shepperd's method)."""
    _, (a, b, c), (d, e, f), (g, h, i) = frame
    m = 1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i
    k = m.index(max(m))
    q = (
        (m[0], f - h, g - c, b - d),
        (f - h, m[1], d + b, g + c),
        (g - c, d + b, m[2], h + f),
        (b - d, g + c, h + f, m[3]),
    )[k]
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] / n, q[1] / n, q[2] / n, q[3] / n


def frame_of(pose: Sequence[float]) -> Frame:
    """Position [m] and axis-angle [rad], 6 numbers, -> frame."""
    p = (float(pose[0]), float(pose[1]), float(pose[2]))
    return p, *axes(from_rotvec([float(v) for v in pose[3:6]]))


def pose_of(frame: Frame) -> list[float]:
    """Frame -> position [m] and axis-angle [rad], 6 numbers."""
    return [*frame[0], *rotvec(quaternion(frame))]


def pose_trans(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """URScript's `pose_trans`: pose b given in a, seen from a's parent."""
    return pose_of(compose(frame_of(a), frame_of(b)))


def slerp(a: Quaternion, b: Quaternion, u: float) -> Quaternion:
    """A turn at the share u of the shortest way from a to b."""
    x, y, z = rotvec(multiply(b, conjugate(a)))
    return multiply(from_rotvec((u * x, u * y, u * z)), a)
