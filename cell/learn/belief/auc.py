"""ROC of beliefs against true types."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell.learn.belief.gru import TypeData
from cell.learn.belief.tracker import BeliefTracker


def beliefs(tracker: BeliefTracker, data: TypeData) -> NDArray[np.float32]:
    """The tracker's belief after each observed action: (T, E)."""
    tracker.reset(data.observed.shape[1])
    return np.stack([tracker.update(row).copy() for row in data.observed])


def auc(score: NDArray[np.floating], truth: NDArray[np.int8]) -> float:
    """Area under the ROC curve: P(score of a fatigued step > score of another) + half the ties."""
    score, positive = score.ravel(), truth.ravel().astype(bool)
    _, inverse, counts = np.unique(score, return_inverse=True, return_counts=True)
    rank = np.cumsum(counts) - (counts - 1) / 2.0  # mean rank of each tied group, from 1
    p, n = int(positive.sum()), int((~positive).sum())
    if p == 0 or n == 0:
        return 0.5
    return float((rank[inverse][positive].sum() - p * (p + 1) / 2.0) / (p * n))


def roc(
    score: NDArray[np.floating], truth: NDArray[np.int8], points: int = 400
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(false positive rate, true positive rate) over falling thresholds, thinned to about `points`."""
    order = np.argsort(-score.ravel(), kind="stable")
    positive = truth.ravel().astype(bool)[order]
    value = score.ravel()[order]
    last = np.append(np.flatnonzero(np.diff(value)), len(value) - 1)  # ties move both rates at once
    tp, fp = np.cumsum(positive)[last], np.cumsum(~positive)[last]
    keep = np.unique(np.linspace(0, len(last) - 1, min(points, len(last))).round().astype(int))
    rates = fp[keep] / max(1, fp[-1]), tp[keep] / max(1, tp[-1])
    return np.concatenate(([0.0], rates[0])), np.concatenate(([0.0], rates[1]))
