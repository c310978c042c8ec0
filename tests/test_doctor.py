"""The doctor's checks one by one; `test_cli` has the command as a whole."""

from __future__ import annotations

import os
import resource
import shutil
from types import SimpleNamespace

import msgspec
import pytest

from cell import doctor
from cell.config import CellConfig, load
from cell.settings import CalibrationConfig


def calibrated(date: str) -> CellConfig:
    config = load()
    belt = config.cameras["belt"]
    record = CalibrationConfig(
        position=(0.0, 0.0, 1.0), quaternion=(0.0, 0.0, 0.0, 1.0), focal=(600.0, 600.0), centre=(320.0, 240),
        measured_at=(belt.width, belt.height, belt.hfov), views=15, residual=0.2, uncertainty=(0.001, 0.001),
        date=date, made_by="a test",
    )  # fmt: skip
    cameras = {**config.cameras, "belt": msgspec.structs.replace(belt, calibration=record)}
    return msgspec.structs.replace(config, cameras=cameras)


@pytest.mark.parametrize(
    ("date", "problem", "note"),
    [
        ("2020-01-01T00:00:00Z", "calibrate again", "calibrated"),
        ("yesterday", "is no date", ""),
        ("2999-01-01T00:00:00Z", "", "residual 0.20 px"),
    ],
)
def test_an_old_calibration_is_told_of(date: str, problem: str, note: str) -> None:
    belt, person = doctor._calibrations(calibrated(date))
    assert problem in belt.problem and bool(problem) == bool(belt.problem) and note in belt.note
    assert not belt.needed and not person.problem and "not calibrated" in person.note


def test_a_package_of_another_version_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        doctor, "requires", lambda name: ["numpy>=99", "no-such-thing<2", "torch; extra == 'learn'"]
    )
    told = doctor._missing_packages()
    assert (
        len(told) == 2 and "does not fit numpy>=99" in told[0] and told[1] == "no-such-thing is not installed"
    )


def test_two_opencvs_are_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not doctor._two_opencvs()
    monkeypatch.setattr(doctor, "_installed", lambda name: True)
    assert "overwrite each other" in doctor._two_opencvs()


@pytest.mark.parametrize(
    ("free", "problem", "needed"), [(1e11, "", False), (1e9, "1 GB", False), (1e6, "needed", True)]
)
def test_a_full_disk_is_told_of(
    monkeypatch: pytest.MonkeyPatch, free: float, problem: str, needed: bool
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free))
    row = doctor._disk()
    assert problem in row.problem and bool(problem) == bool(row.problem) and row.needed == needed


@pytest.mark.parametrize(("limit", "fine"), [(0, False), (20, True)])
def test_missing_real_time_priority_is_told_of(
    monkeypatch: pytest.MonkeyPatch, limit: int, fine: bool
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(resource, "getrlimit", lambda what: (limit, limit))
    row = doctor._real_time()
    assert (not row.problem) == fine
    assert fine or ("limits.conf" in row.problem and not row.needed)


def test_one_line_per_check(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_perception", lambda config: iter(()))
    doctor.examine(None, lambda: "x" * 300, lambda: [("port 29999", "nobody answers", "")])
    lines = capsys.readouterr().out.splitlines()
    assert all(line.split()[0] in ("ok", "warn", "MISS") for line in lines)
    assert any(line.startswith("MISS port 29999") for line in lines)
    assert [line for line in lines if line.startswith("warn renderer")]
    assert not doctor.examine(None, lambda: "", lambda: [("port 29999", "nobody answers", "")])
