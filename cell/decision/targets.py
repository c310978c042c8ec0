"""Which onion next, and how to turn the gripper so that the fingers fit between neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.config import CellConfig
from cell.frames import Array
from cell.perception.tracking import Track

_YAWS = np.linspace(0.0, np.pi, 12, endpoint=False)
_FINGER = (0.014, 0.022)
"""Thickness along the closing direction and width across it [m]."""
_ENOUGH = 0.012
"""Clearance beyond which more does not matter [m]."""


@dataclass(frozen=True)
class Grasp:
    """An onion and the gripper's yaw about world z [rad]; clearance to neighbours [m]."""

    track: Track
    yaw: float
    clearance: float


def choose(waiting: list[Track], everything: tuple[Track, ...], p_WT: Array, config: CellConfig) -> Grasp:
    """The best onion to take next: roomy enough, then nearest to the tool at `p_WT` (3,) [m].

    Onions that failed before come after fresh ones. `waiting` must not be empty.
    """
    grasps = [best_yaw(track, everything, config) for track in waiting]

    def rank(g: Grasp) -> tuple[int, float]:
        crowded = max(0.0, _ENOUGH - g.clearance)
        return g.track.attempts, 20.0 * crowded + float(np.linalg.norm(g.track.p_WO - p_WT))

    return min(grasps, key=rank)


def best_yaw(track: Track, everything: tuple[Track, ...], config: CellConfig) -> Grasp:
    """The yaw with the most room for the open fingers; among roomy ones the one nearest zero."""
    others = [t for t in everything if t.id != track.id]
    half = config.gripper.stroke / 2 + _FINGER[0] / 2

    def room(yaw: float) -> float:
        axis = np.array([np.cos(yaw), np.sin(yaw)])
        across = np.array([-axis[1], axis[0]])
        least = np.inf
        for other in others:
            d = (other.p_WO - track.p_WO)[:2]
            for side in (-half, half):
                dx = max(0.0, abs(float(d @ axis) - side) - _FINGER[0] / 2)
                dy = max(0.0, abs(float(d @ across)) - _FINGER[1] / 2)
                least = min(least, float(np.hypot(dx, dy)) - other.radius)
        return least

    rooms = [room(float(yaw)) for yaw in _YAWS]
    turn = [min(yaw, np.pi - yaw) for yaw in _YAWS]
    best = max(range(len(_YAWS)), key=lambda i: (min(rooms[i], _ENOUGH), -turn[i]))
    # A half turn is the same grasp; take the smaller rotation of the wrist.
    yaw = float(_YAWS[best])
    return Grasp(track, yaw if yaw <= np.pi / 2 else yaw - np.pi, rooms[best])
