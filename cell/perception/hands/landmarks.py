"""The 21 landmarks of one hand: MediaPipe's hand-landmark network with its own decoding."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.frames import Array
from cell.perception.hands.models import LANDMARK, Network, read_model
from cell.perception.hands.roi import Roi, cut, rotation, upright_angle

SIDE = 224
"""Side of the network's input [px]."""
_STEADY = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18]
"""Landmarks that bound the next frame's region: without the fingers' ends, which move fast."""
_SHIFT = -0.1
_ENLARGE = 2.0
"""From the bounding box to the next region: towards the fingers by a tenth, and enlarged."""


@dataclass(frozen=True, eq=False)
class Hand:
    """One hand in one image.

    Attributes:
        landmarks: (21, 2) [px].
        world: (21, 3) [m] about the hand's centre, in the camera's axes (x right, y down,
            z away); its scale is the network's guess.
        presence: that this is a hand, 0..1. p_right: that it is a right hand, for an image that
            is not mirrored, 0..1.
        score: of the palm detection it started from, 0..1.
        roi: where it was looked for.
    """

    landmarks: Array
    world: Array
    presence: float
    p_right: float
    score: float
    roi: Roi

    def next_roi(self) -> Roi:
        """Where to look for it in the next image."""
        return roi_from(self.landmarks)


class LandmarkNetwork:
    """The hand-landmark network.

    Args:
        folder: of the network's file; the cache if None.
        threads: CPU threads of one inference.

    Raises:
        HandModelError: the network is missing or wrong.
    """

    def __init__(self, folder: Path | None = None, threads: int = 1) -> None:
        shapes = ((1, 63), (1, 1), (1, 1), (1, 63))
        self._network = Network(read_model(LANDMARK, folder), SIDE, shapes, threads)

    def find(self, rgb: NDArray[np.uint8], roi: Roi, score: float) -> Hand:
        """The hand that fills `roi`; the caller judges its presence.

        Args:
            rgb: shape (H, W, 3) uint8.
            roi: turned so that the fingers point up.
            score: of the detection, handed on.
        """
        raw, presence, p_right, world = self._network.run(cut(rgb, roi, SIDE, replicate=True))
        points = raw.reshape(21, 3)[:, :2].astype(float)
        metres = world.reshape(21, 3).astype(float)
        metres[:, :2] = metres[:, :2] @ rotation(roi.angle).T
        return Hand(
            roi.to_image(points, SIDE), metres, float(presence[0, 0]), float(p_right[0, 0]), score, roi
        )


def roi_from(landmarks: Array) -> Roi:
    """The region of the next image from the landmarks (21, 2) [px] of this one."""
    middle = ((landmarks[5] + landmarks[13]) / 2 + landmarks[9]) / 2
    angle = upright_angle(landmarks[0], middle)
    turn = rotation(angle)
    points = landmarks[_STEADY] @ turn  # in the frame turned by -angle
    low, high = points.min(axis=0), points.max(axis=0)
    width, height = high - low
    u, v = turn @ ((low + high) / 2 + (0.0, _SHIFT * height))
    return Roi(float(u), float(v), float(_ENLARGE * max(width, height)), angle)
