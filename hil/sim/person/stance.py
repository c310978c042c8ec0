"""How a person stands and holds arms and hands, as numbers that can be blended."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cell.frames import Array, from_quaternion, quaternion
from hil.sim.person.hands import shape


@dataclass(frozen=True, eq=False)
class Arm:
    """One arm, in P.

    Attributes:
        p: grip point (3,) [m]: the middle of what the hand holds.
        R: orientation of the hand (3, 3): x along the fingers' roots, z out of the palm.
        swivel: of the elbow about the line shoulder-wrist [rad]: 0 hangs down, positive is outwards.
        fingers: as from `hands.shape`.
    """

    p: Array
    R: Array
    swivel: float
    fingers: Array = field(default_factory=lambda: shape("relaxed"))


@dataclass(frozen=True, eq=False)
class Stance:
    """A whole person.

    Attributes:
        x, y: place of P in the world [m]. yaw: of its x axis about world z [rad].
        lean: bend forward at the hips [rad]. twist: of the trunk to the left [rad].
        nod: of the head, down [rad]. stride: swing of the legs, -1 .. 1.
        left, right: the arms.
    """

    x: float
    y: float
    yaw: float
    left: Arm
    right: Arm
    lean: float = 0.0
    twist: float = 0.0
    nod: float = 0.1
    stride: float = 0.0

    def arm(self, side: str) -> Arm:
        return self.left if side == "L" else self.right

    def with_arm(self, side: str, arm: Arm) -> Stance:
        return replace(self, left=arm) if side == "L" else replace(self, right=arm)


def minimum_jerk(s: float) -> float:
    """Smooth progress 0..1 of a movement whose time has gone by the share s (Flash & Hogan 1985)."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def blend(a: Stance, b: Stance, w: float, lift: float = 0.0) -> Stance:
    """Between two stances: w = 0 is a, w = 1 is b.

    Args:
        lift: how much higher the hands pass half way [m], times how far they go (at most once).
    """
    if w <= 0.0:
        return a
    if w >= 1.0:
        return b
    scalars = {
        name: (1 - w) * getattr(a, name) + w * getattr(b, name)
        for name in ("x", "y", "lean", "twist", "nod", "stride")
    }
    turn = (b.yaw - a.yaw + np.pi) % (2 * np.pi) - np.pi
    return Stance(
        yaw=a.yaw + w * turn,
        left=_blend_arm(a.left, b.left, w, lift),
        right=_blend_arm(a.right, b.right, w, lift),
        **scalars,
    )


def _blend_arm(a: Arm, b: Arm, w: float, lift: float) -> Arm:
    far = min(1.0, float(np.linalg.norm(b.p - a.p)) / 0.3)
    p = (1 - w) * a.p + w * b.p
    p = p + np.array([0.0, 0.0, 4.0 * w * (1 - w) * lift * far])
    swivel = (1 - w) * a.swivel + w * b.swivel
    return Arm(p, _slerp(a.R, b.R, w), swivel, (1 - w) * a.fingers + w * b.fingers)


def _slerp(A: Array, B: Array, w: float) -> Array:
    qa, qb = quaternion(A), quaternion(B)
    dot = float(qa @ qb)
    if dot < 0.0:
        qb, dot = -qb, -dot
    angle = np.arccos(min(1.0, dot))
    if angle < 1e-6:
        return B
    q = (np.sin((1 - w) * angle) * qa + np.sin(w * angle) * qb) / np.sin(angle)
    return from_quaternion(q / np.linalg.norm(q))
