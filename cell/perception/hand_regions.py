"""Where in the person's points a hand may be: what depth says before any network looks.

A hand that works or makes a sign is the end of an arm that reaches towards the belt or towards
the camera. Both ends are offered; which of them is a hand, the networks say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.cameras import camera_pose
from cell.config import CellConfig
from cell.frames import Array

_TIP = 0.08
"""A hand reaches this far back from its foremost point [m]."""
_LEAST_POINTS = 6
_LOW = 0.45
"""So high over the belt a head may be that bends over it; the foremost lower point is a hand's [m]."""
_SIDE = 0.75
"""Half the width of the place in which the person works [m]."""
_TRUNK, _SHOULDERS = 0.18, 0.55
"""Points nearer than this to the trunk's axis are the trunk's, those higher than this the head's [m]."""
_BESIDE, _OVER = 0.02, 0.30
"""What is so little beside the person's bin and so low over it is a hand at the bin [m]."""


@dataclass(frozen=True)
class Region:
    """The end of an arm: middle (3,) [m] of its foremost points, and how many they are."""

    p_W: Array
    points: int


def hand_regions(p_WP: Array, config: CellConfig) -> tuple[Region, ...]:
    """The ends of arms in the person's points (M, 3) [m]: towards the robot, the camera, and at the bin.

    Only of a person near the working place; nothing else makes a sign or handles onions.
    """
    station = np.array(config.person.station)
    near = (np.abs(p_WP[:, 1] - station[1]) < _SIDE) & (p_WP[:, 0] < station[0] + _SIDE)
    near &= p_WP[:, 2] > config.belt.top_z - 0.02
    p = p_WP[near]
    if len(p) < _LEAST_POINTS:
        return ()
    trunk = _trunk(p_WP, station)
    arms = p[(np.linalg.norm(p[:, :2] - trunk, axis=1) > _TRUNK) & (p[:, 2] < _SHOULDERS)]
    if len(arms) < _LEAST_POINTS:
        return ()
    camera = camera_pose(config.cameras["person"])[:3, 3]
    found: list[Region] = []
    low = np.where(arms[:, 2] < config.belt.top_z + _LOW, arms[:, 0], np.inf)
    for measure in (arms[:, 0], low, np.linalg.norm(arms - camera, axis=1)):
        at = np.argsort(measure, kind="stable")[_LEAST_POINTS // 2]
        if np.isfinite(measure[at]):
            _add(found, arms[np.linalg.norm(arms - arms[at], axis=1) < _TIP])
    b = config.person.bin
    over = (np.abs(p[:, :2] - b.center[:2]) < np.array(b.size[:2]) / 2 + _BESIDE).all(axis=1)
    _add(found, p[over & (p[:, 2] < b.center[2] + _OVER)])
    return tuple(found)


def _add(found: list[Region], tip: Array) -> None:
    """Add the region of these points if they are enough, and none of those there are."""
    if len(tip) < _LEAST_POINTS:
        return
    region = Region(tip.mean(axis=0), len(tip))
    if all(np.linalg.norm(region.p_W - other.p_W) > _TIP for other in found):
        found.append(region)


def _trunk(p_WP: Array, station: Array) -> Array:
    """Middle (2,) [m] of the person seen from above: of what is higher than the hips."""
    upper = p_WP[(p_WP[:, 2] > 0.0) & (np.abs(p_WP[:, 1] - station[1]) < _SIDE)]
    if not len(upper):
        return station
    out: Array = np.median(upper[:, :2], axis=0)
    return out
