"""Looks at this machine and says, line by line, what is there and what is missing."""

from __future__ import annotations

import platform
import socket
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from rich.console import Console

from cell.config import CellConfig, load
from cell.errors import CellError


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

    def report(name: str, problem: str, note: str = "", needed: bool = True) -> None:
        nonlocal good
        good = good and (not problem or not needed)
        mark = (
            "[green]ok  [/green]"
            if not problem
            else ("[red]MISS[/red]" if needed else "[yellow]warn[/yellow]")
        )
        console.print(f"{mark} {name:<12} {problem or note}")

    wanted = sys.version_info[:2] == (3, 11)
    report(
        "python", "" if wanted else f"{platform.python_version()}; 3.11 is needed", platform.python_version()
    )
    missing = _missing_packages()
    report(
        "packages",
        f"not installed: {', '.join(missing)}; run tools/run or pip install -e ." if missing else "",
        "all installed",
    )
    config: CellConfig | None = None
    try:
        config = load(config_path)
        report("config", "", str(config_path or "the reference cell"))
    except CellError as error:
        report("config", str(error))
    if config is not None and not missing:
        report(
            "reach", _problem(lambda: _check_reach(config)), "every pick, inspect and place pose is reachable"
        )
        report("detector", _problem(lambda: _check_detector(config)), "weights load and run")
        report("hands", _problem(lambda: _check_hands(config)), "the hand networks are there", needed=False)
    if config is not None:
        report("port", _port_problem(config.port), f"{config.port} is free")
    problem = renderer_problem()
    report(
        "renderer",
        f"{problem}; the slower TinyRenderer is used" if problem else "",
        "EGL works",
        needed=False,
    )
    for name, problem, note in robot() if robot is not None else []:
        report(name, problem, note)
    return good


def _missing_packages() -> list[str]:
    try:
        wanted = [r for r in requires("sorting-cell") or [] if "extra ==" not in r]
    except PackageNotFoundError:
        return ["sorting-cell"]
    missing = []
    for requirement in wanted:
        name = requirement.split(";")[0]
        for mark in "<>=!~[ ":
            name = name.split(mark)[0]
        try:
            version(name)
        except PackageNotFoundError:
            missing.append(name)
    return missing


def _problem(check: Callable[[], None]) -> str:
    try:
        check()
    except CellError as error:
        return str(error)
    return ""


def _check_reach(config: CellConfig) -> None:
    from cell.motion.reach import check_reachable

    check_reachable(config)


def _check_detector(config: CellConfig) -> None:
    import numpy as np

    from cell.perception.detector import Detector

    detector = Detector(Path(config.detector) if config.detector else None)
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
