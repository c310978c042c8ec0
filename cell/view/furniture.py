"""The cell's fixed parts as boxes and posts to be drawn, from the configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.cameras import camera_pose
from cell.config import CellConfig
from cell.frames import Array
from cell.settings import BinConfig

Colour = tuple[int, int, int]

_BELT, _METAL, _DARK = (62, 69, 69), (150, 155, 160), (70, 74, 80)
_BIN, _PERSON_BIN, _FLOOR = (60, 100, 165), (90, 135, 80), (205, 205, 200)
_WALL, _RAIL = 0.006, 0.018
_BEHIND = 0.0645
"""A camera's post stands this far behind its optical centre [m]."""


@dataclass(frozen=True)
class Part:
    """A box with corners low and high (3,) [m]."""

    name: str
    low: Array
    high: Array
    colour: Colour

    @property
    def centre(self) -> Array:
        return np.asarray((self.low + self.high) / 2)

    @property
    def size(self) -> tuple[float, float, float]:
        x, y, z = (float(v) for v in self.high - self.low)
        return x, y, z


def parts(config: CellConfig) -> list[Part]:
    """Floor, pedestal, belt, both bins and the cameras' posts."""
    floor, belt = config.floor_z, config.belt
    (x0, x1), (y0, y1), top = belt.x, belt.y, belt.top_z
    out = [
        _part("floor", (-0.9, -1.5, floor - 0.02), (2.7, 1.3, floor), _FLOOR),
        _part("pedestal", (-0.10, -0.10, floor), (0.10, 0.10, -0.002), _DARK),
        _part("belt/top", (x0, y0, top - 0.05), (x1, y1, top), _BELT),
        _part("belt/near", (x0 - _RAIL, y0, top - 0.13), (x0, y1, top - 0.008), _METAL),
        _part("belt/far", (x1, y0, top - 0.13), (x1 + _RAIL, y1, top - 0.008), _METAL),
    ]
    for i, x in enumerate((x0 + 0.03, x1 - 0.03)):
        for j, y in enumerate((y0 + 0.15, y1 - 0.15)):
            low, high = (x - 0.02, y - 0.02, floor), (x + 0.02, y + 0.02, top - 0.05)
            out.append(_part(f"belt/leg{i}{j}", low, high, _METAL))
    out += _bin("bin", config.bin, floor, _BIN) + _bin("person_bin", config.person.bin, floor, _PERSON_BIN)
    for name, camera in config.cameras.items():
        X_WC = camera_pose(camera)
        x, y, _ = X_WC[:3, 3] - _BEHIND * X_WC[:3, 2]
        z = X_WC[2, 3] + 0.02
        out.append(_part(f"post_{name}", (x - 0.015, y - 0.015, floor), (x + 0.015, y + 0.015, z), _METAL))
    return out


def _bin(name: str, bin: BinConfig, floor: float, colour: Colour) -> list[Part]:
    (cx, cy, top), (sx, sy, depth) = bin.center, bin.size
    x0, x1, y0, y1, z0 = cx - sx / 2, cx + sx / 2, cy - sy / 2, cy + sy / 2, top - depth
    return [
        _part(f"{name}/bottom", (x0 - _WALL, y0 - _WALL, z0 - _WALL), (x1 + _WALL, y1 + _WALL, z0), colour),
        _part(f"{name}/w", (x0 - _WALL, y0 - _WALL, z0), (x0, y1 + _WALL, top), colour),
        _part(f"{name}/e", (x1, y0 - _WALL, z0), (x1 + _WALL, y1 + _WALL, top), colour),
        _part(f"{name}/s", (x0, y0 - _WALL, z0), (x1, y0, top), colour),
        _part(f"{name}/n", (x0, y1, z0), (x1, y1 + _WALL, top), colour),
        _part(f"{name}/stand", (cx - 0.05, cy - 0.05, floor), (cx + 0.05, cy + 0.05, z0 - _WALL), _DARK),
    ]


def _part(name: str, low: object, high: object, colour: Colour) -> Part:
    return Part(name, np.asarray(low, float), np.asarray(high, float), colour)
