"""The domain whose actions take time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import ConfigError
from cell.learn.domain.experts import expert_actions
from cell.learn.domain.presets import preset
from cell.learn.domain.semi_markov import BUSY, SemiMarkovDomain, load_durations
from cell.wire.vocabulary import Action


def play(
    kind: str, episodes: int = 300, **changes: Any
) -> tuple[SemiMarkovDomain, np.ndarray, np.ndarray, np.ndarray]:
    """Onions by agent, wrong ones and priced reward per episode."""
    rules = preset("cell", **changes)
    domain = SemiMarkovDomain(rules, episodes, 3)
    policy = [expert_actions(rules, i, kind) for i in range(2)]
    local, told = domain.reset(), np.zeros(episodes, int)
    onions, wrong, reward = np.zeros((episodes, 2)), np.zeros(episodes), np.zeros(episodes)
    for _ in range(rules.horizon):
        action = np.stack([policy[0][local[:, 0], told], policy[1][local[:, 1], 0]], axis=1)
        assert domain.mask[np.arange(2), local, action].all()
        step = domain.step(action)
        local, told = step.local, step.type_announced[:, 1].astype(int)
        onions += step.placed
        wrong += step.wrong.sum(axis=1)
        reward += step.reward_priced
    return domain, onions, wrong, reward


def test_an_episode_lasts_its_seconds_and_then_everybody_is_busy() -> None:
    domain, _, wrong, _ = play("expert", 50)
    np.testing.assert_allclose(domain.time, 180.0)
    assert (domain.reset() < BUSY).all() and (wrong == 0).all()
    assert (play("expert", 20, horizon=10)[0].time < 180.0).all()


def test_a_lone_sorter_is_as_fast_as_its_durations() -> None:
    """No fatigue: an onion takes the table's mean over blemished at sight (1/4) and inspected ones."""
    _, onions, _, _ = play("never-speed-up", thresholds=())
    seconds = load_durations()
    for agent in (0, 1):
        d = seconds[agent, 0]
        inspected = 0.75 * (
            d[Action.INSPECT] + (2 * d[Action.PLACE_ON_CONVEYOR] + d[Action.PLACE_IN_BIN]) / 3
        )
        each = d[Action.DETECT] + d[Action.PICK] + inspected + 0.25 * d[Action.PLACE_IN_BIN]
        assert onions[:, agent].mean() == pytest.approx(180.0 / each, rel=0.03)


def test_industrial_is_faster_and_costs_beside_a_person() -> None:
    _, slow, _, plain = play("never-speed-up")
    _, fast, _, priced = play("always-industrial")
    assert fast[:, 0].mean() > 1.4 * slow[:, 0].mean()
    assert (
        plain.mean() == pytest.approx(slow.sum(axis=1).mean())
        and priced.mean() < fast.sum(axis=1).mean() - 10
    )


def test_adapting_pays_where_rests_are_long() -> None:
    adapting, never = (play(kind, recovery=60)[3] for kind in ("expert", "never-speed-up"))
    assert adapting.mean() > never.mean() + 1.0


def test_the_same_seed_gives_the_same_bits() -> None:
    a, b = (play("expert", 20)[3] for _ in range(2))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("robot,fast,pick,1", "fast"),
        ("alien,any,pick,1", "alien"),
        ("robot,any,jump,1", "jump"),
        ("robot,any,pick,-1", "from 0.01 to 600"),
        ("robot,any,pick,nan", "from 0.01 to 600"),
        ("robot,any,pick,soon", "from 0.01 to 600"),
        ("robot,any,pick,1", "no row for"),
    ],
)
def test_bad_duration_tables_are_named(tmp_path: Path, row: str, words: str) -> None:
    file = tmp_path / "d.csv"
    file.write_text(f"role,mode,action,seconds\n{row}\n")
    with pytest.raises(ConfigError, match=words):
        load_durations(file)
    with pytest.raises(ConfigError, match="cannot read"):
        load_durations(tmp_path / "absent.csv")
