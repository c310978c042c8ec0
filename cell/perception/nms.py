"""Non-maximum suppression: of boxes that overlap too much, the most certain one stays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def iou(box: NDArray[np.float32], boxes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Overlap of one box (4,) with boxes (N, 4), shape (N,)."""
    low, high = np.maximum(box[:2], boxes[:, :2]), np.minimum(box[2:], boxes[:, 2:])
    inner = np.clip(high - low, 0, None).prod(axis=1)
    area = (box[2:] - box[:2]).prod() + (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    out: NDArray[np.float32] = inner / (area - inner + 1e-9)
    return out


def suppress(boxes: NDArray[np.float32], scores: NDArray[np.float32], threshold: float = 0.55) -> list[int]:
    """Indices of the boxes that stay, best first.

    Args:
        boxes: (N, 4) x0, y0, x1, y1. scores: (N,). threshold: overlap that is too much.
    """
    order = np.argsort(-scores, kind="stable")
    kept: list[int] = []
    while len(order):
        best = int(order[0])
        kept.append(best)
        rest = order[1:]
        order = rest[iou(boxes[best], boxes[rest]) <= threshold]
    return kept
