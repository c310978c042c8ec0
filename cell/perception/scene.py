"""The empty cell as the person camera would see it: depth of the fixed parts, ray by ray.

What is nearer than this is something that does not belong to the cell: the person, the arm, produce.
A bin counts as filled to its rim, so that what lies in it never counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell.cameras import camera_pinhole, camera_pose
from cell.config import CellConfig
from cell.frames import Array
from cell.settings import BinConfig

_WALL = 0.006
_RAIL = 0.018
_POST = 0.035
"""Half the thickness of a camera's post with its fittings [m]."""
_HOUSING = 0.08
_BEHIND = 0.0645
"""A camera's post stands this far behind its optical centre [m]."""


class EmptyScene:
    """Depth of the fixed cell in one camera, on a coarser grid of pixels.

    Args:
        camera: name of the camera. stride: every how many pixels a ray is cast.
        X_WC: pose of the camera, if not the configured one.

    Attributes:
        stride: see above.
        depth: shape (h, w) float32 [m] along the optical axis, infinity where nothing fixed is.
        rays_W: shape (h, w, 3): p_W = p_WC + depth * ray.
        p_WC: the camera (3,) [m]. X_WC: its pose. pinhole: of the full image.
    """

    def __init__(self, config: CellConfig, camera: str, stride: int, X_WC: Array | None = None) -> None:
        c = config.cameras[camera]
        self.stride = stride
        self.pinhole = camera_pinhole(c)
        self.X_WC = camera_pose(c) if X_WC is None else X_WC
        self.p_WC: Array = self.X_WC[:3, 3]
        u, v = np.meshgrid(np.arange(0, c.width, stride), np.arange(0, c.height, stride))
        rays_C = self.pinhole.back_project(np.stack([u, v], axis=-1), np.ones(u.shape))
        rays = rays_C @ self.X_WC[:3, :3].T
        nearest = np.full(u.shape, np.inf)
        for low, high in _boxes(config, camera):
            np.minimum(nearest, _entry(rays, self.p_WC, low, high), out=nearest)
        self.rays_W: NDArray[np.float32] = rays.astype(np.float32)
        self.depth: NDArray[np.float32] = nearest.astype(np.float32)

    def pixels(self, p_W: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """Rows, columns of the coarse grid (clipped to it) and depths [m] of points (N, 3) [m]."""
        p_C = (p_W - self.p_WC) @ self.X_WC[:3, :3]
        z = np.maximum(p_C[:, 2], 1e-3)
        uv = self.pinhole.project(np.column_stack([p_C[:, :2], z]))
        h, w = self.depth.shape
        column = np.clip(np.round(uv[:, 0] / self.stride), 0, w - 1).astype(np.intp)
        row = np.clip(np.round(uv[:, 1] / self.stride), 0, h - 1).astype(np.intp)
        return row, column, p_C[:, 2]


def _entry(rays: Array, p: Array, low: Array, high: Array) -> Array:
    """Where rays (h, w, 3) from p (3,) enter a box, in units of the ray; infinity where they miss."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - p) / rays, (high - p) / rays
    first = np.nanmax(np.minimum(a, b), axis=-1)
    last = np.nanmin(np.maximum(a, b), axis=-1)
    return np.where((first <= last) & (first > 0.0), first, np.inf)


def _boxes(config: CellConfig, camera: str) -> list[tuple[Array, Array]]:
    """Corners, low and high (3,) [m], of the cell's fixed parts; posts as slim boxes."""
    belt, floor = config.belt, config.floor_z
    (x0, x1), (y0, y1), top = belt.x, belt.y, belt.top_z
    boxes = [
        ((-5.0, -5.0, floor - 0.5), (8.0, 5.0, floor)),
        ((x0 - _RAIL, y0, top - 0.13), (x1 + _RAIL, y1, top)),
        ((x0, y0 + 0.10, floor), (x1, y0 + 0.20, top)),
        ((x0, y1 - 0.20, floor), (x1, y1 - 0.10, top)),
        ((-0.10, -0.10, floor), (0.10, 0.10, 0.0)),
        _bin(config.bin, floor),
        _bin(config.person.bin, floor),
    ]
    for name, c in config.cameras.items():
        if name != camera:
            X_WC = camera_pose(c)
            x, y, z = X_WC[:3, 3] - _BEHIND * X_WC[:3, 2]
            boxes.append(((x - _POST, y - _POST, floor), (x + _POST, y + _POST, z + 0.05)))
            p = X_WC[:3, 3]
            boxes.append((tuple(p - _HOUSING), tuple(p + _HOUSING)))
    return [(np.array(low, float), np.array(high, float)) for low, high in boxes]


def _bin(bin: BinConfig, floor: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    (cx, cy, top), (sx, sy, _) = bin.center, bin.size
    hx, hy = sx / 2 + _WALL, sy / 2 + _WALL
    return (cx - hx, cy - hy, floor), (cx + hx, cy + hy, top)
