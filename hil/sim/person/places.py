"""Where a person puts onions down."""

from __future__ import annotations

import numpy as np

from cell.config import CellConfig
from cell.frames import Array
from cell.settings import BinConfig

_SHY = 0.15
"""Not this near to the robot's tool, if there is another place [m]."""
_REACH_Y = (-0.36, 0.30)
"""Along the belt, where a person can put things without a step aside, from the station [m]."""


def drop_place(bin: BinConfig, rng: np.random.Generator) -> Array:
    """Where to let go of an onion over a bin (3,) [m]: about its middle."""
    slack = np.maximum(np.array(bin.size[:2]) / 2 - 0.07, 0.0)
    x, y = np.array(bin.center[:2]) + rng.uniform(-1.0, 1.0, 2) * slack
    return np.array([x, y, bin.center[2] + bin.drop_height])


def free_place(config: CellConfig, others: Array, tool: Array, rng: np.random.Generator) -> Array:
    """A free place (2,) [m] on the strip for sorted onions.

    Args:
        others: centres of all other onions (N, 2) [m]. tool: the robot's tool (2,) [m].
    """
    x = sum(config.person.sorted_x) / 2
    station = config.person.station[1]
    ys = station + np.arange(_REACH_Y[0], _REACH_Y[1] + 1e-9, 0.02)
    places = np.column_stack([np.full(len(ys), x), ys]) + rng.uniform(-0.006, 0.006, (len(ys), 2))
    room = np.full(len(places), np.inf)
    if len(others):
        room = np.linalg.norm(places[:, None] - others[None], axis=2).min(axis=1)
    room = np.where(np.linalg.norm(places - tool, axis=1) < _SHY, 0.5 * room, room)
    enough = np.flatnonzero(room >= 1.15 * config.onions.diameter[1])
    if not len(enough):
        return np.asarray(places[int(np.argmax(room))])
    return np.asarray(places[enough[int(np.argmin(np.abs(places[enough, 1] - station)))]])
