"""Looks at this machine and says, line by line, what is there and what is missing."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import socket
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console

from cell.clock import WallClock
from cell.config import CellConfig, load
from cell.errors import CellError

_NAMED = ("numpy", "pybullet", "opencv-python-headless", "eclipse-zenoh", "onnxruntime", "torch")
"""Packages whose versions are told."""
_OPENCVS = (
    "opencv-python-headless",
    "opencv-python",
    "opencv-contrib-python",
    "opencv-contrib-python-headless",
)
_EXTRAS = (
    ("ur3e", "rtde_control", "the real arm's library"),
    ("realsense", "pyrealsense2", "the RealSense camera's library"),
    ("oakd", "depthai", "the OAK-D camera's library"),
    ("learn", "torch", "torch, for training"),
)
_OLD = 180
"""Days after which a calibration should be made again."""
_LEAST_DISK, _SOME_DISK = 0.2, 2.0
"""[GB]"""
_PRIORITY = 3
"""What the arm's driver asks for, see docs/robot.md."""


@dataclass(frozen=True)
class Row:
    """One check: what is wrong, empty when nothing is; else what is there.

    `needed`: without it `cell run` in simulation does not work, or not as configured.
    """

    name: str
    problem: str = ""
    note: str = ""
    needed: bool = True


def examine(
    config_path: Path | None,
    renderer_problem: Callable[[], str],
    robot: Callable[[], list[tuple[str, str, str]]] | None = None,
) -> bool:
    """Print one line per check; True when nothing that `cell run` needs is missing.

    Args:
        config_path: cell description to check, or None for the shipped one.
        renderer_problem: returns why the fast renderer cannot work, empty when it can.
        robot: looks at the robot's controller; returns (name, problem, note) per check.
    """
    console = Console(highlight=False)
    good = True
    for row in _rows(config_path, renderer_problem, robot):
        good = good and (not row.problem or not row.needed)
        bad = "[red]MISS[/red]" if row.needed else "[yellow]warn[/yellow]"
        mark = bad if row.problem else "[green]ok  [/green]"
        console.print(f"{mark} {row.name:<13} {row.problem or row.note}", soft_wrap=True)
    return good


def _rows(
    config_path: Path | None,
    renderer_problem: Callable[[], str],
    robot: Callable[[], list[tuple[str, str, str]]] | None,
) -> Iterator[Row]:
    """The checks one by one, as they are made."""
    found = platform.python_version()
    yield Row("python", "" if sys.version_info[:2] == (3, 11) else f"{found}; 3.11 is needed", found)
    missing = _missing_packages()
    yield Row(
        "packages",
        f"{', '.join(missing)}; run tools/run or pip install -e ." if missing else "",
        f"all installed: {_versions()}",
    )
    yield Row("opencv", _two_opencvs(), "one OpenCV", needed=False)
    config: CellConfig | None = None
    try:
        config = load(config_path)
        yield Row("config", "", str(config_path or "the reference cell"))
    except CellError as error:
        yield Row("config", str(error))
    if config is not None and not missing:
        yield from _perception(config)
    if config is not None:
        yield Row("port", _port_problem(config.port), f"{config.port} is free")
        yield from _calibrations(config)
    problem = renderer_problem()
    slower = f"{problem}; the slower TinyRenderer is used" if problem else ""
    yield Row("renderer", slower, "EGL works", needed=False)
    yield _disk()
    yield _real_time()
    for extra, module, what in _EXTRAS:
        there = find_spec(module) is not None
        yield Row(
            extra,
            "",
            f"{what} is installed" if there else f"not installed ({what}): pip install -e .[{extra}]",
        )
    for name, problem, note in robot() if robot is not None else []:
        yield Row(name, problem, note)


def _perception(config: CellConfig) -> Iterator[Row]:
    """Reach and networks."""
    yield Row(
        "reach", _problem(lambda: _check_reach(config)), "every pick, inspect and place pose is reachable"
    )
    weights = Path(config.detector) if config.detector else None
    problem = _problem(lambda: _check_detector(weights))
    yield Row("detector", problem, f"weights load and run, {'' if problem else _sha(weights)}")
    problem = _problem(lambda: _check_hands(config))
    yield Row("hands", problem, "the hand networks are there, SHA-256 as published", needed=False)


def _calibrations(config: CellConfig) -> Iterator[Row]:
    """Whether and when the cameras were calibrated."""
    for name, camera in config.cameras.items():
        row, c = f"camera {name}", camera.calibration
        if c is None:
            yield Row(row, "", "not calibrated: stands as configured; a real one needs cell calibrate")
            continue
        try:
            made = datetime.strptime(c.date, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC).timestamp()
        except ValueError:
            yield Row(
                row, f"cameras.{name}.calibration.date is no date like 2026-01-31T12:00:00Z", needed=False
            )
            continue
        days = (WallClock().now() - made) / 86400
        note = f"calibrated {days:.0f} days ago, residual {c.residual:.2f} px, {c.made_by}"
        yield Row(row, f"{note}: calibrate again" if days > _OLD else "", note, needed=False)


def _disk() -> Row:
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    note = f"{free:.1f} GB free here"
    if free < _LEAST_DISK:
        return Row("disk", f"{note}, {_LEAST_DISK} GB are needed")
    return Row(
        "disk", f"{note}; a recorded round takes up to 1 GB" if free < _SOME_DISK else "", note, needed=False
    )


def _real_time() -> Row:
    """Whether the system grants real-time priority, which a real arm's driver asks for."""
    if not hasattr(os, "sched_setscheduler"):
        return Row(
            "real time", "this system has no real-time scheduling; for a real arm use Linux", needed=False
        )
    import resource

    highest, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if os.geteuid() == 0 or highest == resource.RLIM_INFINITY or highest >= _PRIORITY:
        return Row("real time", "", "priority is granted")
    return Row(
        "real time",
        f"priority up to {highest} is granted, a real arm's driver asks for {_PRIORITY}: add "
        "'@realtime - rtprio 20' to /etc/security/limits.conf and yourself to that group",
        needed=False,
    )


def _versions() -> str:
    return ", ".join(f"{name} {version(name)}" for name in _NAMED if _installed(name))


def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True


def _two_opencvs() -> str:
    there = [name for name in _OPENCVS if _installed(name)]
    if len(there) < 2:
        return ""
    return f"{' and '.join(there)} overwrite each other's files: uninstall all, then install {_OPENCVS[0]}"


def _sha(weights: Path | None) -> str:
    from cell.perception.detector import shipped_weights

    data = (weights or shipped_weights()).read_bytes()
    return f"SHA-256 {hashlib.sha256(data).hexdigest()[:12]}"


def _missing_packages() -> list[str]:
    try:
        wanted = [r for r in requires("sorting-cell") or [] if "extra ==" not in r]
    except PackageNotFoundError:
        return ["sorting-cell is not installed"]
    missing = []
    for requirement in wanted:
        name = re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]
        if not _installed(name):
            missing.append(f"{name} is not installed")
        elif not _fits(requirement, version(name)):
            missing.append(f"{name} {version(name)} does not fit {requirement}")
    return missing


def _fits(requirement: str, found: str) -> bool:
    try:
        from packaging.requirements import Requirement
    except ImportError:  # comes with onnxruntime; what is missing is said elsewhere
        return True
    return Requirement(requirement).specifier.contains(found, prereleases=True)


def _problem(check: Callable[[], None]) -> str:
    try:
        check()
    except CellError as error:
        return str(error)
    return ""


def _check_reach(config: CellConfig) -> None:
    from cell.motion.reach import check_reachable

    check_reachable(config)


def _check_detector(weights: Path | None) -> None:
    import numpy as np

    from cell.perception.detector import Detector

    detector = Detector(weights)
    detector.detect(np.zeros((64, 64, 3), np.uint8))


def _check_hands(config: CellConfig) -> None:
    from cell.perception.hands.models import MODELS, read_model

    for model in MODELS:
        read_model(model, Path(config.gestures.models) if config.gestures.models else None)


def _port_problem(port: int) -> str:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return f"{port} is in use; end the other program or set 'port:' in the configuration"
    return ""
