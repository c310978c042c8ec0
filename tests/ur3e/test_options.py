"""What users may combine on the command line, and what a round without a truth says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console

from cell.cli import _surroundings
from cell.clock import perf_s
from cell.errors import ConfigError
from cell.run.display import summary
from cell.run.result import RoundResult
from cell.run.round import RoundOptions
from tests.test_cli import cell


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (("sim", "", "", "", True), ("", "sim")),
        (("sim", "", "", "none", False), ("", "none")),
        (("ur3e", "1.2.3.4", "", "", False), ("real", "real")),
        (("ur3e", "1.2.3.4", "sim", "", False), ("sim", "sim")),
        (("ur3e", "1.2.3.4", "real", "none", False), ("real", "none")),
        (("ur3e", "1.2.3.4", ".", "", False), (".", "real")),
    ],
)
def test_what_is_not_said_follows(given: tuple[str, str, str, str, bool], meant: tuple[str, str]) -> None:
    assert _surroundings(*given) == meant


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("magic", "", "", "", False), "legal values: sim, ur3e"),
        (("sim", "1.2.3.4", "", "", False), "--robot-ip and --cameras belong to --backend ur3e"),
        (("sim", "", "real", "", False), "--robot-ip and --cameras belong to --backend ur3e"),
        (("sim", "", "", "real", False), "--person real needs real cameras"),
        (("sim", "", "", "ghost", False), "--person: got 'ghost'"),
        (("ur3e", "1.2.3.4", "", "", True), "a real arm has a clock of its own"),
        (("ur3e", "1.2.3.4", "nowhere.mcap", "", False), "legal values: sim, real, a recording that exists"),
        (("ur3e", "1.2.3.4", "real", "sim", False), "--person sim does not go with --cameras real"),
        (("ur3e", "1.2.3.4", "sim", "real", False), "--person real does not go with --cameras sim"),
    ],
)
def test_what_cannot_be_is_one_line(given: tuple[str, str, str, str, bool], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        _surroundings(*given)
    assert words in str(caught.value)


def test_no_robot_there_is_one_line_within_five_seconds() -> None:
    began = perf_s()
    run = cell("run", "--backend", "ur3e", "--robot-ip", "127.0.0.98")
    assert perf_s() - began < 5.0
    assert run.returncode == 2 and run.stdout == "" and len(run.stderr.splitlines()) == 1
    assert run.stderr.startswith("cell: no robot answers at 127.0.0.98:29999 (dashboard): Connection refused")
    assert cell("run", "--backend", "ur3e").stderr.startswith("cell: the address of the robot's controller")


def result(**changes: object) -> RoundResult:
    known: dict[str, object] = {
        "backend": "ur3e", "policy": "expert", "seed": 0, "person": "real", "onions": 2, "sorted": 2,
        "by_robot": 2, "by_human": None, "misplaced": None, "dropped": None, "sort_time_s": 20.0,
        "mode_switches": 0, "industrial_s": 0.0, "min_separation_m": None,
        "max_tcp_speed_m_s": {"collaborative": 0.2, "industrial": 0.0}, "gesture_delay_s": None,
        "real_time_factor": 1.0, "commit": "", "version": "", "arm_contacts": None, "person_contacts": None,
    }  # fmt: skip
    return RoundResult(**{**known, **changes})  # type: ignore[arg-type]


def test_a_round_without_a_truth_says_what_is_not_known(tmp_path: Path) -> None:
    assert result().succeeded
    assert not result(sorted=1).succeeded and not result(failure="stopped").succeeded
    assert not result(dropped=1).succeeded
    result().write(tmp_path / "r.json")
    data = json.loads((tmp_path / "r.json").read_text())
    assert [data[k] for k in ("by_human", "misplaced", "dropped", "arm_contacts")] == [None] * 4
    console = Console(record=True, width=100)
    summary(console, result())
    assert "not known" in console.export_text()


def test_only_simulated_surroundings_have_a_truth() -> None:
    assert RoundOptions("sim").simulated and RoundOptions("ur3e", cameras="sim").simulated
    assert not RoundOptions("ur3e", cameras="real").simulated
