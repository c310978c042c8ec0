"""Rounds in processes of their own, on the wire: stopped, killed, and the same for any number of workers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cell.clock import WallClock
from cell.errors import ConfigError
from cell.trials.workers import Cluster, Running

TINY = ["--people", "chen", "--rounds", "1", "--policies", "tb", "--onions", "1", "--seed", "3"]
TINY += ["--perception", "truth", "--no-report"]


def trials(*args: object) -> list[str]:
    return [sys.executable, "-m", "cell.cli", "trials", *map(str, args)]


def run(*args: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(trials(*args), capture_output=True, text=True, timeout=600)


def refused(*args: object) -> str:
    """The one line that bad input is answered with."""
    done = run(*args)
    assert done.returncode == 2 and done.stdout == "" and len(done.stderr.splitlines()) == 1, done.stderr
    return done.stderr


def test_bad_input_is_one_line_and_starts_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert "--rounds must be a multiple" in refused("--rounds", 3, "--out", out)
    assert "--shard" in refused("--shard", "9", "--out", out)
    assert not out.exists()


def test_a_job_that_cannot_run_says_why_and_is_not_tried_again() -> None:
    said = Running().one("{}")
    assert isinstance(said, str) and "spec" in said


def test_a_scheduler_that_is_not_there_is_one_line() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(ConfigError, match=r"--scheduler tcp://127\.0\.0\.1:9"):
        Cluster("tcp://127.0.0.1:9", patience=1.0)


def test_without_dask_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"sorting-cell\[dask\]"):
        Cluster("tcp://127.0.0.1:9")


def test_a_campaign_killed_in_mid_round_leaves_nothing_behind_and_goes_on(tmp_path: Path) -> None:
    first = subprocess.Popen(
        trials(*TINY, "--out", tmp_path), stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        started = until(
            lambda: [pid for child in children(first.pid) for pid in [child, *children(child)]], least=2
        )
    finally:
        os.killpg(first.pid, signal.SIGKILL)
    first.wait(10.0)
    until(lambda: [pid for pid in started if not Path(f"/proc/{pid}").exists()], least=len(started))
    assert not list((tmp_path / "rounds").glob("*.json"))
    again = run(*TINY, "--out", tmp_path)
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "rounds.csv").read_text().count("\n") == 2
    assert sorted(f.suffix for f in (tmp_path / "rounds").iterdir()) == [".json", ".jsonl", ".npz"]


def children(pid: int) -> list[int]:
    """Process ids of a process's children."""
    try:  # of each thread, those that it started
        files = list(Path(f"/proc/{pid}/task").glob("*/children"))
        return [int(x) for file in files for x in file.read_text().split()]
    except OSError:
        return []


def until(found: Callable[[], list[int]], least: int) -> list[int]:
    """Wait until there are so many; a loaded machine may take long."""
    clock = WallClock()
    end = clock.now() + 500.0
    while len(out := found()) < least:
        assert clock.now() < end
        clock.sleep_until(clock.now() + 0.05)
    return out
