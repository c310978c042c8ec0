"""The exact solution against an independent computation, and the policies it bounds."""

from __future__ import annotations

import numpy as np
import pytest

from cell.errors import ConfigError
from cell.learn.domain.exact import BestResponse, QmdpRobot, SemiMarkovFilter, human_chain, rule_value
from cell.learn.domain.experts import expert_actions
from cell.learn.domain.local import LOCALS
from cell.learn.domain.presets import Preset, preset
from cell.learn.domain.vector import make

# recovery: without a price, priced on own (= active), priced on hidden
VALUES = {
    5: (52.34, 42.96, 42.93),
    10: (48.47, 40.55, 39.72),
    20: (45.05, 39.49, 38.90),
    40: (40.90, 38.02, 37.68),
}
QMDP = {10: 39.82, 20: 39.00, 40: 37.67}
QMDP_HIDDEN = {10: 39.39, 20: 38.55, 40: 37.45}


@pytest.mark.parametrize("recovery", [5, 10, 20, 40])
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
    assert chain.start.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("recovery", "states"), [(5, 84), (10, 119), (20, 189), (40, 329)])
def test_the_chain_has_as_many_states_as_an_independent_count(recovery: int, states: int) -> None:
    """That count does not tell an empty hand over the bin from one over the conveyor; both then detect."""
    chain = human_chain(preset("paper", recovery=recovery))
    eef = np.where(LOCALS.idle & (LOCALS.eef <= 1), 0, LOCALS.eef)
    local = np.column_stack([LOCALS.onion, eef, LOCALS.prediction, LOCALS.own_type, LOCALS.indicated])
    assert len(np.unique(np.column_stack([local[chain.local], chain.phase]), axis=0)) == states


def simulated(rules: Preset, episodes: int, key: str, seed: int = 3) -> np.ndarray:
    """Reward per episode of QMDP on the filter beside the expert human."""
    domain, robot, human = make(rules, episodes, seed), QmdpRobot(rules), expert_actions(rules, 1)[:, 0]
    local, reward = domain.reset(), np.zeros(episodes)
    robot.reset(episodes)
    for _ in range(rules.horizon):
        step = domain.step(np.stack([robot.act(local[:, 0]), human[local[:, 1]]], axis=1))
        robot.update(step.observed[:, 1])
        local = step.local
        reward += getattr(step, key)
    return reward


@pytest.mark.parametrize(
    ("recovery", "priced_on", "value"),
    [*((r, "own", v) for r, v in QMDP.items()), *((r, "hidden", v) for r, v in QMDP_HIDDEN.items())],
)
def test_qmdp_on_the_filter_is_as_good_as_in_an_independent_simulation(
    recovery: int, priced_on: str, value: float
) -> None:
    rules = preset("paper", recovery=recovery, priced_on=priced_on)
    reward = simulated(rules, 1000, "reward_priced")
    error = 1.96 * reward.std() / np.sqrt(len(reward))
    assert reward.mean() == pytest.approx(value, abs=error + 0.05)
    assert reward.mean() - error < BestResponse(rules).value


@pytest.mark.parametrize("start", ["fixed", "random"])
@pytest.mark.parametrize("thresholds", [(2, 3, 4, 5), ()])
def test_with_nothing_to_guess_the_bound_is_reached(start: str, thresholds: tuple[int, ...]) -> None:
    """Without a price, or with a person who never tires, the human's type decides nothing."""
    rules = preset("paper", start=start, thresholds=thresholds, price=0.5 if not thresholds else 0.0)
    reward = simulated(rules, 1000, "reward_priced")
    assert reward.mean() == pytest.approx(
        BestResponse(rules).value, abs=2.6 * reward.std() / np.sqrt(1000) + 0.01
    )


@pytest.mark.parametrize("start", ["fixed", "random"])
def test_published_rules_reward_who_never_inspects(start: str) -> None:
    """No truth beyond the prediction: the best robot inspects nothing, and forced modes leave no more."""
    rules = preset("released", start=start)
    policy = [expert_actions(rules, 0, "never-inspect"), expert_actions(rules, 1)]
    domain = make(rules, 2000, 5)
    local, reward = domain.reset(), np.zeros(2000)
    for _ in range(rules.horizon):
        step = domain.step(np.stack([p[local[:, i], 0] for i, p in enumerate(policy)], axis=1))
        local = step.local
        reward += step.reward_truth
    assert step.alive.all()
    best = BestResponse(rules).value
    assert reward.mean() == pytest.approx(best, abs=2.6 * reward.std() / np.sqrt(2000) + 0.05)
    assert rule_value(rules, "never-inspect") == pytest.approx(best, abs=0.05)
    assert rule_value(rules) < rule_value(rules, "never-inspect") <= best + 1e-6


@pytest.mark.parametrize("start", ["fixed", "random"])
@pytest.mark.parametrize(
    ("name", "label", "auc"),
    [
        ("paper", "hidden", 0.9924),
        ("paper", "own", 0.9955),
        ("paper", "announced", 1.0),
        # The best of the learned beliefs on the published rules: an exact filter is no worse.
        ("released", "hidden", 0.970),
        ("released", "own", 0.982),
        ("released", "announced", 1.0),
    ],
)
def test_the_filter_is_as_sharp_as_it_can_be(name: str, label: str, auc: float, start: str) -> None:
    """AUC over 400 expert episodes, belief after the observed action."""
    rules, episodes = preset(name, start=start), 400
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
    assert auc - 0.001 < measured < auc + (0.001 if name == "paper" else 0.006) and len(values) > 1
    # A filter is calibrated: among beliefs of about .3, three in ten are fatigued.
    assert y.mean() == pytest.approx(p.mean(), abs=0.005)
    for low in np.arange(0.0, 1.0, 0.2):
        near = (p > low) & (p < low + 0.2)
        if near.sum() > 500:
            assert y[near].mean() == pytest.approx(p[near].mean(), abs=0.04)


def test_the_filter_survives_what_it_holds_for_impossible() -> None:
    track = SemiMarkovFilter(preset("paper"))
    track.reset(1)
    belief = track.update(np.array([6]))  # nothing to put into the bin yet
    assert np.isfinite(belief).all() and track.state.sum() == pytest.approx(1.0)


def test_the_exact_solution_says_where_it_ends() -> None:
    with pytest.raises(ConfigError, match="one robot and one human, in steps"):
        human_chain(preset("paper", agents=("robot", "human", "human")))
