"""Shapes of the fingers, as angles on top of the rest pose, which is slightly bent already."""

from __future__ import annotations

import numpy as np

from cell.frames import Array, rot_x, rot_y, rot_z
from hil.sim.person.body import Rig

# Degrees: (MCP, PIP, DIP) of the four fingers from index to little, then the thumb's three joints.
_FINGERS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "thumb": ((82.0, 96.0, 62.0), (84.0, 96.0, 62.0), (84.0, 96.0, 62.0), (84.0, 96.0, 62.0)),
    "fist": ((82.0, 96.0, 62.0), (84.0, 96.0, 62.0), (84.0, 96.0, 62.0), (84.0, 96.0, 62.0)),
    "grip": ((24.0, 26.0, 16.0),) * 4,
    "relaxed": ((6.0, 10.0, 8.0), (10.0, 12.0, 8.0), (14.0, 14.0, 8.0), (18.0, 16.0, 8.0)),
    "open": ((-12.0, -14.0, -10.0),) * 4,
}
_THUMBS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "thumb": ((-26.0, -8.0, 4.0), (-14.0, 0.0, 0.0), (-16.0, 0.0, 0.0)),
    "fist": ((18.0, 3.0, 9.0), (28.0, -12.0, 9.0), (56.0, 0.0, 0.0)),
    "grip": ((6.0, 0.0, -10.0), (6.0, 0.0, 0.0), (10.0, 0.0, 0.0)),
    "relaxed": ((0.0, 0.0, 0.0),) * 3,
    "open": ((-6.0, 0.0, 6.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
}
SHAPES = tuple(_FINGERS)
"""Names of the shapes."""
_KNUCKLE_BACK = 0.012
"""The first finger bones begin this far beyond the real knuckles [m]."""


def shape(name: str, rng: np.random.Generator | None = None, sloppiness: float = 0.0) -> Array:
    """Angles (5, 3, 3) [rad] of fingers 1 (thumb) to 5, joints from the hand outwards, about x, y, z.

    Args:
        name: one of `SHAPES`. rng, sloppiness: the joints differ from the ideal by so much [rad].
    """
    out = np.zeros((5, 3, 3))
    out[0] = np.deg2rad(_THUMBS[name])
    out[1:, :, 0] = np.deg2rad(_FINGERS[name])
    if rng is not None and sloppiness > 0.0:
        out[:, :, 0] += rng.normal(0.0, sloppiness, (5, 3))
        out[1:, 0, 2] += rng.normal(0.0, 0.5 * sloppiness, 4)
    return out


def finger_turns(rig: Rig, side: str, angles: Array) -> dict[int, Array]:
    """Rotations (3, 3) of the finger bones in their own axes.

    Args:
        side: "L" or "R". angles: as from `shape`; the left hand mirrors the turns about y and z.
    """
    mirror = -1.0 if side == "L" else 1.0
    out = {}
    for finger in range(5):
        for joint in range(3):
            ax, ay, az = angles[finger, joint]
            turn = rot_z(mirror * az) @ rot_y(mirror * ay) @ rot_x(ax)
            out[rig.index(f"finger{finger + 1}-{joint + 1}.{side}")] = turn
    return out


def pivot(rig: Rig, side: str, finger: int) -> Array:
    """Where a finger bends at its root (3,) [m], at rest: nearer to the wrist than the bone's head."""
    bone = rig.index(f"finger{finger}-1.{side}")
    along: Array = rig.R[bone][:, 1]
    out: Array = rig.p[bone] - _KNUCKLE_BACK * along
    return out
