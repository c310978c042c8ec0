"""The exact solution against an independent computation, and the policies it bounds."""

from __future__ import annotations

import numpy as np
import pytest

from cell.errors import ConfigError
from cell.learn.domain.exact import BestResponse, QmdpRobot, SemiMarkovFilter, human_chain
from cell.learn.domain.experts import expert_actions
from cell.learn.domain.presets import preset
from cell.learn.domain.vector import make

# recovery: without a price, priced on own (= active), priced on hidden
VALUES = {
    5: (52.34, 42.96, 42.93),
    10: (48.47, 40.55, 39.72),
    20: (45.05, 39.49, 38.90),
    40: (40.90, 38.02, 37.68),
}
QMDP = {10: 39.82, 20: 39.00, 40: 37.67}


@pytest.mark.parametrize("recovery", [5, 20])
def test_values_agree_with_an_independent_computation(recovery: int) -> None:
    free, own, hidden = VALUES[recovery]
    rules = preset("paper", recovery=recovery)
    assert BestResponse(rules, priced=False).value == pytest.approx(free, abs=0.011)
    assert BestResponse(rules).value == pytest.approx(own, abs=0.011)
    assert BestResponse(preset("paper", recovery=recovery, priced_on="active")).value == pytest.approx(
        own, abs=0.011
    )
    assert BestResponse(preset("paper", recovery=recovery, priced_on="hidden")).value == pytest.approx(
        hidden, abs=0.011
    )


def test_the_chain_is_a_chain() -> None:
    chain = human_chain(preset("paper"))
    np.testing.assert_allclose(chain.move.sum(axis=1), 1.0)
    assert set(chain.types) == {"hidden", "own", "announced"}


def test_qmdp_on_the_filter_lies_between_the_expert_and_the_bound() -> None:
    rules, episodes = preset("paper"), 1000
    domain, robot, human = make(rules, episodes, 3), QmdpRobot(rules), expert_actions(rules, 1)[:, 0]
    local, reward = domain.reset(), np.zeros(episodes)
    robot.reset(episodes)
    for _ in range(rules.horizon):
        step = domain.step(np.stack([robot.act(local[:, 0]), human[local[:, 1]]], axis=1))
        robot.update(step.observed[:, 1])
        local = step.local
        reward += step.reward_priced
    error = 1.96 * reward.std() / np.sqrt(episodes)
    assert reward.mean() == pytest.approx(QMDP[20], abs=error + 0.05)
    assert 38.05 < reward.mean() < BestResponse(rules).value


@pytest.mark.parametrize(("label", "auc"), [("hidden", 0.9924), ("own", 0.9955), ("announced", 1.0)])
def test_the_filter_is_as_sharp_as_it_can_be(label: str, auc: float) -> None:
    """AUC over 400 expert episodes, belief after the observed action."""
    rules, episodes = preset("paper"), 400
    domain, track = make(rules, episodes, 8), SemiMarkovFilter(rules, label)
    policy = [expert_actions(rules, i) for i in range(2)]
    local, told, belief, truth = domain.reset(), np.zeros(episodes, int), [], []
    track.reset(episodes)
    for _ in range(rules.horizon):
        step = domain.step(np.stack([policy[0][local[:, 0], told], policy[1][local[:, 1], 0]], axis=1))
        belief.append(track.update(step.observed[:, 1]))
        truth.append(getattr(step, f"type_{label}")[:, 1])
        local, told = step.local, step.type_announced[:, 1].astype(int)
    p, y = np.concatenate(belief), np.concatenate(truth).astype(bool)
    ranks = np.empty(len(p))
    values, where, counts = np.unique(p, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2)[where]
    measured = (ranks[y].sum() - y.sum() * (y.sum() + 1) / 2) / (y.sum() * (~y).sum())
    assert measured == pytest.approx(auc, abs=0.001) and len(values) > 1
    # A filter is calibrated: among beliefs of about .3, three in ten are fatigued.
    near = (p > 0.2) & (p < 0.4)
    if near.sum() > 500:
        assert y[near].mean() == pytest.approx(p[near].mean(), abs=0.05)


def test_the_filter_survives_what_it_holds_for_impossible() -> None:
    track = SemiMarkovFilter(preset("paper"))
    track.reset(1)
    belief = track.update(np.array([6]))  # nothing to put into the bin yet
    assert np.isfinite(belief).all() and track.state.sum() == pytest.approx(1.0)


def test_the_published_rules_leave_nothing_to_choose() -> None:
    with pytest.raises(ConfigError, match="may choose"):
        BestResponse(preset("released"))
    with pytest.raises(ConfigError, match="one robot and one human, in steps"):
        human_chain(preset("paper", agents=("robot", "human", "human")))
