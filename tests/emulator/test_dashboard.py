"""The dashboard's answers, word for word as clients check them."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator

import pytest

from cell.errors import BackendError
from hil.emulator.emulator import Emulator
from hil.emulator.interfaces import RobotMode, RuntimeState, SafetyMode
from hil.emulator.interfaces_faults import NoFaults
from tests.emulator.ideal import SWEEP, Sweep
from tests.emulator.rig import LATEST, Lines, running, until


def find(name: str, host: str) -> Sweep:
    assert host == "127.0.0.1"
    if name != "sweep.urp":
        raise BackendError(f"no program {name!r} on this controller")
    return Sweep(SWEEP)


@pytest.fixture(scope="module")
def emulator() -> Iterator[Emulator]:
    with running(find=find) as served:
        yield served


@pytest.fixture
def lines(emulator: Emulator) -> Iterator[Lines]:
    client = Lines(emulator.ports.dashboard)
    yield client
    client.close()


@pytest.mark.parametrize(
    ("ask", "answer"),
    [
        ("PolyscopeVersion", r"URSoftware 5\.22\.\d+\.\d+ \(\w+ \d+ \d+\)"),
        ("version", r"5\.22\.\d+\.\d+"),
        ("get serial number", r"20\d{9}"),
        ("get robot model", "UR3"),
        ("is in remote control", "true"),
        ("robotmode", "Robotmode: RUNNING"),
        ("safetymode", "Safetymode: NORMAL"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("running", "Program running: false"),
        ("programState", "STOPPED <unnamed>"),
        ("isProgramSaved", "true <unnamed>"),
        ("get loaded program", "No program loaded"),
        ("load nothing.urp", "File not found: nothing.urp"),
        ("play", "Failed to execute: play"),
        ("pause", "Failed to execute: pause"),
        ("stop", "Stopped"),
        ("popup Mind the gap", "showing popup"),
        ("close popup", "closing popup"),
        ("addToLog here I was", "Added log message"),
        ("saveLog", "Log saved to disk"),
        ("close safety popup", "closing safety popup"),
        ("unlock protective stop", "Protective stop releasing"),
        ("set operational mode manual", "Setting operational mode: MANUAL"),
        ("get operational mode", "MANUAL"),
        ("clear operational mode", "No longer controlling the operational mode"),
        ("getUserRole", "PROGRAMMER"),
        ("  RobotMode  ", "Robotmode: RUNNING"),
        ("make coffee", "could not understand: 'make coffee'"),
    ],
)
def test_answers(lines: Lines, ask: str, answer: str) -> None:
    assert lines.banner == "Connected: Universal Robots Dashboard Server"
    assert re.fullmatch(answer, lines.ask(ask)), answer


def test_a_loaded_program_is_played_paused_and_stopped(emulator: Emulator, lines: Lines) -> None:
    assert lines.ask("load sweep.urp") == "Loading program: sweep.urp"
    assert lines.ask("get loaded program") == "Loaded program: sweep.urp"
    assert lines.ask("play") == "Starting program"
    until(emulator, lambda c: c.runtime_state is RuntimeState.PLAYING)
    assert lines.ask("running") == "Program running: true"
    assert lines.ask("programState") == "PLAYING sweep"
    assert lines.ask("pause") == "Pausing program"
    until(emulator, lambda c: c.runtime_state is RuntimeState.PAUSED)
    assert lines.ask("programState") == "PAUSED sweep"
    assert lines.ask("play") == "Starting program"
    until(emulator, lambda c: c.runtime_state is RuntimeState.PLAYING)
    assert lines.ask("stop") == "Stopped"
    until(emulator, lambda c: c.runtime_state is RuntimeState.STOPPED)
    assert lines.ask("running") == "Program running: false"


def test_power_off_and_on(emulator: Emulator, lines: Lines) -> None:
    assert lines.ask("power off") == "Powering off"
    until(emulator, lambda c: c.robot_mode is RobotMode.POWER_OFF)
    assert lines.ask("robotmode") == "Robotmode: POWER_OFF"
    assert lines.ask("power on") == "Powering on"
    until(emulator, lambda c: c.robot_mode is RobotMode.IDLE)
    assert lines.ask("brake release") == "Brake releasing"
    until(emulator, lambda c: c.robot_mode is RobotMode.RUNNING)


def test_stops_are_told_and_lifted(emulator: Emulator, lines: Lines) -> None:
    emulator.do(lambda c: c.protective_stop("on purpose"))
    assert lines.ask("safetymode") == "Safetymode: PROTECTIVE_STOP"
    refusal = lines.ask("unlock protective stop")
    assert refusal.startswith("Cannot unlock protective stop until 5s after occurrence.")
    emulator.do(lambda c: c.violation("on purpose"))
    until(emulator, lambda c: c.robot_mode is RobotMode.POWER_OFF)
    assert lines.ask("safetystatus") == "Safetystatus: VIOLATION"
    assert lines.ask("power on") == "Failed to execute: power on"
    assert lines.ask("restart safety") == "Restarting safety"
    until(emulator, lambda c: c.robot_mode is RobotMode.POWER_OFF and c.safety_mode is SafetyMode.NORMAL)
    assert lines.ask("brake release") == "Brake releasing"
    until(emulator, lambda c: c.robot_mode is RobotMode.RUNNING)


def test_quit_ends_the_connection(emulator: Emulator) -> None:
    client = Lines(emulator.ports.dashboard)
    assert client.ask("quit") == "Disconnected" and client.line() == ""
    client.close()


def test_commands_may_come_in_pieces_or_together(emulator: Emulator) -> None:
    client = Lines(emulator.ports.dashboard)
    client.socket.sendall(b"robotmode\r\nsafety")
    assert client.line() == "Robotmode: RUNNING"
    client.socket.sendall(b"mode\nrunning\n")
    assert [client.line(), client.line()] == ["Safetymode: NORMAL", "Program running: false"]
    client.close()


def test_an_endless_line_ends_the_connection(emulator: Emulator) -> None:
    sock = socket.create_connection(("127.0.0.1", emulator.ports.dashboard), LATEST)
    sock.sendall(b"x" * 5000)
    with sock.makefile("rb") as file:
        assert file.read() == b"Connected: Universal Robots Dashboard Server\n"
    sock.close()


def test_local_control_refuses_commands() -> None:
    class Local(NoFaults):
        def remote_control(self) -> bool:
            return False

    with running(faults=Local()) as served:
        client = Lines(served.ports.dashboard)
        assert client.ask("is in remote control") == "false"
        assert client.ask("play") == 'Command is not allowed in local control: "play"'
        assert client.ask("robotmode") == "Robotmode: RUNNING"
        client.close()
