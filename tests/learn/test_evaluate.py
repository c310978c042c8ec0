"""Evaluation of policies: the published figures, as the command gives them, and their error bars."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

from cell.learn.commands import evaluate
from cell.learn.metrics import statistic

STATISTICS = ("onions", "reward_truth", "reward_priced", "reward_shaped", "priced_steps")

PUBLISHED = [
    # policy, start, onions mean and sd, the environment's own reward and, where it is known, its sd
    ("expert", "random", 44.6, 1.4, 64.7, 2.5),
    ("expert", "fixed", 44.7, 1.4, 65.0, 2.3),
    ("expert-never-speed-up", "random", 45.5, 1.4, 66.3, 2.5),
    ("expert-always-industrial", "random", 56.8, 1.5, 83.3, 2.5),
]


def within(ours: Any, mean: float, sd: float, episodes: int) -> bool:
    """The oracle's mean lies in the joint 95 % interval (and its last digit)."""
    return bool(abs(ours["mean"] - mean) <= np.hypot(ours["ci95"], 1.96 * sd / np.sqrt(episodes)) + 0.05)


@pytest.mark.parametrize(("policy", "start", "onions", "sd", "shaped", "shaped_sd"), PUBLISHED)
def test_published_figures(
    policy: str, start: str, onions: float, sd: float, shaped: float, shaped_sd: float
) -> None:
    result: dict[str, Any] = evaluate("released", policy, 1000, seed=21, start=start)
    assert within(result["onions"], onions, sd, 400)
    assert within(result["reward_shaped"], shaped, shaped_sd, 400)
    # The error of a standard deviation of n episodes is sd / sqrt(2 n), theirs of 400 and ours of 1,000.
    spread = 2.6 * sd * np.hypot(1 / np.sqrt(800), 1 / np.sqrt(2000)) + 0.05
    assert result["onions"]["sd"] == pytest.approx(sd, abs=spread)
    assert result["reward_truth"] == result["onions"]  # the expert never errs on its own prediction
    assert result["invalid_episodes"] == 0


PAPER = [
    # recovery, policy, reward (priced), priced steps; 4,000 episodes each
    (10, "expert", 38.47, 3.8),
    (20, "expert", 38.05, 2.7),
    (20, "expert-never-speed-up", 35.59, 0.0),
    (20, "expert-always-industrial", 27.39, 35.2),
]


@pytest.mark.parametrize(("recovery", "policy", "reward", "steps"), PAPER)
def test_paper_figures(recovery: int, policy: str, reward: float, steps: float) -> None:
    result: dict[str, Any] = evaluate("paper", policy, 1000, seed=21, recovery=recovery)
    assert within(result["reward_priced"], reward, 1.5, 4000)
    assert within(result["priced_steps"], steps, 2.0, 4000)
    difference = result["reward_truth"]["mean"] - result["reward_priced"]["mean"]
    assert difference == pytest.approx(0.5 * result["priced_steps"]["mean"], abs=1e-4)


def test_the_file_is_the_contracts_and_a_seed_repeats_it(tmp_path: Path) -> None:
    def run(seed: int) -> dict[str, Any]:
        evaluate("paper", "expert", 50, seed=seed, json_file=tmp_path / "e.json")
        result: dict[str, Any] = json.loads((tmp_path / "e.json").read_text())
        assert result.pop("steps_per_second") > 0
        return result

    first = run(3)
    assert {"preset", "policy", "episodes", "invalid_episodes", *STATISTICS} <= set(first)
    assert all(set(first[key]) == {"mean", "sd", "ci95"} for key in STATISTICS)
    assert first == run(3) != run(4)


def test_an_interval_holds_the_mean_19_times_in_20() -> None:
    rng, hits = np.random.default_rng(0), 0
    for _ in range(1000):
        s = statistic(rng.normal(5.0, 2.0, 200))
        hits += abs(s["mean"] - 5.0) <= s["ci95"]
    assert hits / 1000 == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(("method", "reward"), [("tb-decairl", 38.05), ("dec-airl", 35.59)])
def test_shipped_policies_score_as_their_networks_did(method: str, reward: float) -> None:
    """TB-DecAIRL equals the expert, greedy Dec-AIRL a robot that never speeds up (4,000 episodes each)."""
    from importlib.resources import files

    from cell.decision.policy import shipped

    human = Path(str(files("cell.learn") / "policies" / f"{method}-human.csv"))
    result: dict[str, Any] = evaluate("paper", str(shipped()[method]), 1000, seed=31, human=human)
    assert within(result["reward_priced"], reward, 1.3, 4000) and result["invalid_episodes"] == 0
