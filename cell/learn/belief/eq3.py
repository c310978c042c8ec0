"""Eq. 3, literally: b'(type') = eta sum over type of F(type' | a_other, type) b(type).

There is no likelihood of the action in it, so eta is 1 whenever F's rows sum to 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ACTIONS = 9


@dataclass(frozen=True)
class Kernel:
    """F(type' | observed action, type) as counted in data.

    Attributes:
        table: (A, 2, 2), [action, type, type'], rows sum to 1.
        seen: (A, 2) whether the row has any data.
    """

    table: NDArray[np.float64]
    seen: NDArray[np.bool_]


def fit_kernel(observed: NDArray[np.int8], types: NDArray[np.int8], unseen: str = "uniform") -> Kernel:
    """Count F in episodes.

    Args:
        observed: (T, E) actions of the partner. types: (T + 1, E), its type before the first and after
            each action. unseen: "uniform" or "identity", for rows without data.
    """
    counts = np.zeros((ACTIONS, 2, 2))
    np.add.at(counts, (observed.ravel(), types[:-1].ravel(), types[1:].ravel()), 1.0)
    total = counts.sum(-1, keepdims=True)
    fallback = np.full((2, 2), 0.5) if unseen == "uniform" else np.eye(2)
    table = np.where(total > 0, counts / np.maximum(total, 1.0), fallback)
    return Kernel(table, total[..., 0] > 0)


class Eq3Belief:
    """Belief tracker by Eq. 3."""

    def __init__(self, kernel: Kernel, prior: float) -> None:
        self._table, self._prior = kernel.table, prior
        self._belief = np.zeros((0, 2))

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        self._belief = np.tile([1.0 - self._prior, self._prior], (n_envs, 1))
        return self._fatigued()

    def update(self, observed: NDArray[np.int8]) -> NDArray[np.float32]:
        self._belief = np.einsum("et,ets->es", self._belief, self._table[observed])  # Eq. 3
        self._belief /= self._belief.sum(-1, keepdims=True)
        return self._fatigued()

    def _fatigued(self) -> NDArray[np.float32]:
        return self._belief[:, 1].astype(np.float32)
