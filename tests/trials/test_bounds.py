"""CI's campaign fails when it should: a policy that places wrongly, a gripper that slips, a slow cell."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cell.config import load
from cell.decision import policy
from cell.run.result import judge
from cell.trials import bounds, tables
from cell.trials.campaign import Campaign, read
from cell.trials.schedule import schedule
from cell.wire.vocabulary import Action
from tests.in_process import drive
from tests.trials.made import Made

ROOT = Path(__file__).resolve().parent.parent.parent
STORED = ROOT / "tests" / "data" / "ci_bounds.json"


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """The stored campaign with made-up rounds of which the bounds are the truth."""
    stored = bounds.read(STORED)
    chosen = bounds.settings(stored, load())
    Campaign(tmp_path, chosen).run(schedule(chosen), Made(), False, lambda record: None)
    found = bounds.measured(tables.rows(read(tmp_path)))
    mine = {**stored, "bounds": bounds.bounds_of(found, found["rounds"] * chosen.onions)}
    (tmp_path / "bounds.json").write_text(json.dumps(mine))
    return tmp_path


def check(folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    """`tools/ci_campaign` on stored results."""
    command = [sys.executable, str(ROOT / "tools" / "ci_campaign"), "--results", str(folder)]
    command += ["--bounds", str(folder / "bounds.json"), *more]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def spoil(folder: Path, **changes: Any) -> None:
    """Change the result of one round."""
    file = sorted((folder / "rounds").glob("*.json"))[0]
    record = json.loads(file.read_text())
    record["result"] |= changes
    file.write_text(json.dumps(record))


def test_a_campaign_within_its_bounds_passes(campaign: Path) -> None:
    run = check(campaign)
    assert run.returncode == 0 and "all within bounds" in run.stderr


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"dropped": 1}, "dropped: 1, at most 0"),
        ({"sorted": 5}, "incomplete: 1, at most 0"),
        ({"failure": "it took too long"}, "incomplete"),
        ({"misplaced": 3}, "misplaced share"),
        ({"sort_time_s": 400.0}, "simulated seconds, allowed are"),
        ({"sort_time_s": 1.0}, "simulated seconds, allowed are"),
        ({"arm_contacts": 4}, "arm contacts: 4"),
    ],
)
def test_each_bound_fails_with_a_line_of_its_own(campaign: Path, changes: dict[str, Any], said: str) -> None:
    spoil(campaign, **changes)
    run = check(campaign)
    assert run.returncode == 1 and said in run.stderr and "Traceback" not in run.stderr


def test_a_missing_round_fails(campaign: Path) -> None:
    sorted((campaign / "rounds").glob("*.json"))[0].unlink()
    assert "rounds: 3 are done, 4 belong" in check(campaign).stderr


def test_update_prints_the_difference_and_then_passes(campaign: Path) -> None:
    spoil(campaign, sort_time_s=400.0)
    run = check(campaign, "--update")
    assert run.returncode == 0 and "sort_time_s." in run.stdout and " -> " in run.stdout
    assert check(campaign).returncode == 0


def test_the_shipped_bounds_are_complete() -> None:
    stored = bounds.read(STORED)
    chosen = bounds.settings(stored, load())
    assert stored["bounds"]["rounds"] == len(schedule(chosen))
    assert set(stored["bounds"]["sort_time_s"]) == set(chosen.names)
    assert all(stored["bounds"][name] == 0 for name in bounds.LIMITS)


# -- real rounds, as small as they get: what breaks a bound comes from the cell itself ----------------------


def row(backend: Any, outputs: Any, onions: int) -> dict[str, Any]:
    """The columns that bounds look at, of a round in one process."""
    misplaced, dropped, _ = judge(backend.truth())
    return {
        "contender": "tb", "onions": onions, "sorted": outputs.state.sorted, "failure": outputs.failure,
        "misplaced": misplaced, "dropped": dropped, "sort_time_s": outputs.state.t, "over_permitted_ticks": 0,
        "arm_contacts": 0, "person_contacts": 0,
    }  # fmt: skip


def broken(found: dict[str, Any], onions: int) -> list[str]:
    """Bounds that a round breaks, of those that say how onions must be handled."""
    limits = {
        **bounds.LIMITS,
        "rounds": 1,
        "misplaced_share": bounds.MISPLACED,
        "sort_time_s": {"tb": [0, 900]},
    }
    return bounds.violations(bounds.measured([found]), limits)


def test_a_policy_that_places_wrongly_breaks_a_bound() -> None:
    right = policy.load("always-industrial")
    swap = {Action.PLACE_IN_BIN: Action.PLACE_ON_CONVEYOR, Action.PLACE_ON_CONVEYOR: Action.PLACE_IN_BIN}
    wrong = replace(right, actions={s: swap.get(a, a) for s, a in right.actions.items()})
    backend, outputs = drive(2, 1, wrong)
    try:
        lines = broken(row(backend, outputs, 1), 1)
    finally:
        backend.close()
    assert any("misplaced share" in line for line in lines), lines


def test_a_gripper_that_slips_breaks_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    from hil.sim import gripper

    slippery = gripper.bullet

    class Oiled:
        """PyBullet whose fingers have next to no friction."""

        def __getattr__(self, name: str) -> Any:
            return getattr(slippery, name)

        def changeDynamics(self, *args: Any, **values: Any) -> Any:
            if "lateralFriction" in values:
                values |= {"lateralFriction": 0.02, "spinningFriction": 0.0, "frictionAnchor": 0}
            return slippery.changeDynamics(*args, **values)

    monkeypatch.setattr(gripper, "bullet", Oiled())
    backend, outputs = drive(2, 1, policy.load("always-industrial"))
    try:
        lines = broken(row(backend, outputs, 1), 1)
    finally:
        backend.close()
    assert any("dropped" in line or "incomplete" in line for line in lines), lines
