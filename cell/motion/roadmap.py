"""A net of arm poses that are free and connected, for ways that no simple route finds.

Built once, by `prepare` or when first needed: tool poses all round the base, at two distances,
three heights and several tilts, joined where the straight joint move between neighbours keeps clear
with an onion in the hand. A way is the shortest one through the net, with every pose left out that
can be.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cell.config import CellConfig
from cell.frames import Array, pose
from cell.limits import tcp_positions
from cell.motion.collision import CollisionModel
from cell.motion.kinematics import Kinematics

_AZIMUTHS = np.radians(np.arange(-90.0, 121.0, 30.0))
_DISTANCES, _HEIGHTS = (0.24, 0.36), (0.06, 0.18, 0.30)
_TILTS = np.radians([(0, 0), (55, 0), (60, -90), (100, -90), (130, -90), (60, 90)])
"""Of the tool from straight down, and towards where: 0 away from the base, else to its sides."""
_NEIGHBOURS = 12
_STEP = 0.10
"""Joint distance between collision checks of a straight move [rad]."""
_MARGIN = 0.008
"""Clearance of the net's own moves [m]."""
_TURN = 0.35
"""How much of tool travel a radian of the fastest joint counts as [m]."""


class Roadmap:
    """The net of one cell. Arm poses are rows (6,) [rad]."""

    def __init__(self, config: CellConfig, kinematics: Kinematics, collision: CollisionModel) -> None:
        self._config, self._kinematics, self._collision = config, kinematics, collision
        self._held = config.onions.diameter[1] / 2

    def prepare(self) -> None:
        """Build the net now; takes a few tenths of a second."""
        assert len(self._net) == 2

    def way(self, q_from: Array, q_to: Array, held_radius: float) -> list[Array]:
        """Arm poses from q_from to q_to, joined by straight joint moves that are free; empty if none."""
        nodes, lengths = self._net
        ends = np.stack([q_from, q_to])
        first, last = (self._reached(q, nodes, held_radius) for q in ends)
        order = _shortest(lengths, self._lengths(q_from, nodes), self._lengths(q_to, nodes), first, last)
        if not order:
            return []
        way = [q_from, *nodes[order], q_to]
        i = 0
        while i < len(way) - 2:  # from each pose straight to the farthest one that can be
            later = next(
                (
                    j
                    for j in range(len(way) - 1, i + 1, -1)
                    if self._free(way[i], way[j][None], held_radius)[0]
                ),
                i + 1,
            )
            way[i + 1 : later] = []
            i += 1
        return way

    @cached_property
    def _net(self) -> tuple[Array, Array]:
        """Nodes (K, 6) [rad], and lengths (K, K) of the free moves between them, else infinite."""
        home = np.array(self._config.arm.home)
        found = [home]
        for azimuth in _AZIMUTHS:
            away, side = (
                np.array([np.cos(azimuth), np.sin(azimuth), 0.0]),
                np.array([-np.sin(azimuth), np.cos(azimuth), 0]),
            )
            for distance in _DISTANCES:
                for height in _HEIGHTS:
                    for tilt, towards in _TILTS:
                        z_T = np.sin(tilt) * (np.cos(towards) * away + np.sin(towards) * side)
                        z_T[2] = -np.cos(tilt)
                        x_T = np.cross(z_T, [0.3, 0.5, 0.8])
                        x_T /= np.linalg.norm(x_T)
                        X_WT = pose(np.column_stack([x_T, np.cross(z_T, x_T), z_T]), distance * away)
                        X_WT[2, 3] = height
                        q = [q for q in self._kinematics.ik(X_WT, home)[:1] if self._kinematics.at_home_in(q)]
                        found += q
        nodes = np.array(found)
        nodes[:, 5] = home[5]  # turning the tool about its axis is free
        nodes = nodes[self._collision.clearance(nodes, held_radius=self._held, flying=True) >= _MARGIN]
        lengths = np.full((len(nodes), len(nodes)), np.inf)
        for i, q in enumerate(nodes):
            away_by = self._lengths(q, nodes)
            near = np.argsort(away_by)[1 : _NEIGHBOURS + 1]
            near = near[np.isinf(lengths[i, near])]
            if not len(near):
                continue
            near = near[self._free(q, nodes[near], self._held, _MARGIN)]
            lengths[i, near] = lengths[near, i] = away_by[near]
        return nodes, lengths

    def _lengths(self, q: Array, nodes: Array) -> Array:
        """How long the moves from q to nodes (K, 6) are, shape (K,) [m]."""
        gripper = self._config.gripper.length
        tool = np.linalg.norm(tcp_positions(nodes, gripper) - tcp_positions(q[None], gripper), axis=1)
        out: Array = tool + _TURN * np.abs(nodes - q).max(axis=1)
        return out

    def _reached(self, q: Array, nodes: Array, held_radius: float) -> NDArray[np.bool_]:
        """Which nodes can be reached straight from q, shape (K,); only the nearest are tried."""
        out = np.zeros(len(nodes), dtype=bool)
        near = np.argsort(self._lengths(q, nodes))[: 2 * _NEIGHBOURS]
        out[near] = self._free(q, nodes[near], held_radius)
        return out

    def _free(
        self, q: Array, others: Array, held_radius: float, margin: float | None = None
    ) -> NDArray[np.bool_]:
        """Which straight joint moves from q to others (K, 6) keep clear, shape (K,)."""
        count = max(2, int(np.ceil(np.linalg.norm(others - q, axis=1).max() / _STEP)) + 1)
        w = np.linspace(0, 1, count)[:, None, None]
        moves = (1 - w) * q + w * others
        clear = self._collision.clearance(moves.reshape(-1, 6), held_radius=held_radius, flying=True)
        clear = clear.reshape(count, -1)
        least = self._config.motion.clearance if margin is None else margin
        out: NDArray[np.bool_] = (clear >= np.minimum(least, np.minimum(clear[0], clear[-1])) - 1e-6).all(
            axis=0
        )
        landed: NDArray[np.bool_] = out & (clear[-1] >= 0.0)
        return landed


def _shortest(
    lengths: Array, start: Array, end: Array, first: NDArray[np.bool_], last: NDArray[np.bool_]
) -> list[int]:
    """Nodes of the shortest way (Dijkstra): in by one of `first`, out by one of `last`; empty if none."""
    best = np.where(first, start, np.inf)
    before = np.full(len(best), -1)
    open_ = np.ones(len(best), dtype=bool)
    while open_.any():
        reach = np.where(open_, best, np.inf)
        i = int(np.argmin(reach))
        if not np.isfinite(reach[i]):
            break  # what is left cannot be reached
        open_[i] = False
        through = best[i] + lengths[i]
        better = open_ & (through < best)
        best[better], before[better] = through[better], i
    total = np.where(last, best + end, np.inf)
    i = int(np.argmin(total))
    if not np.isfinite(total[i]):
        return []
    order = [i]
    while before[order[-1]] >= 0:
        order.append(int(before[order[-1]]))
    return order[::-1]
