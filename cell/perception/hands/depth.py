"""Where a hand is in space, and whether its size fits a hand: depth against landmarks.

The networks know no scale. Depth does: a face, a poster or a fold of cloth that looks like a
hand has the wrong size at its distance, or no single distance at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.frames import Array, Pinhole
from cell.perception.hands.landmarks import Hand

_PALM = [0, 1, 5, 9, 13, 17]
_KNUCKLES = [5, 9, 13, 17]
_INTO_HAND = 0.012
"""From the surface that the camera sees to the middle of the palm [m]: half a hand's thickness."""
_SAME_SURFACE = 0.05
"""Readings farther than this from the nearest cluster belong to what is behind the hand [m]."""
_LEAST_READINGS = 12
_SCALE = (0.55, 1.7)
"""Real over assumed size: hands measure 0.8 to 1.2 of the networks' mean hand; the rest is their error."""


@dataclass(frozen=True, eq=False)
class PalmPoint:
    """A palm in space.

    Attributes:
        p_CP: its middle in the camera frame (3,) [m].
        scale: the hand's real size over the size the landmark network assumes.
        width: index to little knuckle [m]. readings: depth pixels behind it.
    """

    p_CP: Array
    scale: float
    width: float
    readings: int

    @property
    def plausible(self) -> bool:
        """Whether the size is a hand's."""
        return _SCALE[0] <= self.scale <= _SCALE[1]


def locate_palm(hand: Hand, depth: NDArray[np.float32], pinhole: Pinhole) -> PalmPoint | None:
    """The middle of a palm from depth.

    Args:
        hand: landmarks in the image that `depth` is aligned to.
        depth: shape (H, W) [m], 0 where there is no reading.
        pinhole: intrinsics of both.

    Returns:
        None where too few depth pixels lie on the palm.
    """
    z = _palm_depths(hand.landmarks, depth)
    if len(z) < _LEAST_READINGS:
        return None
    # The hand is in front of what is behind it: take the nearest surface that is not a few stray pixels.
    near = float(np.percentile(z, 15))
    on_hand = z[np.abs(z - near) <= _SAME_SURFACE]
    if len(on_hand) < _LEAST_READINGS:
        return None
    distance = float(np.median(on_hand)) + _INTO_HAND
    centre = hand.landmarks[_PALM].mean(axis=0)
    scale = distance / (pinhole.fx * _metres_per_pixel(hand))
    width = scale * float(np.linalg.norm(hand.world[5] - hand.world[17]))
    return PalmPoint(pinhole.back_project(centre, distance), scale, width, len(on_hand))


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
    u, v = np.rint(grid).astype(int).T
    height, width = depth.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    z = depth[v[inside], u[inside]]
    return np.asarray(z[np.isfinite(z) & (z > 0.0)], np.float32)


def _metres_per_pixel(hand: Hand) -> float:
    """Of the world landmarks, fitted to the image landmarks: free of how the hand is turned."""
    world = hand.world[:, :2] - hand.world[:, :2].mean(axis=0)
    image = hand.landmarks - hand.landmarks.mean(axis=0)
    return max(float((world * image).sum()), 1e-9) / max(float((image * image).sum()), 1e-9)
