"""How near the person is to the arm, from the person camera's depth alone.

Everything that stands before the empty cell is the person, unless it is the arm (known from its
joints) or produce (what lies low on the belt and hangs together with nothing that rises from it).
No learned model has a say here. What the arm hides for a moment stays where it was last seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.config import CellConfig
from cell.frames import Array
from cell.perception.scene import EmptyScene
from cell.wire.types import Frame

STRIDE = 3
_MARGIN = (0.015, 0.006)
"""What stands out from the empty cell: so much [m], and so much per squared metre of depth [1/m]."""
_ARM_MARGIN = 0.025
"""Points this near to the arm are taken for the arm [m]."""
_SUPPORT = 2
"""A foreground pixel counts if so many of its 9 are foreground: a finger may be one pixel wide."""
_TOUCH = 0.03
"""What is taken for the arm may be a hand where it is beside the person and as far away, within this [m]."""
_LOW = 0.11
"""Below this height over the belt something may be produce [m]."""
_VOXEL = 0.015
_ONION_MARGIN, _GRASPING, _FINGERS = 0.012, 0.022, 16
"""Known onions are taken out with this margin [m], unless a hand closes round them: so many of its points
so near to their surface [m]."""
_LARGEST = 0.11
"""What lies on the belt and is longer than this is no onion [m]."""
_KEEP = 0.6
"""Longest time that what the arm hides is remembered [s]."""
_HIDDEN_BY = 0.03
_NEAREST = 500
"""So many points, the nearest to the arm, are kept for distances to the moving arm."""
_RANGE = 4.0
_THICKNESS, _TRUNK, _FAR = 0.06, 0.10, 0.5
"""A camera sees one side of a person: behind each point there may be so much more of a hand [m], and so
much of a trunk, which is nearest where the arm is farther away than a hand's reach [m]."""
_FEET, _STEP = 0.9, 0.02
"""Of who is farther away than this an unseen foot behind the belt may be nearer, by so much [m]."""


@dataclass(frozen=True)
class Cloud:
    """What one frame shows of the person.

    Attributes:
        t: exposure [s].
        p_WP: points of the person, shape (M, 3) [m]; those of them nearest to the arm come first.
        seen_at: when each point was last seen, shape (M,) [s].
        share: of the pixels that had a depth reading.
        eye: the camera (3,) [m]; None: all sides of the person are seen.
    """

    t: float
    p_WP: Array
    seen_at: Array
    share: float
    eye: Array | None = None

    def distance(self, spheres: Array) -> tuple[float, Array]:
        """Least distance [m] to spheres (S, 4) (centre, radius) and the point (3,) it is to.

        Points count with what may be behind them. Infinity and the origin when nobody is seen.
        """
        if not len(self.p_WP):
            return float("inf"), np.zeros(3)
        near = self.p_WP[:_NEAREST]
        gaps = _gaps(near, spheres)
        if self.eye is not None:
            rays = near - self.eye
            thickness = np.where(gaps < _FAR, _THICKNESS, _TRUNK)
            behind = near + (thickness / np.linalg.norm(rays, axis=1))[:, None] * rays
            near = np.concatenate([near, behind])
            gaps = np.concatenate([gaps, _gaps(behind, spheres)])
        at = int(np.argmin(gaps))
        gap = float(gaps[at])
        if self.eye is not None:
            gap -= float(np.clip(gap - _FEET, 0.0, _STEP))
        return gap, near[at]


class Separation:
    """The person's points, frame by frame. Decides nothing.

    Args:
        config: the cell, with a camera called "person".
    """

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self.scene = EmptyScene(config, "person", STRIDE)
        belt, top = config.belt, config.belt.top_z
        self._low = np.array([belt.x[0] - 0.02, belt.y[0] - 0.02, top - 0.03])
        self._high = np.array([belt.x[1] + 0.15, belt.y[1] + 0.02, top + 0.25])
        finite = np.minimum(self.scene.depth, _RANGE)
        self._limit = (finite - (_MARGIN[0] + _MARGIN[1] * finite**2)).astype(np.float32)
        self._last: Cloud | None = None

    def look(self, frame: Frame, arm: Array, onions: Array) -> Cloud:
        """Points of the person in a frame.

        Args:
            frame: of the person camera.
            arm: spheres that enclose arm, gripper and held onion at the exposure, (S, 4) [m].
            onions: spheres of produce known to lie on the belt, (K, 4) [m].
        """
        depth = frame.depth[::STRIDE, ::STRIDE]
        share = float(np.count_nonzero(depth)) / depth.size
        before = self._foreground(depth)
        rows, columns = np.nonzero(before)
        p = self.scene.p_WC + depth[rows, columns, None] * self.scene.rays_W[rows, columns].astype(float)
        gaps = _gaps(p, arm)
        is_arm = gaps < _ARM_MARGIN
        person = _mask(~is_arm)
        person[person] = self._not_produce(p[person], onions)
        person |= self._touching(depth, rows, columns, is_arm, person)
        points, gaps, seen = p[person], gaps[person], np.full(int(person.sum()), frame.t)
        if self._last is not None and len(self._last.p_WP):
            hidden = self._hidden(depth, rows[is_arm], columns[is_arm], frame.t)
            remembered = self._last.p_WP[hidden]
            points = np.concatenate([points, remembered])
            gaps = np.concatenate([gaps, _gaps(remembered, arm)])
            seen = np.concatenate([seen, self._last.seen_at[hidden]])
        order = np.argsort(gaps, kind="stable")
        self._last = Cloud(frame.t, points[order], seen[order], share, self.scene.p_WC)
        return self._last

    def _touching(
        self,
        depth: NDArray[np.float32],
        rows: NDArray[np.intp],
        columns: NDArray[np.intp],
        is_arm: NDArray[np.bool_],
        person: NDArray[np.bool_],
    ) -> NDArray[np.bool_]:
        """Which pixels that are taken for the arm are seen in touch with the person.

        A hand so near to the arm that its points are within the margin would else be cut off at the
        wrist, and seem farther away the nearer it comes.
        """
        near = np.zeros(depth.shape, np.float32)
        near[rows[person], columns[person]] = depth[rows[person], columns[person]]
        far = np.where(near > 0.0, near, np.float32(np.inf))
        kernel = np.ones((3, 3), np.uint8)
        most, least = np.asarray(cv2.dilate(near, kernel)), np.asarray(cv2.erode(far, kernel))
        z = depth[rows, columns]
        beside = (most[rows, columns] > z - _TOUCH) & (least[rows, columns] < z + _TOUCH)
        return np.asarray(is_arm & beside)

    def _foreground(self, depth: NDArray[np.float32]) -> NDArray[np.bool_]:
        """What stands before the empty cell and is no single stray pixel."""
        before = (depth > 0.0) & (depth < self._limit)
        count = cv2.boxFilter(before.astype(np.float32), -1, (3, 3), normalize=False)
        return np.asarray(before & (count >= _SUPPORT))

    def _not_produce(self, p: Array, onions: Array) -> NDArray[np.bool_]:
        """Which points (N, 3) are not produce on the belt."""
        belt = self._config.belt
        low: NDArray[np.bool_] = (
            (p[:, 2] < belt.top_z + _LOW)
            & (p[:, 0] > belt.x[0] - 0.02) & (p[:, 0] < belt.x[1] + 0.02)
            & (p[:, 1] > belt.y[0]) & (p[:, 1] < belt.y[1])
        )  # fmt: skip
        if not low.any():
            return ~low
        candidates = np.flatnonzero(low)
        inside = np.zeros(len(candidates), dtype=bool)
        if len(onions):
            inside = _gaps(p[candidates], onions) < _ONION_MARGIN
        zone = _mask(((p > self._low) & (p < self._high)).all(axis=1))
        zone[candidates[inside]] = False
        parts = self._parts(p, np.flatnonzero(zone), low)
        keep = _mask(~low)
        keep[parts] = True
        if inside.any() and len(parts):
            keep[candidates[inside]] = self._grasped(p[candidates[inside]], p[parts], onions)
        return keep

    def _parts(self, p: Array, zone: NDArray[np.intp], low: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Indices of low points that hang together with higher ones, or are too large for an onion."""
        from scipy import ndimage

        cells = ((p[zone] - self._low) / _VOXEL).astype(np.intp)
        shape = tuple(((self._high - self._low) / _VOXEL).astype(int) + 1)
        grid = np.zeros(shape, dtype=bool)
        grid[tuple(cells.T)] = True
        labels, count = ndimage.label(grid, structure=np.ones((3, 3, 3)))
        of = labels[tuple(cells.T)]
        person = np.zeros(count + 1, dtype=bool)
        person[of[~low[zone]]] = True
        for k, extent in enumerate(ndimage.find_objects(labels), start=1):
            longest = max((s.stop - s.start) * _VOXEL for s in extent[:2])
            person[k] |= longest > _LARGEST + 2 * _VOXEL
        out: NDArray[np.intp] = zone[person[of] & low[zone]]
        return out

    def _grasped(self, p: Array, hand: Array, onions: Array) -> NDArray[np.bool_]:
        """Which produce points (N, 3) belong to an onion that a hand is at."""
        at_hand = _mask((_pair_gaps(hand, onions) < _GRASPING).sum(axis=0) >= _FINGERS)
        nearest = _pair_gaps(p, onions).argmin(axis=1)
        return np.asarray(at_hand[nearest])

    def _hidden(
        self,
        depth: NDArray[np.float32],
        rows: NDArray[np.intp],
        columns: NDArray[np.intp],
        now: float,
    ) -> NDArray[np.bool_]:
        """Which of the last points the arm hides now."""
        assert self._last is not None
        mask = np.zeros(depth.shape, dtype=np.uint8)
        mask[rows, columns] = 1
        arm = np.asarray(cv2.dilate(mask, np.ones((3, 3), np.uint8)))
        row, column, z = self.scene.pixels(self._last.p_WP)
        seen = depth[row, column]
        behind = (seen > 0.0) & (seen < z - _HIDDEN_BY)
        recent = now - self._last.seen_at <= _KEEP
        return np.asarray((arm[row, column] > 0) & (behind | (seen == 0.0)) & recent)


def _mask(values: object) -> NDArray[np.bool_]:
    """A fresh array of booleans."""
    return np.array(values, dtype=np.bool_)


def _pair_gaps(p: Array, spheres: Array) -> Array:
    """Distances (N, S) [m] of points (N, 3) from the surfaces of spheres (S, 4)."""
    # |p - c|^2 expanded: one matrix product instead of N x S x 3 differences.
    c = spheres[:, :3]
    squared = (p * p).sum(1)[:, None] + (c * c).sum(1) - 2.0 * (p @ c.T)
    out: Array = np.sqrt(np.maximum(squared, 0.0)) - spheres[:, 3]
    return out


def _gaps(p: Array, spheres: Array) -> Array:
    """Distance (N,) [m] of each point (N, 3) from the nearest surface; infinity without spheres."""
    if not len(spheres):
        return np.full(len(p), np.inf)
    out: Array = _pair_gaps(p, spheres).min(axis=1)
    return out
