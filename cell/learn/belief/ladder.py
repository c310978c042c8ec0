"""The belief ladder: from knowing nothing to knowing the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell.learn.belief.bank import BeliefBank
from cell.learn.belief.eq3 import Eq3Belief, fit_kernel
from cell.learn.belief.gru import GruBelief, TypeData
from cell.learn.belief.hmm import HmmBelief, fit_hmm
from cell.learn.belief.pretrain import pretrain
from cell.learn.belief.tracker import BeliefTracker, NoBelief, last_gesture
from cell.learn.demonstrations import type_data
from cell.learn.domain.exact import SemiMarkovFilter, solvable
from cell.learn.domain.presets import Preset

_TRAIN_SEED = 1_000_003


class LastAction:
    """P(type after the step | the last action alone), as counted in data."""

    def __init__(self, data: TypeData) -> None:
        hits = np.bincount(data.observed.ravel(), data.types[1:].ravel(), minlength=9)
        count = np.bincount(data.observed.ravel(), minlength=9)
        self._table = np.where(count > 0, hits / np.maximum(count, 1), 0.5).astype(np.float32)
        self._prior = float(data.types[0].mean())

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        return np.full(n_envs, self._prior, np.float32)

    def update(self, observed: NDArray[np.int8]) -> NDArray[np.float32]:
        return self._table[observed]


def ladder(
    rules: Preset, label: str, shipped: BeliefBank | None = None, episodes: int = 400, updates: int = 350
) -> dict[str, BeliefTracker]:
    """Trackers of the person for one label, fitted on `episodes` expert episodes of the preset.

    Args:
        shipped: bank whose (mixed) GRU for this label is shown too.
    """
    data = type_data(rules, label, episodes, _TRAIN_SEED)
    prior = float(data.types[0].mean())
    person = next(i for i, name in enumerate(rules.agents) if not name.startswith("robot"))
    trackers: dict[str, BeliefTracker] = {
        "none": NoBelief(),
        "last action": LastAction(data),
        "last gesture": last_gesture(),
        "Eq. 3, unseen rows uniform": Eq3Belief(fit_kernel(data.observed, data.types), prior),
        "Eq. 3, unseen rows identity": Eq3Belief(fit_kernel(data.observed, data.types, "identity"), prior),
        "first-order HMM": HmmBelief(fit_hmm(data.observed, data.types), prior),
        "GRU": GruBelief(pretrain(rules, label, (rules.recovery,), episodes, 1, updates)),
    }
    if solvable(rules):
        trackers["semi-Markov filter"] = SemiMarkovFilter(rules, label)
    if shipped is not None:
        trackers["GRU, mixed recovery"] = shipped.about[person]
    return trackers
