"""Arm poses that turn the hidden sides of a held onion to the belt camera."""

from __future__ import annotations

from functools import lru_cache

import msgspec
import numpy as np

from cell.cameras import camera_pose
from cell.config import CellConfig, from_dict
from cell.motion.coverage import Onion
from cell.motion.view_search import RADIUS, View, ViewSearch


class InspectionViews:
    """The inspection poses of a cell; computed once per process and cell.

    Attributes:
        views: in the order in which they are taken.
        coverage: share of the onion's surface, pads excepted, seen on the belt or in a view.
        coverage_of_views: the same without what was seen on the belt.

    Raises:
        ConfigError: no pose in reach shows a held onion to the belt camera.
    """

    def __init__(self, config: CellConfig) -> None:
        self.views, self.coverage, self.coverage_of_views = _solve(msgspec.json.encode(config))


@lru_cache(maxsize=8)
def _solve(encoded: bytes) -> tuple[tuple[View, ...], float, float]:
    config = from_dict(msgspec.json.decode(encoded))
    views = ViewSearch(config).best()
    onion = Onion(RADIUS)
    p_WC = camera_pose(config.cameras["belt"])[:3, 3]
    seen = np.any([onion.seen_from(v.X_WT[:3, :3].T @ (p_WC - v.X_WT[:3, 3])) for v in views], axis=0)
    everything = np.where(seen, 1.0, onion.seen_on_belt(config))
    return views, float(everything.mean()), float(seen.mean())


__all__ = ["InspectionViews", "View"]
