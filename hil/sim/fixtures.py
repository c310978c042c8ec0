"""Everything in the cell that never moves: pedestal, floor, belt, bin, camera posts.

The same list feeds PyBullet (collision, reference renderer) and the scene of the fast
renderer, so that what is touched and what is seen cannot differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.cameras import true_pose
from cell.config import CellConfig
from cell.frames import Array, pose
from cell.settings import BinConfig

POST_RADIUS = 0.02
CAMERA_BODY = (0.090, 0.025, 0.025)
"""Housing of a camera: width, height, depth [m] (D435: 90 x 25 x 25 mm)."""

_BELT = (0.24, 0.27, 0.27, 1.0)
_METAL = (0.62, 0.64, 0.66, 1.0)
_DARK = (0.20, 0.21, 0.23, 1.0)
_BIN = (0.20, 0.36, 0.60, 1.0)
_PERSON_BIN = (0.30, 0.45, 0.28, 1.0)
_FLOOR = (0.56, 0.55, 0.53, 1.0)


@dataclass(frozen=True)
class Fixture:
    """One rigid primitive. `size`: box full lengths, or (radius, length) of a z cylinder [m]."""

    group: str
    X_WF: Array
    size: tuple[float, ...]
    rgba: tuple[float, float, float, float]

    @property
    def is_box(self) -> bool:
        return len(self.size) == 3


def _box(group: str, lo: object, hi: object, rgba: tuple[float, float, float, float]) -> Fixture:
    lo_, hi_ = np.asarray(lo, float), np.asarray(hi, float)
    size = tuple(float(v) for v in hi_ - lo_)
    return Fixture(group, pose(p=(lo_ + hi_) / 2), size, rgba)


def fixtures(config: CellConfig) -> list[Fixture]:
    """The cell's fixed parts, in world coordinates; groups: floor, pedestal, belt, bin, post."""
    floor = config.floor_z
    return [
        _box("floor", (-2.5, -2.5, floor - 0.02), (4.0, 2.5, floor), _FLOOR),
        _box("pedestal", (-0.10, -0.10, floor), (0.10, 0.10, -0.002), _DARK),
        *_belt(config),
        *_bin(config.bin, floor, _BIN),
        *_bin(config.person.bin, floor, _PERSON_BIN),
        *(part for name in config.cameras for part in _camera(config, name)),
    ]


def _belt(config: CellConfig) -> list[Fixture]:
    (x0, x1), (y0, y1), top = config.belt.x, config.belt.y, config.belt.top_z
    legs = [
        _box("belt", (x - 0.02, y - 0.02, config.floor_z), (x + 0.02, y + 0.02, top - 0.12), _METAL)
        for x in (x0 + 0.03, x1 - 0.03)
        for y in (y0 + 0.15, y1 - 0.15)
    ]
    return [
        _box("belt", (x0, y0, top - 0.05), (x1, y1, top), _BELT),
        _box("belt", (x0 - 0.018, y0, top - 0.13), (x0, y1, top - 0.008), _METAL),
        _box("belt", (x1, y0, top - 0.13), (x1 + 0.018, y1, top - 0.008), _METAL),
        *legs,
    ]


def _bin(bin: BinConfig, floor: float, rgba: tuple[float, float, float, float]) -> list[Fixture]:
    """An open box; its walls are 6 mm thick and stand outside the inner size."""
    (cx, cy, top), (sx, sy, depth), wall = bin.center, bin.size, 0.006
    x0, x1, y0, y1, z0 = cx - sx / 2, cx + sx / 2, cy - sy / 2, cy + sy / 2, top - depth
    stand = _box("bin", (cx - 0.05, cy - 0.05, floor), (cx + 0.05, cy + 0.05, z0 - wall), _DARK)
    return [
        _box("bin", (x0 - wall, y0 - wall, z0 - wall), (x1 + wall, y1 + wall, z0), rgba),
        _box("bin", (x0 - wall, y0 - wall, z0), (x0, y1 + wall, top), rgba),
        _box("bin", (x1, y0 - wall, z0), (x1 + wall, y1 + wall, top), rgba),
        _box("bin", (x0, y0 - wall, z0), (x1, y0, top), rgba),
        _box("bin", (x0, y1, z0), (x1, y1 + wall, top), rgba),
        stand,
    ]


def _camera(config: CellConfig, name: str) -> list[Fixture]:
    """A vertical post with the camera's housing, which lies behind the optical centre."""
    camera = config.cameras[name]
    X_WC = true_pose(camera)
    X_WH = X_WC @ pose(p=(0.0, 0.0, -CAMERA_BODY[2] / 2 - 0.002))
    x, y, _ = X_WH[:3, 3] - 0.05 * X_WC[:3, 2]
    top = float(X_WH[2, 3]) + 0.03
    return [
        Fixture("post", X_WH, CAMERA_BODY, _DARK),
        Fixture(
            "post", pose(p=(x, y, (config.floor_z + top) / 2)), (POST_RADIUS, top - config.floor_z), _METAL
        ),
    ]
