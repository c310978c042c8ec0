"""The reports' rows, on runs far too short to learn anything."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from cell.errors import ConfigError
from cell.learn import reports
from cell.learn.commands import bank_for, report
from cell.learn.domain.presets import preset
from cell.learn.job import Job
from cell.learn.settings import tuned
from cell.learn.yardsticks import Row

KEYS = {
    "preset", "recovery", "method", "decoding", "seeds", "onions", "reward_truth", "reward_priced",
    "reward_shaped", "priced_steps", "ratio_to_expert",
}  # fmt: skip
METHODS = {
    "expert", "tb-decairl", "dec-airl", "bc", "bc-no-belief", "never-speed-up", "always-industrial",
    "qmdp", "dp",
}  # fmt: skip


@cache
def rows(what: str, workers: int = 1, seeds: int = 1) -> list[Row]:
    rules = preset("paper")
    job = Job(seeds, 60, tuned(iterations=1), "announced", workers)
    ticks: list[str] = []
    out = reports.REPORTS[what](rules, bank_for(rules, "announced"), job, ticks.append)
    assert len(ticks) == reports.steps(what, (("paper", 20),), job)
    return out


def test_table_1_has_every_method_and_the_contracts_columns(tmp_path: Path) -> None:
    table = rows("table1")
    assert {r["method"] for r in table} >= METHODS and all(set(r) >= KEYS for r in table)
    by = {(r["method"], r["decoding"]): r["reward_priced"]["mean"] for r in table}
    assert by["never-speed-up", "greedy"] < by["expert", "greedy"] < by["dp", "greedy"]
    assert by["bc", "greedy"] == pytest.approx(by["expert", "greedy"], rel=0.01)
    reports.draw("table1", table, tmp_path / "t.png")
    assert (tmp_path / "t.png").stat().st_size > 5000


def test_rows_do_not_depend_on_the_number_of_processes() -> None:
    assert rows("table1", workers=2) == rows("table1")


def test_missed_gestures_hurt_who_only_counts_gestures() -> None:
    found = {(r["method"], r["missed_gestures"]): r["reward_priced"]["mean"] for r in rows("robustness")}
    counted, filtered = ([found[f"expert, {b}", m] for m in (0.0, 0.4)] for b in ("last gesture", "GRU"))
    assert counted[1] < counted[0] - 1.5 and filtered[1] > counted[1] + 1.0


def test_unknown_reports_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="table1, fig4"):
        report("table2", tmp_path / "x.json")
