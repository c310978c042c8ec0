"""What must be right before the arm may be driven; every failure is one line that says what to do."""

from __future__ import annotations

import re
import socket

import numpy as np

from cell.clock import RATE_VARIABLE, clock_rate
from cell.config import CellConfig
from cell.errors import BackendError, ConfigError
from cell.limits import Q_MAX
from hil.ur3e.block import Measured
from hil.ur3e.conditions import robot_condition
from hil.ur3e.dashboard import PORT as DASHBOARD
from hil.ur3e.dashboard import Dashboard

REACH_TIME = 3.0
"""How long a controller may take to answer [s]."""
PORTS = {DASHBOARD: "dashboard", 30003: "control scripts", 30004: "RTDE"}
"""What the driver needs on the controller."""
_LEAST_VERSION = 5
_JOINT_MARGIN = 0.05


def robot_address(config: CellConfig, robot_ip: str) -> str:
    """The controller's address, from the command line or the configuration; raises `ConfigError`."""
    address = robot_ip or config.ur3e.robot_ip
    if not address:
        raise ConfigError(
            "the address of the robot's controller is missing; give --robot-ip or ur3e.robot_ip"
        )
    if not re.fullmatch(r"[A-Za-z0-9.-]{1,253}", address):
        raise ConfigError(f"the robot's address must be an IPv4 address or a host name, got {address!r}")
    return address


def check_reachable(robot_ip: str) -> None:
    """Raise `BackendError` unless a controller answers on all ports in time."""
    hint = (
        "is the controller on, is the address right (pendant: Settings > System > Network), and are both in "
        "the same network?"
    )
    for port, what in PORTS.items():
        if problem := port_problem(robot_ip, port):
            raise BackendError(f"no robot answers at {robot_ip}:{port} ({what}): {problem}; {hint}")
        if port == DASHBOARD:
            try:
                Dashboard(robot_ip, REACH_TIME).close()
            except BackendError as error:
                raise BackendError(f"{error}; {hint}") from None


def port_problem(robot_ip: str, port: int) -> str:
    """Why nothing answers there; empty when something does."""
    try:
        socket.create_connection((robot_ip, port), REACH_TIME).close()
    except TimeoutError:
        return f"no answer within {REACH_TIME:g} s"
    except OSError as error:
        return error.strerror or str(error)
    return ""


def check_clock(cameras: str) -> None:
    """Raises `ConfigError` when clocks go slowly and it is not certain that the controller is emulated."""
    if clock_rate() != 1.0 and cameras != "sim":
        raise ConfigError(f"{RATE_VARIABLE} is for emulated cells (--cameras sim); unset it for a robot")


def check_controller(robot_ip: str) -> None:
    """Model, version, remote control, mode and safety, as the dashboard tells them.

    Raises:
        BackendError: the first thing that is not as it must be.
    """
    with Dashboard(robot_ip, REACH_TIME) as dashboard:
        for problem in (
            version_problem(dashboard.ask("PolyscopeVersion")),
            model_problem(dashboard.ask("get robot model")),
            remote_problem(dashboard.ask("is in remote control")),
            safety_problem(dashboard.value("safetystatus")),
            mode_problem(dashboard.value("robotmode")),
        ):
            if problem:
                raise BackendError(f"{robot_ip}: {problem}")


def version_problem(answer: str) -> str:
    """For the answer to "PolyscopeVersion"."""
    found = re.search(r"(\d+)\.(\d+)", answer)
    if found is None:
        return f"the controller's version cannot be read from {answer!r}"
    if int(found[1]) < _LEAST_VERSION:
        return f"the controller's software is {found[0]}; an e-Series with version 5 or later is needed"
    return ""


def model_problem(answer: str) -> str:
    """For the answer to "get robot model"; an e-Series UR3e calls itself UR3 there."""
    if answer.upper() in ("UR3", "UR3E"):
        return ""
    return f"the robot is a {answer or '?'}; limits and kinematics here are those of the UR3e"


def remote_problem(answer: str) -> str:
    """For the answer to "is in remote control"."""
    if answer.lower() == "true":
        return ""
    return (
        "not in remote control; on the pendant switch Local to Remote (top right; enabled under "
        "Settings > System > Remote Control)"
    )


def safety_problem(status: str) -> str:
    """For the safety status, without its label."""
    if status.upper() in ("NORMAL", "REDUCED"):
        return ""
    return f"the safety status is {status}; clear it with: cell recover"


def mode_problem(mode: str) -> str:
    """For the robot mode, without its label."""
    if mode.upper() == "RUNNING":
        return ""
    return f"the robot is {mode}; power it on and release its brakes with: cell recover"


def check_state(measured: Measured) -> None:
    """The first measured state: joints inside their limits, nothing that stops the arm.

    Raises:
        BackendError: what is not as it must be.
    """
    if problem := robot_condition(measured.safety_mode, measured.safety_bits, measured.robot_mode):
        raise BackendError(f"{problem}; clear it with: cell recover")
    q = np.array(measured.q)
    outside = np.flatnonzero(np.abs(q) > Q_MAX - _JOINT_MARGIN)
    if outside.size:
        i = int(outside[0])
        raise BackendError(
            f"joint {i + 1} stands at {q[i]:.3f} rad, within {_JOINT_MARGIN} rad of its limit of "
            f"{Q_MAX[i]:.3f}; move it away on the pendant"
        )
