"""What depth adds to the networks: where a hand is, whether it has a hand's size, and nothing else in view.

The networks know no scale. Depth does: a face, a poster or a fold of cloth that looks like a
hand has the wrong size at its distance, or no single distance at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.frames import Array, Pinhole
from cell.perception.hands.landmarks import Hand

SLAB = 0.35
"""What is nearer or farther than a hand by more than this belongs to something else [m]. The forearm
must stay whole: a stump of it can look like a thumb."""
_GREY = 128
_RIM = np.ones((7, 7), np.uint8)
"""So far from a reading on the hand a pixel without a reading may still be the hand's."""
_REACH = 0.10
"""So far from a reading on the hand the rest of it may be in the shadow of something nearer [m]."""
_PALM = [0, 1, 5, 9, 13, 17]
_KNUCKLES = [5, 9, 13, 17]
_INTO_HAND = 0.012
"""From the surface that the camera sees to the middle of the palm [m]: half a hand's thickness."""
_SAME_SURFACE = 0.05
"""Readings farther than this from the nearest cluster belong to what is behind the hand [m]."""
_SAME_HAND = 0.20
"""Readings farther than this from where a hand is expected are not its own [m]."""
_LEAST_READINGS = 12
_SPAN = (0.045, 0.15)
"""Largest distance between wrist and knuckles as the camera sees it [m]. From wrist to middle knuckle
hands measure 0.07 to 0.11 m; seen from the end, knuckles are still 0.06 to 0.09 m wide. Faces are wider."""


@dataclass(frozen=True, eq=False)
class PalmPoint:
    """A palm in space.

    Attributes:
        p_CP: its middle in the camera frame (3,) [m].
        span: largest distance between wrist and knuckles, across the line of sight [m].
        readings: depth pixels behind it.
    """

    p_CP: Array
    span: float
    readings: int

    @property
    def plausible(self) -> bool:
        """Whether the size is a hand's."""
        return _SPAN[0] <= self.span <= _SPAN[1]


def locate_palm(
    hand: Hand, depth: NDArray[np.float32], pinhole: Pinhole, distance: float | None = None
) -> PalmPoint | None:
    """The middle of a palm from depth.

    Args:
        hand: landmarks in the image that `depth` is aligned to.
        depth: shape (H, W) [m], 0 where there is no reading.
        pinhole: intrinsics of both.
        distance: about where the hand is along the optical axis [m]; None: wherever it is nearest.

    Returns:
        None where too few depth pixels lie on the palm.
    """
    z = _palm_depths(hand.landmarks, depth)
    if distance is not None:  # not on something before the hand that hides a part of it
        z = z[np.abs(z - distance) <= _SAME_HAND]
    if len(z) < _LEAST_READINGS:
        return None
    # The hand is in front of what is behind it: take the nearest surface that is not a few stray pixels.
    near = float(np.percentile(z, 15))
    on_hand = z[np.abs(z - near) <= _SAME_SURFACE]
    if len(on_hand) < _LEAST_READINGS:
        return None
    middle = float(np.median(on_hand)) + _INTO_HAND
    p_CL = pinhole.back_project(hand.landmarks[_PALM], np.full(len(_PALM), middle))
    span = float(np.linalg.norm(p_CL[:, None] - p_CL[None], axis=2).max())
    return PalmPoint(p_CL.mean(axis=0), span, len(on_hand))


def isolate(
    rgb: NDArray[np.uint8], depth: NDArray[np.float32], distances: list[float], focal: float
) -> NDArray[np.uint8]:
    """The image with everything grey that is not at the distance of one of the hands.

    The networks then cannot take another hand for the one that is meant, nor see a thumb in the
    background. A pixel without a reading counts as the farther of the nearest readings on both
    sides of it in its row: what one imager cannot see past something near belongs to what is
    behind. If it touches the hand it stays, because the edges of a hand have no readings, and so
    it does as far as a hand reaches where something nearer than the hand throws that shadow.

    Args:
        rgb: shape (H, W, 3) uint8. depth: shape (H, W) [m], aligned, 0 where there is no reading.
        distances: of the hands along the optical axis [m].
        focal: of the image [px].
    """
    hole = depth <= 0.0
    keep = np.zeros(depth.shape, bool)
    for distance in distances:
        # 1 is nearer than the slab, 2 in it, 3 farther; 0 no reading.
        place = 1 + (depth >= np.float32(distance - SLAB)).view(np.uint8)
        place += depth > np.float32(distance + SLAB)
        place *= ~hole
        here = place == 2
        rim = cv2.dilate(here.view(np.uint8), _RIM).view(bool)
        left, right = _last(place), _last(place[:, ::-1])[:, ::-1]
        reach = 2 * int(_REACH * focal / distance) + 1
        shadow = (np.minimum(left, right) == 1) & _dilated(here, reach)
        keep |= here | (hole & (rim | (np.maximum(left, right) == 2) | shadow))
    return np.asarray(cv2.copyTo(rgb, keep.view(np.uint8), np.full_like(rgb, _GREY)), np.uint8)


def _dilated(mask: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    """The mask grown by a square of `side` pixels."""
    kernel = np.ones((side, side), np.uint8)
    return np.asarray(cv2.dilate(mask.view(np.uint8), kernel).view(bool))


def _last(place: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """In each row the last value so far that is not 0, or 0."""
    # Values that also carry their column: the largest so far is the last one.
    column = np.arange(4, 4 * place.shape[1] + 4, 4, dtype=np.uint16)
    mark = (column + place) * (place > 0)
    return np.asarray(np.maximum.accumulate(mark, axis=1) & 3, np.uint8)


def _palm_depths(landmarks: Array, depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Depth readings on a grid from the wrist to the knuckles [m]."""
    knuckles = landmarks[_KNUCKLES]
    across = np.linspace(0.0, 3.0, 10)
    i = np.minimum(across.astype(int), 2)
    row = knuckles[i] + (across - i)[:, None] * (knuckles[i + 1] - knuckles[i])
    along = np.linspace(0.3, 1.0, 8)[:, None, None]
    grid = (landmarks[0] + along * (row - landmarks[0])).reshape(-1, 2)
    if not np.isfinite(grid).all():
        return np.zeros(0, np.float32)
    height, width = depth.shape
    grid = np.clip(grid, -1.0, (width, height))
    u, v = np.rint(grid).astype(int).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    z = depth[v[inside], u[inside]]
    return np.asarray(z[np.isfinite(z) & (z > 0.0)], np.float32)
