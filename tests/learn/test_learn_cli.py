"""`cell evaluate`, `cell report` and `cell train` as their users call them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest


def cell(*args: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "cell.cli", *(str(a) for a in args)],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=cwd,
        check=False,
    )


def test_evaluate_writes_the_contracts_json(tmp_path: Path) -> None:
    run = cell(
        "evaluate", "--preset", "released", "--episodes", 200, "--seed", 3, "--start", "random",
        "--json", "e.json", cwd=tmp_path,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    result = json.loads((tmp_path / "e.json").read_text())
    assert result["preset"] == "released" and result["policy"] == "expert" and result["episodes"] == 200
    for key in ("onions", "reward_truth", "reward_priced", "reward_shaped", "priced_steps"):
        assert set(result[key]) == {"mean", "sd", "ci95"}
    assert result["onions"]["mean"] == pytest.approx(44.6, abs=0.4)
    assert result["invalid_episodes"] == 0 and result["steps_per_second"] > 1000


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("evaluate", "--preset", "papers"), "legal values: released, paper, cell"),
        (("evaluate", "--policy", "nowhere.csv"), "nowhere.csv"),
        (("evaluate", "--decoding", "best"), "greedy, sampled"),
        (("evaluate", "--episodes", 0), "--episodes"),
        (("evaluate", "--recovery", 0), "--recovery"),
        (("report", "table9"), "table1, fig4"),
        (("report", "table1", "--preset", "paper"), "paper:20"),
        (("train", "tb-decairl", "--settings", "quick"), "--settings"),
        (("train", "tb-decairl", "--belief", "none.safetensors"), "none.safetensors"),
        (("train", "belief", "--label", "felt"), "--label"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path: Path, args: tuple[object, ...], words: str) -> None:
    run = cell(*args, cwd=tmp_path)
    lines = run.stderr.strip().splitlines()
    assert run.returncode == 2 and len(lines) == 1 and words in lines[0], run.stderr
    assert not (tmp_path / "runs").exists()


def test_train_writes_what_the_supervisor_loads_and_goes_on_where_it_stopped(tmp_path: Path) -> None:
    from cell.decision.policy import load

    options = ("--preset", "paper", "--seed", 2, "--out", "run")
    for _ in range(2):
        run = cell("train", "tb-decairl", *options, "--iterations", 2, cwd=tmp_path)
        assert run.returncode == 0, run.stderr
    run = cell("train", "tb-decairl", *options, "--iterations", 3, cwd=tmp_path)
    assert run.returncode == 2 and "iterations 2, not 3" in run.stderr
    for agent in ("robot", "human"):
        assert len(load(str(tmp_path / "run" / f"{agent}.csv")).actions) == 64 * 20
    curve = json.loads((tmp_path / "run" / "curve.json").read_text())
    assert [p["iteration"] for p in curve["progress"]] == [1, 2]
    assert (tmp_path / "run" / "curve.png").stat().st_size > 5000
    # The exported table scores as the network does (both greedy, 1,000 episodes).
    result = json.loads((tmp_path / "run" / "result.json").read_text())["greedy"]["reward_priced"]
    run = cell(
        "evaluate", "--policy", "run/robot.csv", "--human", "run/human.csv", "--seed", 4321,
        "--json", "e.json", cwd=tmp_path,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    again = json.loads((tmp_path / "e.json").read_text())["reward_priced"]
    assert again["mean"] == pytest.approx(result["mean"], abs=1.5 * (again["ci95"] + result["ci95"]) + 0.05)
