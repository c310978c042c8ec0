"""From one RGB-D frame to onions in the world: detect, locate, keep what is on the belt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cell.cameras import camera_pinhole, camera_pose
from cell.config import CellConfig
from cell.frames import Array
from cell.perception.localise import locate
from cell.perception.tracking import Sighting
from cell.wire.types import Box, Detections, Frame

_BELT_MARGIN = 0.05
"""Onions this far outside the pick window are still taken into account [m]."""
_HEIGHTS = (-0.01, 0.09)
"""Heights of onion centres above the belt that are plausible [m]."""
_BEHIND, _BACKGROUND = 0.06, (58, 66, 66)
"""What is so much farther away than a held onion's middle [m] gets this colour."""
_CROP = 192
"""Side of the square looked at round a held onion [px]."""


class OnionDetector(Protocol):
    """What perception needs of a detector; see `cell.perception.detector`."""

    def detect(self, rgb: np.ndarray) -> tuple[tuple[Box, float], ...]:
        """(box, P(blemished)) of every onion in an image (H, W, 3) uint8."""
        ...


@dataclass(frozen=True)
class Belt:
    """One look at the belt: sightings on it, and the detections behind them."""

    sightings: tuple[Sighting, ...]
    detections: Detections


@dataclass(frozen=True)
class Held:
    """One look at a held onion; `sighting` is None when it was not found."""

    p_blemished: float
    found: bool
    detections: Detections


class Eye:
    """The belt camera's geometry with the detector."""

    def __init__(self, config: CellConfig, detector: OnionDetector) -> None:
        camera = config.cameras["belt"]
        self._config = config
        self._detector = detector
        self._pinhole = camera_pinhole(camera)
        self._X_WC = camera_pose(camera)

    def belt(self, frame: Frame) -> Belt:
        """Every onion on the belt that `frame` shows."""
        threshold = self._config.supervisor.score_threshold
        found = [(b, p) for b, p in self._detector.detect(frame.rgb) if b.score >= threshold]
        sightings = []
        for box, p_blemished in found:
            located = locate(box, frame.depth, self._pinhole, self._X_WC)
            if located is not None and self._on_belt(located.p_WO):
                sightings.append(Sighting(located.p_WO, located.radius, p_blemished, box.score))
        return Belt(tuple(sightings), Detections(frame.t, frame.camera, tuple(b for b, _ in found)))

    def held(self, frame: Frame, p_WO: Array) -> Held:
        """The onion held at `p_WO` (3,) [m]: detection in a crop round its projection."""
        p_C = self._X_WC[:3, :3].T @ (p_WO - self._X_WC[:3, 3])
        u, v = self._pinhole.project(p_C)
        height, width = frame.rgb.shape[:2]
        x0 = int(np.clip(u - _CROP / 2, 0, width - _CROP))
        y0 = int(np.clip(v - _CROP / 2, 0, height - _CROP))
        crop = frame.rgb[y0 : y0 + _CROP, x0 : x0 + _CROP].copy()
        # What lies behind is painted over: a blemish there is none of the held onion's.
        crop[frame.depth[y0 : y0 + _CROP, x0 : x0 + _CROP] > p_C[2] + _BEHIND] = _BACKGROUND
        best: tuple[float, Box, float] | None = None
        for box, p_blemished in self._detector.detect(crop):
            if box.score < self._config.supervisor.score_threshold:
                continue
            bx0, by0, bx1, by1 = box.box
            off = float(np.hypot((bx0 + bx1) / 2 + x0 - u, (by0 + by1) / 2 + y0 - v))
            if best is None or off < best[0]:
                moved = Box((bx0 + x0, by0 + y0, bx1 + x0, by1 + y0), box.label, box.score)
                best = (off, moved, p_blemished)
        radius_px = 0.5 * self._config.onions.diameter[1] / float(p_C[2]) * self._pinhole.fx
        if best is None or best[0] > radius_px:
            return Held(0.0, False, Detections(frame.t, frame.camera, ()))
        return Held(best[2], True, Detections(frame.t, frame.camera, (best[1],)))

    def _on_belt(self, p_WO: Array) -> bool:
        belt = self._config.belt
        (x0, x1), (y0, y1) = belt.pick_x, belt.pick_y
        height = p_WO[2] - belt.top_z
        return bool(
            x0 - _BELT_MARGIN <= p_WO[0] <= x1 + _BELT_MARGIN
            and y0 - _BELT_MARGIN <= p_WO[1] <= y1 + _BELT_MARGIN
            and _HEIGHTS[0] <= height <= _HEIGHTS[1]
        )
