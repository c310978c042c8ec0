"""Before the arm may be driven: one line per thing that is not right, and what to do about it."""

from __future__ import annotations

import re

import msgspec
import numpy as np
import pytest

from cell.clock import perf_s
from cell.config import load
from cell.errors import BackendError, ConfigError
from cell.limits import Q_MAX
from hil.ur3e import checks
from hil.ur3e.block import Measured
from hil.ur3e.dashboard import Dashboard
from tests.test_cli import free_port
from tests.ur3e.fakes import HOME, LineServer

BANNER = b"Connected: Universal Robots Dashboard Server\n"
GOOD = {
    "PolyscopeVersion": "URSoftware 5.22.0.1234567 (Jan 01 2026)",
    "get robot model": "UR3",
    "is in remote control": "true",
    "safetystatus": "Safetystatus: NORMAL",
    "robotmode": "Robotmode: RUNNING",
}


def server(**changes: str) -> LineServer:
    answers = {**GOOD, **{k.replace("_", " "): v for k, v in changes.items()}}
    return LineServer(lambda request: answers[request.decode().strip()].encode() + b"\n", BANNER)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"PolyscopeVersion": "URSoftware 3.15.8 (CB3)"},
            r"software is 3\.15; an e-Series with version 5 or later",
        ),
        ({"PolyscopeVersion": "?"}, "version cannot be read"),
        ({"get_robot_model": "UR5"}, "the robot is a UR5; limits and kinematics here are those of the UR3e"),
        ({"is_in_remote_control": "false"}, "not in remote control; on the pendant switch Local to Remote"),
        ({"safetystatus": "Safetystatus: PROTECTIVE_STOP"}, "PROTECTIVE_STOP; clear it with: cell recover"),
        ({"robotmode": "Robotmode: POWER_OFF"}, "the robot is POWER_OFF; power it on .* cell recover"),
        ({}, ""),
    ],
)
def test_the_controller_is_asked_before_anything_is_sent(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, str], words: str
) -> None:
    with server(**changes) as dashboard:
        monkeypatch.setattr(checks, "Dashboard", lambda ip, timeout: Dashboard(ip, timeout, dashboard.port))
        if not words:
            checks.check_controller("127.0.0.1")
            return
        with pytest.raises(BackendError) as caught:
            checks.check_controller("127.0.0.1")
    assert re.search(words, str(caught.value)) and "\n" not in str(caught.value)


def test_nobody_there_is_said_at_once() -> None:
    began = perf_s()
    with pytest.raises(BackendError, match=r"no robot answers at 127\.0\.0\.98:29999 \(dashboard\)"):
        checks.check_reachable("127.0.0.98")
    assert perf_s() - began < 4.0


def test_a_dashboard_that_closes_or_says_nothing() -> None:
    with (
        LineServer(lambda request: None, BANNER) as closing,
        Dashboard("127.0.0.1", 1.0, closing.port) as dashboard,
        pytest.raises(BackendError, match="closed"),
    ):
        dashboard.ask("robotmode")
    with LineServer(lambda request: b"") as silent, pytest.raises(BackendError, match="no answer in time"):
        Dashboard("127.0.0.1", 0.2, silent.port)
    with pytest.raises(BackendError, match="no robot answers"):
        Dashboard("127.0.0.1", 0.2, free_port())


def test_joints_must_stand_inside_their_limits() -> None:
    good = Measured(q=HOME, robot_mode=7, safety_mode=1, safety_bits=1)
    checks.check_state(good)
    q = np.array(HOME)
    q[2] = -Q_MAX[2] + 0.01
    with pytest.raises(BackendError, match=r"joint 3 stands at -3\.132 rad, .* move it away on the pendant"):
        checks.check_state(Measured(q=tuple(q.tolist()), robot_mode=7, safety_mode=1))
    with pytest.raises(BackendError, match=r"protective stop.*cell recover"):
        checks.check_state(Measured(q=HOME, robot_mode=7, safety_mode=3, safety_bits=4))


def test_the_address_comes_from_the_command_line_or_the_configuration() -> None:
    config = load()
    configured = msgspec.structs.replace(
        config, ur3e=msgspec.structs.replace(config.ur3e, robot_ip="192.168.1.5")
    )
    assert checks.robot_address(configured, "") == "192.168.1.5"
    assert checks.robot_address(configured, "10.0.0.9") == "10.0.0.9"
    with pytest.raises(ConfigError, match=r"--robot-ip or ur3e\.robot_ip"):
        checks.robot_address(config, "")
    with pytest.raises(ConfigError, match="IPv4 address or a host name"):
        checks.robot_address(config, "127.0.0.1:30004")


def test_slow_clocks_are_for_emulated_cells_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CELL_CLOCK_RATE", "0.5")
    checks.check_clock("sim")
    with pytest.raises(ConfigError, match="unset it for a robot"):
        checks.check_clock("real")
    monkeypatch.delenv("CELL_CLOCK_RATE")
    checks.check_clock("real")
