"""Square regions of an image, possibly turned, and cutting them out."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.frames import Array

_BITS = 5
_STEPS = 1 << _BITS
"""Positions between two pixels."""
_LIMITS = (-30_000.0, 30_000.0)
"""Pixel coordinates that OpenCV's remapping can express."""


@dataclass(frozen=True)
class Roi:
    """A square of the image; pixel (0, 0) is the centre of the top-left pixel.

    Attributes:
        u, v: centre [px]. side: [px].
        angle: by which the square is turned, from image x (right) towards image y (down) [rad].
    """

    u: float
    v: float
    side: float
    angle: float = 0.0

    def iou(self, other: Roi) -> float:
        """Intersection over union of both squares as if neither was turned."""
        half = (self.side + other.side) / 2
        width = min(half - abs(self.u - other.u), self.side, other.side)
        height = min(half - abs(self.v - other.v), self.side, other.side)
        if width <= 0 or height <= 0:
            return 0.0
        return width * height / (self.side**2 + other.side**2 - width * height)

    def contains(self, u: float, v: float) -> bool:
        """Whether a pixel lies inside (the square's turn is not looked at)."""
        return abs(u - self.u) <= self.side / 2 and abs(v - self.v) <= self.side / 2

    def to_image(self, points: Array, size: int) -> Array:
        """Points (..., 2) of the cut-out of `size` x `size` pixels -> image points (..., 2) [px]."""
        return (points - size / 2) @ rotation(self.angle).T * (self.side / size) + (self.u, self.v)


def rotation(angle: float) -> Array:
    """Turn by `angle` [rad] from x towards y, shape (2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi) [rad]."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def upright_angle(start: Array, end: Array) -> float:
    """By how much the direction from `start` to `end` (2,) [px] is turned away from image up [rad]."""
    return wrap(np.pi / 2 - np.arctan2(-(end[1] - start[1]), end[0] - start[0]))


def cut(rgb: NDArray[np.uint8], roi: Roi, size: int, replicate: bool) -> NDArray[np.uint8]:
    """The square `roi`, brought to `size` x `size` pixels.

    Pixel (i, j) of the result shows the image at `roi.to_image((i, j))`: the networks were
    trained with this convention, in which pixel `size / 2` is the square's centre. Half-pixel
    centres would move the landmarks by up to 6 px. Interpolation is linear between positions
    rounded to 1/32 px, as in the OpenCV that MediaPipe contains; exact positions would move the
    landmarks by 0.2 px.

    Args:
        rgb: shape (H, W, 3) uint8.
        roi: may reach beyond the image.
        size: [px].
        replicate: continue the image's border outwards, instead of black.
    """
    turn = rotation(roi.angle) * (roi.side / size)
    start = np.array([roi.u, roi.v]) - turn @ np.full(2, size / 2)
    along = np.arange(size)
    x, y = (
        np.rint(_STEPS * np.clip(turn[k, 0] * along + (turn[k, 1] * along + start[k])[:, None], *_LIMITS))
        for k in (0, 1)
    )
    x, y = x.astype(np.int32), y.astype(np.int32)
    whole = np.stack([x >> _BITS, y >> _BITS], axis=-1).astype(np.int16)
    fraction = ((y & (_STEPS - 1)) * _STEPS + (x & (_STEPS - 1))).astype(np.uint16)
    border = cv2.BORDER_REPLICATE if replicate else cv2.BORDER_CONSTANT
    return np.asarray(cv2.remap(rgb, whole, fraction, cv2.INTER_LINEAR, borderMode=border), np.uint8)
