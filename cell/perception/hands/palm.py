"""Finds palms: MediaPipe's palm detector with its own decoding.

Single-shot detector on 192 x 192 pixels: 2016 anchors, each with a score, a box and seven
keypoints. Parameters as in MediaPipe 0.10.21's graph (palm_detection_cpu).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.frames import Array
from cell.perception.hands.models import PALM, Network, read_model
from cell.perception.hands.roi import Roi, cut, upright_angle

SIDE = 192
"""Side of the network's input [px]."""
_LAYERS = ((8, 2), (16, 6))
"""Stride [px] and anchors per cell."""
_LOGIT_LIMIT = 100.0
_SAME_PALM = 0.3
"""IoU above which two boxes are the same palm."""
_WRIST, _MIDDLE_MCP = 0, 2
"""Keypoints that give the hand's direction."""
_SHIFT = -0.5
_ENLARGE = 2.6
"""From the palm's box to the hand: moved towards the fingers by half the box, and enlarged."""


@dataclass(frozen=True, eq=False)
class Palm:
    """One palm.

    Attributes:
        box: (4,) x0, y0, x1, y1 [px] of an upright square's palm; for a turned one the same box
            about its centre in the image. keypoints: (7, 2) [px], 0 = wrist, 2 = middle MCP.
        score: 0..1.
    """

    box: Array
    keypoints: Array
    score: float

    def to_image(self, roi: Roi) -> Palm:
        """From the network's pixels to those of the image that `roi` was cut out of."""
        centre = roi.to_image((self.box[:2] + self.box[2:]) / 2, SIDE)
        half = (self.box[2:] - self.box[:2]) / 2 * (roi.side / SIDE)
        return Palm(
            np.concatenate([centre - half, centre + half]), roi.to_image(self.keypoints, SIDE), self.score
        )

    def roi(self) -> Roi:
        """The square around the whole hand, turned so that its fingers point up."""
        angle = upright_angle(self.keypoints[_WRIST], self.keypoints[_MIDDLE_MCP])
        width, height = self.box[2:] - self.box[:2]
        centre = (self.box[:2] + self.box[2:]) / 2
        u = centre[0] - _SHIFT * height * np.sin(angle)
        v = centre[1] + _SHIFT * height * np.cos(angle)
        return Roi(float(u), float(v), float(_ENLARGE * max(width, height)), angle)


class PalmDetector:
    """The palm detector.

    Args:
        folder: of the network's file; the cache if None.
        threads: CPU threads of one inference.

    Raises:
        HandModelError: the network is missing or wrong.
    """

    def __init__(self, folder: Path | None = None, threads: int = 1) -> None:
        shapes = ((1, len(ANCHORS), 18), (1, len(ANCHORS), 1))
        self._network = Network(read_model(PALM, folder), SIDE, shapes, threads)

    def detect(self, rgb: NDArray[np.uint8], roi: Roi, threshold: float) -> tuple[Palm, ...]:
        """Palms inside a square of the image, the most certain first.

        Args:
            rgb: shape (H, W, 3) uint8.
            roi: the square; what lies outside the image is black.
            threshold: least score, 0..1.
        """
        boxes, logits = self._network.run(cut(rgb, roi, SIDE, replicate=False))
        return tuple(p.to_image(roi) for p in suppress(decode(boxes[0], logits[0], threshold)))


def letterbox(width: int, height: int) -> Roi:
    """The square that shows a whole image of this size [px], centred."""
    return Roi(width / 2, height / 2, float(max(width, height)))


def _anchors() -> Array:
    """Anchor centres (2016, 2), 0..1, in the network's order."""
    out = []
    for stride, count in _LAYERS:
        cells = SIDE // stride
        y, x = np.divmod(np.arange(cells * cells), cells)
        out.append(np.repeat((np.column_stack([x, y]) + 0.5) / cells, count, axis=0))
    return np.concatenate(out)


ANCHORS = _anchors()


def decode(raw: NDArray[np.float32], logits: NDArray[np.float32], threshold: float) -> tuple[Palm, ...]:
    """Raw outputs (2016, 18) and (2016, 1) -> palms in the network's pixels, the most certain first."""
    score = 1 / (1 + np.exp(-np.clip(logits[:, 0].astype(float), -_LOGIT_LIMIT, _LOGIT_LIMIT)))
    found = np.flatnonzero(score >= threshold)
    found = found[np.argsort(-score[found], kind="stable")]
    values = raw[found].astype(float)
    anchors = ANCHORS[found] * SIDE
    centre, half = values[:, :2] + anchors, values[:, 2:4] / 2
    boxes = np.concatenate([centre - half, centre + half], axis=1)
    keypoints = values[:, 4:].reshape(-1, 7, 2) + anchors[:, None]
    return tuple(Palm(boxes[i], keypoints[i], float(score[found[i]])) for i in range(len(found)))


def suppress(palms: tuple[Palm, ...]) -> tuple[Palm, ...]:
    """Weighted non-maximum suppression: overlapping palms become their average by score.

    Args:
        palms: the most certain first.
    """
    left, out = list(palms), []
    while left:
        best = left[0]
        overlap = np.array([_iou(best.box, p.box) for p in left])
        same = [p for p, o in zip(left, overlap, strict=True) if o > _SAME_PALM] or [best]
        weight = np.array([p.score for p in same])
        weight /= weight.sum()
        box = np.tensordot(weight, np.array([p.box for p in same]), 1)
        keypoints = np.tensordot(weight, np.array([p.keypoints for p in same]), 1)
        out.append(Palm(box, keypoints, best.score))
        left = [p for p, o in zip(left[1:], overlap[1:], strict=True) if o <= _SAME_PALM]
    return tuple(out)


def _iou(a: Array, b: Array) -> float:
    size = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])
    if (size <= 0).any():
        return 0.0
    shared = float(np.prod(size))
    union = float(np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2])) - shared
    return shared / union
