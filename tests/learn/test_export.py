"""Exported tables load in the cell and score like the network they came from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cell.decision.policy import load
from cell.learn import runs
from cell.learn.belief.bank import bank
from cell.learn.belief.tracker import last_gesture
from cell.learn.demonstrations import play
from cell.learn.domain.local import FEATURES
from cell.learn.domain.presets import preset
from cell.learn.export import Table, acting, from_csv, tabulate, to_csv
from cell.learn.metrics import summary
from cell.learn.settings import tuned


@pytest.mark.parametrize("decoding", ["greedy", "sampled"])
def test_table_scores_like_the_network(tmp_path: Path, decoding: str) -> None:
    rules = preset("paper")
    beliefs = bank(rules.agents, [last_gesture()])
    actors = runs.cloned(rules, runs.demonstrations(rules, beliefs, 30), tuned(), updates=200)
    visits = [runs.rollout_of(rules, beliefs, actors, d, 100, 3) for d in runs.DECODINGS]
    tables: list[Table] = []
    for agent, name in enumerate(rules.agents):
        path = tmp_path / f"{name}.csv"
        path.write_text(
            to_csv(tabulate(rules, actors, agent, visits), "policy=t preset=paper seed=1 commit=x")
        )
        assert len(load(str(path)).actions) == 16 * 4 * 20
        tables.append(from_csv(path, len(FEATURES)))
    sampler = np.random.default_rng(1) if decoding == "sampled" else None
    of_table = summary(play(rules, beliefs, acting(tables, sampler), 400, 5))["reward_priced"]
    of_network = runs.evaluate(rules, beliefs, actors, decoding, 400, 6)["reward_priced"]
    assert abs(of_table["mean"] - of_network["mean"]) < 2 * (of_table["ci95"] + of_network["ci95"])


def test_tables_of_three_agents_are_refused() -> None:
    from cell.errors import ConfigError

    rules = preset("paper", agents=("robot", "human", "human"))
    beliefs = bank(rules.agents, [last_gesture(), last_gesture()])
    actors = runs.cloned(rules, runs.demonstrations(rules, beliefs, 2), tuned(), updates=1)
    with pytest.raises(ConfigError, match="two agents"):
        tabulate(rules, actors, 0, [])
