"""The belief ladder's unlearned rungs against the figures measured on the published environment."""

from __future__ import annotations

import pytest

from cell.learn.belief.auc import auc, beliefs
from cell.learn.belief.eq3 import Eq3Belief, fit_kernel
from cell.learn.belief.hmm import HmmBelief, fit_hmm
from cell.learn.belief.ladder import LastAction
from cell.learn.belief.tracker import BeliefTracker
from cell.learn.demonstrations import type_data
from cell.learn.domain.presets import preset

PUBLISHED = [
    # type of whom, label, last action, Eq. 3 with unseen rows uniform and identity, first-order filter:
    # AUC over 100 expert episodes, fitted on 300; a second run moved none of them by more than .005
    (1, "hidden", 0.775, 0.802, 0.737, 0.822),
    (1, "own", 0.896, 0.812, 0.576, 0.897),
    (0, "hidden", 0.882, 1.000, 0.999, 1.000),
]


@pytest.mark.parametrize(("agent", "label", "last", "uniform", "identity", "first_order"), PUBLISHED)
def test_released_gives_the_published_codes_aucs(
    agent: int, label: str, last: float, uniform: float, identity: float, first_order: float
) -> None:
    rules = preset("released")
    data, test = type_data(rules, label, 300, 1, agent), type_data(rules, label, 300, 2, agent)
    prior = float(data.types[0].mean())
    rungs: dict[float, BeliefTracker] = {
        last: LastAction(data),
        uniform: Eq3Belief(fit_kernel(data.observed, data.types), prior),
        identity: Eq3Belief(fit_kernel(data.observed, data.types, "identity"), prior),
        first_order: HmmBelief(fit_hmm(data.observed, data.types), prior),
    }
    for published, tracker in rungs.items():
        assert auc(beliefs(tracker, test), test.types[1:]) == pytest.approx(published, abs=0.01)
