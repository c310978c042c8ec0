"""What the abstract task says of a round's sort time, against what was measured in the cell.

The task has no end of a batch: the first onions that anybody starts, as many as a round has, are the
round's, and it is over when the last of them is put down. What the cell needs beside (the first look,
the last one) is the measured overhead.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.learn.belief.bank import BeliefBank, bank
from cell.learn.belief.tracker import BeliefTracker, NoBelief, last_gesture
from cell.learn.commands import bank_for
from cell.learn.domain.local import SIZE
from cell.learn.domain.presets import Preset
from cell.learn.domain.semi_markov import SemiMarkovDomain
from cell.learn.export import acting, expert_table, from_csv
from cell.trials.campaign import Record, Results
from cell.trials.contenders import Contender
from cell.trials.tables import completed, rows
from cell.wire.vocabulary import Action

_SEED = 4711
_LONGEST, _EVENTS = 3600.0, 10_000
_STARTS = (Action.DETECT, Action.DETECT_PICK)


def predict(results: Results, rules: Preset, overhead: float, episodes: int = 1000) -> list[Record]:
    """A row per policy of the campaign: measured and predicted mean sort time [s], and the error's share."""
    table, out = rows(results), []
    for contender in results.settings.contenders:
        mine = [r for r in table if r["contender"] == contender.name and completed(r)]
        beliefs = _bank(rules, contender.belief)
        if not mine or beliefs is None:
            continue
        times, by_human = sort_times(rules, contender, beliefs, results.settings.onions, episodes)
        measured = float(np.mean([r["sort_time_s"] for r in mine]))
        predicted = float(times.mean()) + overhead
        out.append(
            {
                "policy": contender.name,
                "rounds": len(mine),
                "measured_s": round(measured, 3),
                "predicted_s": round(predicted, 3),
                "error_share": round(predicted / measured - 1.0, 4),
                "by_human_measured": round(float(np.mean([r["by_human"] for r in mine])), 3),
                "by_human_predicted": round(float(by_human.mean()), 3),
            }
        )
    return out


def sort_times(
    rules: Preset, contender: Contender, beliefs: BeliefBank, onions: int, episodes: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Sort times (E,) [s] without overhead, and onions by the person (E,), beside the expert person."""
    rules = replace(rules, seconds=_LONGEST, horizon=_EVENTS, start="fixed")
    domain = SemiMarkovDomain(rules, episodes, _SEED)
    act = acting([_table(contender), expert_table(rules, 1)])
    started, mine = np.zeros(episodes, np.int64), np.zeros((episodes, domain.n_agents), np.int64)
    done, by_human, over = np.zeros(episodes, np.int64), np.zeros(episodes, np.int64), np.zeros(episodes)
    local, belief = domain.reset(), beliefs.reset(episodes)
    for _ in range(_EVENTS):
        action = act(local, belief)
        begins = (local < SIZE) & np.isin(action, _STARTS)
        for agent in range(domain.n_agents):
            started += begins[:, agent]
            mine[:, agent] = np.where(begins[:, agent], started, mine[:, agent])
        step = domain.step(action)
        counts = (step.placed > 0) & (mine <= onions) & (done < onions)[:, None]
        done += counts.sum(1)
        by_human += counts[:, 1]
        over = np.where(counts.any(1), domain.time, over)
        if (done >= onions).all():
            break
        local, belief = step.local, beliefs.update(step.observed)
    return over, by_human


def _table(contender: Contender) -> Any:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "robot.csv"
        file.write_text(contender.csv)
        return from_csv(file, 2 * SIZE)


def _bank(rules: Preset, belief: str) -> BeliefBank | None:
    """The beliefs of a contender; None where the task has no such thing."""
    if belief in ("", "gru"):
        return bank_for(rules, "announced")
    people: dict[str, BeliefTracker] = {"none": NoBelief(), "last-gesture": last_gesture()}
    if belief.endswith(".safetensors"):
        return bank_for(rules, "announced", Path(belief))
    return bank(rules.agents, [people[belief]]) if belief in people else None
