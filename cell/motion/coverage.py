"""Which parts of a held onion a camera sees past the gripper.

The onion is a sphere round the TCP; its surface is a set of evenly spread patches, given by
their unit normals in the TCP frame. Patches under the finger pads are left out: no view of this
grasp can show them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell.cameras import camera_pose
from cell.config import CellConfig
from cell.frames import Array, rot_x, rot_z

SEEN_WITHIN = np.radians(65.0)
"""A patch counts as seen when its normal is within this angle of the direction to the camera."""
_PAD_HALF_ANGLE = np.radians(20.0)
_PATCHES = 400
_GRASP_HEIGHT = 0.035


class Onion:
    """A sphere of `radius` [m] in a gripper's fingers; patch normals (M, 3) in the TCP frame."""

    def __init__(self, radius: float) -> None:
        self.radius = radius
        normals = _sphere(_PATCHES)
        self.normals = normals[np.abs(normals[:, 0]) < np.cos(_PAD_HALF_ANGLE)]
        # What of the gripper is in the way: fingers, cross-bar, palm; corners low and high [m].
        self._boxes = [
            (np.array(lo), np.array(hi))
            for lo, hi in (
                ((radius, -0.011, -0.047), (radius + 0.014, 0.011, 0.011)),
                ((-radius - 0.014, -0.011, -0.047), (-radius, 0.011, 0.011)),
                ((-0.065, -0.015, -0.088), (0.065, 0.015, -0.066)),
                ((-0.038, -0.038, -0.163), (0.038, 0.038, -0.088)),
            )
        ]

    def seen_from(self, p_TC: Array) -> NDArray[np.bool_]:
        """Which patches a camera at p_TC (3,) [m] sees, shape (M,)."""
        p = self.radius * self.normals
        ray = p_TC - p
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        out: NDArray[np.bool_] = np.einsum("ij,ij->i", ray, self.normals) > np.cos(SEEN_WITHIN)
        for lo, hi in self._boxes:
            out &= ~_hits_box(p, ray, lo, hi)
        return out

    def seen_on_belt(self, config: CellConfig) -> Array:
        """Probability per patch (M,) of being seen before the grasp, over the pick window and all yaws."""
        belt, p_WC = config.belt, camera_pose(config.cameras["belt"])[:3, 3]
        seen = []
        for x in np.linspace(*belt.pick_x, 3):
            for y in np.linspace(*belt.pick_y, 5):
                c = p_WC - np.array([x, y, belt.top_z + _GRASP_HEIGHT])
                c /= np.linalg.norm(c)
                for yaw in np.linspace(-np.pi / 2, np.pi / 2, 8, endpoint=False):
                    R_WT = rot_z(float(yaw)) @ rot_x(np.pi)
                    seen.append(self.normals @ (R_WT.T @ c) > np.cos(SEEN_WITHIN))
        out: Array = np.mean(seen, axis=0)
        return out


def _hits_box(p: Array, ray: Array, lo: Array, hi: Array) -> NDArray[np.bool_]:
    """Which rays from points p (M, 3) along unit vectors (M, 3) meet a box, shape (M,)."""
    inverse = 1.0 / np.where(np.abs(ray) < 1e-12, 1e-12, ray)
    a, b = (lo - p) * inverse, (hi - p) * inverse
    enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    out: NDArray[np.bool_] = (leave > np.maximum(enter, 1e-6)) & (leave > 0)
    return out


def _sphere(count: int) -> Array:
    """Evenly spread unit vectors, shape (count, 3) (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, a = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)
