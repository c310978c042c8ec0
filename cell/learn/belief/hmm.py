"""First-order hidden Markov filter: Eq. 3's kernel and, unlike Eq. 3, the likelihood of the action."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ACTIONS = 9


@dataclass(frozen=True)
class HiddenMarkov:
    """P(action, type' | type) as counted in data, with `smoothing` imagined counts per cell.

    Attributes:
        joint: (A, 2, 2), [action, type, type'], sums to 1 over action and type'.
    """

    joint: NDArray[np.float64]


def fit_hmm(observed: NDArray[np.int8], types: NDArray[np.int8], smoothing: float = 0.01) -> HiddenMarkov:
    """Count P(a | type) F(type' | a, type); shapes as in `eq3.fit_kernel`."""
    counts = np.full((ACTIONS, 2, 2), smoothing)
    np.add.at(counts, (observed.ravel(), types[:-1].ravel(), types[1:].ravel()), 1.0)
    return HiddenMarkov(counts / counts.sum((0, 2), keepdims=True))


class HmmBelief:
    """Belief tracker: b'(type') ~ sum over type of P(a | type) F(type' | a, type) b(type)."""

    def __init__(self, model: HiddenMarkov, prior: float) -> None:
        self._joint, self._prior = model.joint, prior
        self._belief = np.zeros((0, 2))

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        self._belief = np.tile([1.0 - self._prior, self._prior], (n_envs, 1))
        return self._fatigued()

    def update(self, observed: NDArray[np.int8]) -> NDArray[np.float32]:
        self._belief = np.einsum("et,ets->es", self._belief, self._joint[observed])
        self._belief /= self._belief.sum(-1, keepdims=True)
        return self._fatigued()

    def _fatigued(self) -> NDArray[np.float32]:
        return self._belief[:, 1].astype(np.float32)
