"""Distances between the arm and the fixed cell, and between its own parts.

The arm is a chain of capsules with the published link radii, sampled as spheres; the cell is
made of boxes and posts. Everything is vectorised over configurations: a path of 60 of them
takes about two milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.config import CellConfig
from cell.frames import Array, look_at
from cell.limits import link_frames

_SHOULDER_OFFSET, _ELBOW_OFFSET = 0.120, 0.027
"""Distances of the upper arm and the forearm from the plane of joints 2 and 3 [m]."""
_FINGER_TIP, _FINGER_ROOT, _FINGER_OUT = 0.011, -0.047, 0.007
"""Fingers along z of the TCP frame, and their middle outside the pads [m]."""
_PALM_BACK, _PALM_FRONT, _BAR_HALF = -0.163, -0.074, 0.058
_WALL = 0.006
POST_RADIUS, CAMERA_RADIUS = 0.02, 0.06
_FAR = 10.0


@dataclass(frozen=True)
class Part:
    """Spheres along one capsule: indices into the sphere arrays."""

    name: str
    spheres: slice


class CollisionModel:
    """Clearances of the arm in one cell."""

    def __init__(self, config: CellConfig) -> None:
        self._length = config.gripper.length
        self._stroke = config.gripper.stroke
        self._boxes, self._box_names = _boxes(config)
        self._posts = [
            (np.array(look_at(c.position, c.target)[:3, 3]), look_at(c.position, c.target)[:3, 2])
            for c in config.cameras.values()
        ]
        self._parts: list[Part] = []
        self._radii = np.empty(0)

    def clearance(self, q: Array, *, width: float | None = None, held_radius: float = 0.0) -> Array:
        """Least distance of arm, gripper and held onion to anything, shape (N,) [m].

        Args:
            q: joint angles (N, 6) [rad].
            width: distance between the pads [m]; the full stroke if not given.
            held_radius: radius of an onion held at the TCP [m], 0 for none.
        """
        p, r, names = self.spheres(q, width=width, held_radius=held_radius)
        best = np.full(len(p), _FAR)
        # Links that are bolted down, or that always pass near the base, see no furniture.
        free = np.array([name not in ("base", "shoulder") for name in names])
        for lo, hi in self._boxes:
            outside = np.maximum(np.maximum(lo - p[:, free], p[:, free] - hi), 0.0)
            best = np.minimum(best, (np.linalg.norm(outside, axis=2) - r[free]).min(axis=1))
        for camera, axis in self._posts:
            post = camera - 0.065 * axis
            level = np.hypot(p[:, free, 0] - post[0], p[:, free, 1] - post[1]) - POST_RADIUS - r[free]
            below = p[:, free, 2] <= camera[2]
            best = np.minimum(best, np.where(below, level, _FAR).min(axis=1))
            housing = np.linalg.norm(p[:, free] - camera, axis=2) - CAMERA_RADIUS - r[free]
            best = np.minimum(best, housing.min(axis=1))
        return np.minimum(best, self._self_clearance(p, r, names))

    def hides(self, q: Array, p_WC: Array, p_WP: Array, *, radius: float) -> Array:
        """Which points the arm hides from a camera, shape (N, M) bool.

        Args:
            q: joint angles (N, 6) [rad]. p_WC: the camera (3,) [m]. p_WP: points (M, 3) [m].
            radius: of the thing at each point that must be seen whole [m].
        """
        p, r, _ = self.spheres(q)
        ray = p_WP - p_WC
        length = np.linalg.norm(ray, axis=1)
        ray = ray / length[:, None]
        offset = p - p_WC
        along = np.einsum("nsj,mj->nsm", offset, ray)
        across2 = np.einsum("nsj,nsj->ns", offset, offset)[:, :, None] - along**2
        near = np.clip(along / length, 0, 1) * radius  # the cone of sight narrows to the camera
        hit = (along > 0) & (along < length - radius) & (across2 < (r[None, :, None] + near) ** 2)
        out: Array = hit.any(axis=1)
        return out

    def spheres(
        self, q: Array, *, width: float | None = None, held_radius: float = 0.0
    ) -> tuple[Array, Array, list[str]]:
        """Sphere centres (N, S, 3) [m], radii (S,) [m] and part names for configurations (N, 6)."""
        X = link_frames(q)
        n = len(X)
        z = [X[:, i, :3, 2] for i in range(6)]
        o = [X[:, i, :3, 3] for i in range(6)]
        zero = np.zeros((n, 3))
        side = z[0]
        shoulder, elbow_out = o[0] + _SHOULDER_OFFSET * side, o[1] + _SHOULDER_OFFSET * side
        elbow_in, wrist_in = o[1] + _ELBOW_OFFSET * side, o[2] + _ELBOW_OFFSET * side
        x_T, z_T = X[:, 5, :3, 0], z[5]
        tcp = o[5] + self._length * z_T
        out = (self._stroke if width is None else width) / 2 + _FINGER_OUT
        chain: list[tuple[str, Array, Array, float, int]] = [
            ("base", zero, o[0], 0.075, 3),
            ("shoulder", o[0], shoulder, 0.060, 3),
            ("upper_arm", shoulder, elbow_out, 0.054, 7),
            ("elbow", elbow_out, elbow_in, 0.058, 3),
            ("forearm", elbow_in, wrist_in, 0.042, 7),
            ("wrist", wrist_in, o[3], 0.045, 4),
            ("wrist", o[3], o[4], 0.045, 3),
            ("hand", o[4], o[5], 0.042, 3),
            ("hand", tcp + _PALM_BACK * z_T, tcp + (_PALM_FRONT - 0.03) * z_T, 0.040, 4),
            (
                "hand",
                tcp + _PALM_FRONT * z_T - _BAR_HALF * x_T,
                tcp + _PALM_FRONT * z_T + _BAR_HALF * x_T,
                0.017,
                7,
            ),
        ]
        for sign in (-1.0, 1.0):
            finger = tcp + sign * out * x_T
            tip, root = finger + (_FINGER_TIP - 0.011) * z_T, finger + _FINGER_ROOT * z_T
            chain.append(("finger", tip, root, 0.012, 5))
        if held_radius > 0.0:
            chain.append(("onion", tcp, tcp, held_radius, 1))
        centres, radii, names = [], [], []
        for name, a, b, radius, count in chain:
            for w in np.linspace(0.0, 1.0, count):
                centres.append((1 - w) * a + w * b)
                radii.append(radius)
                names.append(name)
        return np.stack(centres, axis=1), np.array(radii), names

    def _self_clearance(self, p: Array, r: Array, names: list[str]) -> Array:
        fixed = [i for i, name in enumerate(names) if name in ("base", "shoulder", "upper_arm")]
        moving = [i for i, name in enumerate(names) if name in ("wrist", "hand", "finger", "onion")]
        gap = np.linalg.norm(p[:, fixed, None] - p[:, None, moving], axis=3)
        out: Array = (gap - r[fixed][None, :, None] - r[moving][None, None, :]).min(axis=(1, 2))
        return out


def _boxes(config: CellConfig) -> tuple[list[tuple[Array, Array]], list[str]]:
    """Corners (low, high) [m] of the cell's boxes, and their names."""
    b, c = config.belt, config.bin
    (cx, cy, top), (sx, sy, depth) = c.center, c.size
    x0, x1, y0, y1, z0 = cx - sx / 2, cx + sx / 2, cy - sy / 2, cy + sy / 2, top - depth
    boxes = [
        ("belt", (b.x[0] - 0.018, b.y[0], b.top_z - 0.13), (b.x[1] + 0.018, b.y[1], b.top_z)),
        ("bin", (x0 - _WALL, y0 - _WALL, z0), (x0, y1 + _WALL, top)),
        ("bin", (x1, y0 - _WALL, z0), (x1 + _WALL, y1 + _WALL, top)),
        ("bin", (x0, y0 - _WALL, z0), (x1, y0, top)),
        ("bin", (x0, y1, z0), (x1, y1 + _WALL, top)),
        ("bin", (x0, y0, z0 - _WALL), (x1, y1, z0)),
        ("pedestal", (-0.10, -0.10, -1.0), (0.10, 0.10, -0.002)),
        ("floor", (-5.0, -5.0, -2.0), (5.0, 5.0, -0.75)),
    ]
    return [(np.array(lo), np.array(hi)) for _, lo, hi in boxes], [name for name, _, _ in boxes]
