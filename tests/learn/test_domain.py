"""The sorting domain against the published rules and the numbers measured on the published code.

The oracles are means of 400 episodes of the public environment; ours of 1,000 must agree within both
95 % intervals.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.errors import ConfigError
from cell.learn.domain.exact import rule_value
from cell.learn.domain.experts import expert_actions
from cell.learn.domain.local import FEATURES, LOCALS, SINK, SIZE, local_id
from cell.learn.domain.presets import Preset, confusion, preset
from cell.learn.domain.rules import phases, tables
from cell.learn.domain.starts import start_chances
from cell.learn.domain.vector import Step, make
from cell.wire.vocabulary import Action

EPISODES = 1000


def play(rules: Preset, kind: str = "expert", episodes: int = EPISODES, seed: int = 11) -> dict[str, Any]:
    """Totals per episode of the expert, the robot knowing what the human has told."""
    domain = make(rules, episodes, seed)
    policy = [expert_actions(rules, i, kind) for i in range(domain.n_agents)]
    local = domain.reset()
    told = np.zeros(episodes, dtype=int)
    total: dict[str, Any] = {
        k: np.zeros(episodes) for k in ("reward_truth", "reward_priced", "reward_shaped", "priced")
    }
    total["onions"] = np.zeros((episodes, domain.n_agents))
    for _ in range(rules.horizon):
        action = np.stack([p[local[:, i], told if i == 0 else 0] for i, p in enumerate(policy)], axis=1)
        step = domain.step(action)
        local, told = step.local, step.type_announced[:, 1:].max(axis=1).astype(int)
        for key in ("reward_truth", "reward_priced", "reward_shaped", "priced"):
            total[key] += getattr(step, key)
        total["onions"] += step.placed
    assert step.alive.all()
    return total


def agrees(ours: np.ndarray, mean: float, sd: float, episodes: int) -> bool:
    """Both means are within their joint 95 % interval (and the published figure's last digit)."""
    error = 1.96 * np.sqrt(ours.var() / len(ours) + sd**2 / episodes)
    return bool(abs(ours.mean() - mean) <= error + 0.05)


def expected(ours: np.ndarray, exact: float) -> bool:
    """The mean is within 2.6 standard errors (99 %) of an exact value."""
    return bool(abs(ours.mean() - exact) <= 2.6 * ours.std() / np.sqrt(len(ours)) + 1e-3)


PUBLISHED = [
    # what, changes, policy, onions mean and sd, robot's, human's
    ("random start", {}, "expert", 44.6, 1.4, 27.7, 17.0),
    ("fixed start", {"start": "fixed"}, "expert", 44.7, 1.4, 27.2, 17.5),
    ("never speeds up", {"forcing": False, "robot_start": 0}, "expert", 45.5, 1.4, 28.6, 17.0),
    ("always industrial", {"forcing": False, "robot_start": 1}, "expert", 56.8, 1.5, 39.8, 16.9),
    ("no fatigue", {"thresholds": (), "robot_start": 0}, "expert", 57.1, 1.2, 28.6, 28.5),
    (
        "no fatigue, industrial",
        {"thresholds": (), "robot_start": 1, "forcing": False},
        "expert",
        68.4,
        1.6,
        39.8,
        28.6,
    ),
    ("never inspects", {}, "never-inspect", 51.7, 1.1, 32.8, 18.9),
]


@pytest.mark.parametrize(
    ("changes", "kind", "mean", "sd", "robots", "humans"),
    [row[1:] for row in PUBLISHED],
    ids=[r[0] for r in PUBLISHED],
)
def test_released_gives_the_published_codes_numbers(
    changes: dict[str, Any], kind: str, mean: float, sd: float, robots: float, humans: float
) -> None:
    total = play(preset("released", **changes), kind)
    onions = total["onions"]
    assert agrees(onions.sum(axis=1), mean, sd, 400)
    assert onions.mean(axis=0) == pytest.approx([robots, humans], abs=0.2)


def test_agents_that_nothing_binds_are_independent() -> None:
    """With the forcing rule undone the variances of their onions add up."""
    rules = preset("released", forcing=False, robot_start=1)
    onions = play(rules, episodes=4000)["onions"]
    apart, together = onions.var(axis=0).sum(), onions.sum(axis=1).var()
    assert together == pytest.approx(apart, rel=0.08)
    assert abs(np.corrcoef(onions.T)[0, 1]) < 2.6 / np.sqrt(4000)


@pytest.mark.parametrize("start", ["fixed", "random"])
@pytest.mark.parametrize("kind", ["expert", "never-inspect"])
def test_released_gives_the_exact_expectation(start: str, kind: str) -> None:
    """Forced mode changes, re-drawn labels and random starts included; here the human inspects too."""
    rules = preset("released", start=start)
    domain = make(rules, 3000, 17)
    policy = [expert_actions(rules, 0, kind), expert_actions(rules, 1)]
    local, reward = domain.reset(), np.zeros(3000)
    for _ in range(rules.horizon):
        step = domain.step(np.stack([p[local[:, i], 0] for i, p in enumerate(policy)], axis=1))
        local = step.local
        reward += step.reward_truth
    assert expected(reward, rule_value(rules, kind))


def test_released_own_reward() -> None:
    assert agrees(play(preset("released"))["reward_shaped"], 64.7, 2.5, 400)
    assert agrees(play(preset("released", start="fixed"))["reward_shaped"], 65.0, 2.3, 400)


def test_released_lets_a_random_policy_live_for_a_step() -> None:
    rng = np.random.default_rng(5)
    domain = make(preset("released"), 4000, 6)
    domain.reset()
    length, alive = np.zeros(4000), np.ones(4000, dtype=bool)
    for _ in range(20):
        length += alive
        alive = domain.step(rng.integers(9, size=(4000, 2))).alive
    assert length.mean() == pytest.approx(1.03, abs=0.02)


def test_valid_states_and_actions_are_counted_as_in_the_published_code() -> None:
    """Its 128 valid local states are our 64, each with and without the derived interaction flag."""
    assert 2 * SINK == 128
    for role, expected in (("robot", {1: 104, 3: 16, 0: 8}), ("human", {1: 116, 3: 8, 0: 4})):
        count = tables(preset("released"), role).valid[:SINK].sum(axis=1)
        assert {int(k): 2 * int((count == k).sum()) for k in np.unique(count)} == expected


def test_an_invalid_action_ends_the_episode_with_the_step_cost() -> None:
    domain = make(preset("released", start="fixed"), 3, 1)
    domain.reset()
    step = domain.step(np.array([[1, 1], [0, 1], [1, 3]]))
    assert step.alive.tolist() == [True, False, False]
    assert (step.local[1:] == SINK).all() and (FEATURES[SINK] == 1).all()
    np.testing.assert_allclose(step.reward_shaped, -0.02)
    later = domain.step(np.array([[3, 3], [1, 1], [1, 1]]))
    assert later.alive.tolist() == [True, False, False]
    np.testing.assert_allclose(later.reward_shaped[1:], 0.0)
    assert (later.type_own[1:] == 0).all() and (later.placed[1:] == 0).all()


PAPER = [
    # recovery, policy, onions, robot's, reward priced on own and on hidden, priced steps (4,000 episodes)
    (5, "expert", 41.84, 25.3, 38.76, 32.78, 6.2),
    (5, "never-speed-up", 42.86, 26.3, 42.86, 42.86, 0.0),
    (5, "always-industrial", 52.24, 35.7, 21.03, 18.21, 62.4),
    (10, "expert", 40.36, 27.7, 38.47, 34.14, 3.8),
    (10, "never-speed-up", 39.01, 26.3, 39.01, 39.01, 0.0),
    (10, "always-industrial", 48.38, 35.7, 24.40, 22.54, 48.0),
    (20, "expert", 39.40, 30.1, 38.05, 35.07, 2.7),
    (20, "never-speed-up", 35.59, 26.3, 35.59, 35.59, 0.0),
    (20, "always-industrial", 44.97, 35.7, 27.39, 26.10, 35.2),
    (40, "expert", 37.82, 32.7, 37.27, 35.89, 1.1),
    (40, "never-speed-up", 31.42, 26.3, 31.42, 31.42, 0.0),
    (40, "always-industrial", 40.80, 35.7, 31.03, 30.65, 19.5),
]


@pytest.mark.parametrize(("recovery", "kind", "onions", "robots", "own", "hidden", "steps"), PAPER)
def test_paper_agrees_with_an_independent_simulation(
    recovery: int, kind: str, onions: float, robots: float, own: float, hidden: float, steps: float
) -> None:
    total = play(preset("paper", recovery=recovery), kind)
    unpriced = rule_value(preset("paper", recovery=recovery, price=0.0), kind)
    assert unpriced == pytest.approx(onions, abs=1.96 * 1.2 / np.sqrt(4000) + 0.005)
    assert expected(total["onions"].sum(axis=1), unpriced)
    for priced_on, reward in (("own", own), ("active", own), ("hidden", hidden)):
        rules = preset("paper", recovery=recovery, priced_on=priced_on)
        exact = rule_value(rules, kind)
        # Exact against the mean of 4,000 episodes, rounded; then ours against exact.
        assert exact == pytest.approx(reward, abs=1.96 * 1.8 / np.sqrt(4000) + 0.005)
        assert expected(play(rules, kind)["reward_priced"], exact)
    assert total["priced"].mean() == pytest.approx(steps, abs=0.2)
    assert total["onions"][:, 0].mean() == pytest.approx(robots, abs=0.15)
    np.testing.assert_array_equal(total["reward_truth"], total["onions"].sum(axis=1))  # none sorted wrongly


def test_skipping_the_inspection_sorts_a_third_of_the_promising_onions_wrongly() -> None:
    total = play(preset("paper"), "never-inspect")
    # P(looks good) = .75, of which 1/3 are blemished: each placement earns .25 + .75 / 3 = .5.
    share = total["reward_truth"].sum() / total["onions"].sum()
    assert share == pytest.approx(0.5, abs=0.01)


def test_a_rest_takes_the_published_steps() -> None:
    """Onset at the end of step t: thumbs-down at t+2, thumbs-up at t+7, with a recovery of 5."""
    domain = make(preset("released", start="fixed"), 1, 3)
    policy = [expert_actions(domain.preset, i) for i in range(2)]
    local, hidden, done = domain.reset(), [0], []
    for _ in range(60):
        action = np.array([[p[local[0, i], 0] for i, p in enumerate(policy)]])
        step = domain.step(action)
        local = step.local
        hidden.append(int(step.type_hidden[0, 1]))
        done.append(action[0].tolist())
    onset = hidden.index(1)  # true after `onset` steps
    human = [a[1] for a in done[onset:]]
    robot = [a[0] for a in done[onset:]]
    assert human[1] == Action.SLOW_DOWN and human[2:6] == [0] * 4 and human[6] == Action.SPEED_UP
    assert robot[2] == Action.SPEED_UP and robot[7] == Action.SLOW_DOWN
    assert hidden[onset : onset + 6] == [1] * 5 + [0]


def test_the_paper_hides_the_humans_type_from_the_robot() -> None:
    """Same robot actions and onions, humans that tire or never do: the robot's states are equal."""
    seen = []
    for thresholds in ((2, 3, 4, 5), ()):
        rules = preset("paper", thresholds=thresholds, p_blemished=0.0)
        domain = make(rules, 50, 4)
        local = domain.reset()
        robot = expert_actions(rules, 0, "never-speed-up")
        human = expert_actions(rules, 1)
        states = []
        for _ in range(60):
            step = domain.step(np.stack([robot[local[:, 0], 0], human[local[:, 1], 0]], axis=1))
            local = step.local
            states.append(local[:, 0])
        seen.append(np.array(states))
    np.testing.assert_array_equal(*seen)


def test_masked_actions_are_refused_by_the_paper_preset() -> None:
    domain = make(preset("paper"), 2, 1)
    domain.reset()
    with pytest.raises(ConfigError, match="mask"):
        domain.step(np.array([[5, 1], [1, 1]]))


@pytest.mark.parametrize("name", ["released", "paper", "cell"])
@pytest.mark.parametrize(
    "actions",
    [[[9, 1], [1, 1]], [[1, 1], [1, -1]], [[1, 1], [1, -8]], [[1, 1]], [1, 1], [[1.0, 1.0], [1.0, 1.0]]],
)
def test_what_is_no_action_is_refused(name: str, actions: list[Any]) -> None:
    domain = make(preset(name, start="fixed"), 2, 1)
    before = domain.reset()
    with pytest.raises(ConfigError, match="actions must be"):
        domain.step(np.array(actions))
    np.testing.assert_array_equal(domain.reset(), before)


@pytest.mark.parametrize("name", ["released", "paper", "cell"])
def test_random_starts_are_the_published_52_without_the_derived_flag(name: str) -> None:
    local = make(preset(name, start="random"), 4000, 2).reset()
    assert [len(np.unique(local[:, i])) for i in range(2)] == [52 // 2] * 2
    for i, role in enumerate(("robot", "human")):
        seen = np.bincount(local[:, i], minlength=SIZE) / 4000
        np.testing.assert_allclose(seen, start_chances(preset(name, start="random"), role), atol=0.015)


def test_the_same_seed_gives_the_same_bits_and_another_does_not() -> None:
    def bits(seed: int) -> bytes:
        rules = preset("paper", missed_gestures=0.2, misread_actions=0.1)
        domain, rng = make(rules, 64, seed), np.random.default_rng(0)
        local, out = domain.reset(), b""
        for _ in range(100):
            u = rng.random((64, 2, 9))
            allowed = np.stack([domain.mask[i][local[:, i]] for i in range(2)], axis=1)
            step: Step = domain.step((u * allowed).argmax(axis=2))
            local = step.local
            out += local.tobytes() + step.observed.tobytes() + step.reward_priced.tobytes()
        return out

    assert bits(3) == bits(3) != bits(4)


def test_three_agents_share_a_belt() -> None:
    rules = preset("paper", agents=("robot", "human", "human"))
    total = play(rules, episodes=200)
    onions = total["onions"].mean(axis=0)
    assert onions[1] == pytest.approx(onions[2], abs=0.3) and onions[0] > 25
    with pytest.raises(ConfigError, match="one robot and one human"):
        make(preset("released", agents=("robot", "human", "human")), 1, 0)


@given(st.floats(0, 1), st.floats(0, 1))
def test_observations_are_a_distribution(missed: float, misread: float) -> None:
    seen = confusion(preset("paper", missed_gestures=missed, misread_actions=misread))
    assert (seen >= 0).all()
    np.testing.assert_allclose(seen.sum(axis=1), 1.0)


def test_a_confusion_of_ones_own_is_what_the_others_see() -> None:
    """Every thumbs-down is taken for No-op, and nothing else is misread."""
    seen = np.eye(9)
    seen[8] = np.eye(9)[0]
    rules = preset("paper", observation=tuple(tuple(row) for row in seen.tolist()))
    domain = make(rules, 200, 3)
    policy = [expert_actions(rules, i) for i in range(2)]
    local, downs = domain.reset(), 0
    for _ in range(40):
        action = np.stack([p[local[:, i], 0] for i, p in enumerate(policy)], axis=1)
        step = domain.step(action)
        np.testing.assert_array_equal(step.observed, np.where(action == 8, 0, action))
        downs += int((action == 8).sum())
        local = step.local
    assert downs > 0


def test_gestures_are_missed_as_often_as_configured() -> None:
    rules = preset("paper", missed_gestures=0.3)
    domain = make(rules, 2000, 9)
    policy = [expert_actions(rules, i) for i in range(2)]
    local, shown, missed = domain.reset(), 0, 0
    for _ in range(60):
        action = np.stack([p[local[:, i], 0] for i, p in enumerate(policy)], axis=1)
        step = domain.step(action)
        thumb = action[:, 1] >= Action.SPEED_UP
        shown += int(thumb.sum())
        missed += int((step.observed[thumb, 1] == Action.NO_OP).sum())
        local = step.local
    assert missed / shown == pytest.approx(0.3, abs=0.02)


@given(st.integers(1, 50), st.lists(st.integers(1, 9), min_size=1, max_size=5))
@settings(max_examples=40)
def test_a_rest_is_exactly_as_long_as_configured(recovery: int, thresholds: list[int]) -> None:
    rules = preset("paper", recovery=recovery, thresholds=tuple(thresholds))
    after, fatigued = phases(rules)
    phase = int(np.flatnonzero(fatigued)[-1])  # onset
    for _ in range(recovery):
        assert fatigued[phase]
        phase = int(after[phase, 0, 0])
    assert phase == 0 and not fatigued[phase]


def test_local_states() -> None:
    assert len({tuple(int(v[k]) for v in LOCALS) for k in range(SINK)}) == SINK == 64
    assert FEATURES.shape == (SIZE, 15) and (FEATURES[:SINK].sum(axis=1) == 5).all()
    with pytest.raises(KeyError):
        local_id(2, 3, 1, 0, 1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"colour": 1}, "unknown"),
        ({"p_blemished": 1.5}, "p_blemished"),
        ({"start": "anywhere"}, "start"),
        ({"agents": ("human", "robot")}, "first is a robot"),
        ({"recovery": 0}, "recovery"),
        ({"recovery": 2.5}, "recovery"),
        ({"recovery": "long"}, "recovery"),
        ({"priced_on": "x"}, "priced_on"),
        ({"price": float("nan")}, "price"),
        ({"price": -1.0}, "price"),
        ({"robot_start": 5}, "robot_start"),
        ({"thresholds": 3}, "thresholds"),
        ({"thresholds": (0,)}, "thresholds"),
        ({"observation": ((1.0,),)}, "observation"),
        ({"observation": ((0.5,) * 9,) * 9}, "observation, row no_op"),
        ({"observation": ((1.0,) + (0.0,) * 8,) * 9, "missed_gestures": 0.1}, "give one"),
    ],
)
def test_bad_presets_are_named(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        preset("paper", **changes)
    assert words in str(caught.value) or "colour" in str(caught.value)


def test_unknown_preset() -> None:
    with pytest.raises(ConfigError, match="released"):
        preset("papers")
