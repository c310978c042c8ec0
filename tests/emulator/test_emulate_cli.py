"""`cell emulate` as users meet it: one line when ready, one line for every mistake, nothing left behind."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cell.clock import perf_s
from hil.sim.render.renderer import gl_problem

CELL = [sys.executable, "-m", "cell.cli", "emulate"]
NO_GL = gl_problem()
END_TIME = 10.0
"""A loaded machine takes longer than the two seconds that a quiet one needs at most [s]."""


@contextmanager
def emulator(address: str, *args: object) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A running emulator and the line it said when it was ready."""
    command = [*CELL, "--listen", address, *map(str, args)]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None and process.stderr is not None
        line = process.stdout.readline()
        yield process, line or process.stderr.read()
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def children(pid: int) -> list[int]:
    return [
        int(child)
        for task in Path(f"/proc/{pid}/task").iterdir()
        for child in (task / "children").read_text().split()
    ]


def dashboard(address: str, *lines: str) -> list[str]:
    with socket.create_connection((address, 29999), 5.0) as sock, sock.makefile("rw", newline="\n") as file:
        file.readline()
        answers = []
        for line in lines:
            file.write(line + "\n")
            file.flush()
            answers.append(file.readline().strip())
        return answers


def ends(process: subprocess.Popen[str], number: int) -> None:
    began = perf_s()
    process.send_signal(number)
    out, err = process.communicate(timeout=END_TIME + 5.0)
    assert process.returncode == 0 and err == ""
    assert out.startswith("cell: ended after ") and perf_s() - began < END_TIME


def refused(*args: object) -> str:
    run = subprocess.run([*CELL, *map(str, args)], capture_output=True, text=True, timeout=60)
    assert run.returncode == 2 and run.stdout == "", run
    (line,) = run.stderr.splitlines()
    assert line.startswith("cell: ")
    return line


@pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
def test_linked_to_a_program_it_ends_with_it() -> None:
    with emulator("127.0.0.49", "--onions", 0, "--persona", "none", "--linked") as (process, line):
        assert "emulated at" in line
        (child,) = children(process.pid)
        assert process.poll() is None and process.stdin is not None
        process.stdin.close()
        assert process.wait(END_TIME) == 0 and not Path(f"/proc/{child}").exists()
        process.stdin = None  # `communicate` would flush it


@pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
def test_starts_serves_everything_and_leaves_nothing() -> None:
    address = "127.0.0.47"
    with emulator(address, "--onions", 2, "--persona", "bo") as (process, line):
        assert line.startswith(f"cell: ur3e emulated at {address}: dashboard 29999, "), line
        for port in (29999, 30001, 30002, 30003, 30004, 63352, 7448):
            assert str(port) in line
            socket.create_connection((address, port), 5.0).close()
        assert dashboard(address, "robotmode", "is in remote control") == ["Robotmode: RUNNING", "true"]
        second = subprocess.run([*CELL, "--listen", address], capture_output=True, text=True, timeout=60)
        assert second.returncode == 2 and "in use" in second.stderr and len(second.stderr.splitlines()) == 1
        (child,) = children(process.pid)
        ends(process, signal.SIGINT)
        assert not Path(f"/proc/{child}").exists()


def test_a_bare_arm_that_is_off() -> None:
    address = "127.0.0.48"
    with emulator(address, "--bare", "--powered-off", "--model", "ur5e") as (process, line):
        assert line.startswith(f"cell: ur5e emulated at {address}: ") and "surroundings" not in line
        assert children(process.pid) == []
        modes = dashboard(address, "robotmode", "get robot model")
        assert modes[0] in ("Robotmode: POWER_OFF", "Robotmode: BOOTING") and modes[1] == "UR5"
        ends(process, signal.SIGTERM)


def test_an_arm_with_faults_to_come_is_powered_up_before_it_is_said_to_be_ready() -> None:
    address = "127.0.0.46"
    with emulator(address, "--bare", "--fault", "protective_stop:at=600") as (process, _):
        assert dashboard(address, "robotmode") == ["Robotmode: RUNNING"]
        ends(process, signal.SIGTERM)


def test_programs_are_loaded_from_a_folder(tmp_path: Path) -> None:
    address = "127.0.0.45"
    (tmp_path / "wait.urp").write_text("def wait():\n  sleep(600)\nend\n")
    (tmp_path / "loop.urp").write_text("while True:\n  sync()\nend\n")
    (tmp_path.parent / "outside.urp").write_text("sleep(1)\n")
    with emulator(address, "--bare", "--programs", tmp_path) as (process, _):
        assert dashboard(address, "load /programs/wait.urp", "play")[1] == "Starting program"
        end = perf_s() + END_TIME
        while dashboard(address, "running") != ["Program running: true"]:
            assert perf_s() < end
        assert dashboard(address, "pause", "stop") == ["Pausing program", "Stopped"]
        assert dashboard(address, "load external_control.urp") == ["Loading program: external_control.urp"]
        for name in ("loop.urp", "none.urp", "../outside.urp", str(tmp_path), ".", "a\0b", "x" * 3000):
            assert dashboard(address, f"load {name}") == [f"File not found: {name}"]
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=END_TIME + 5.0)
        assert "programs with control flow cannot be run" in out + err


@pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
def test_a_killed_emulator_takes_its_child_along() -> None:
    with emulator("127.0.0.49", "--onions", 1, "--persona", "none") as (process, line):
        assert "emulated" in line, line
        (child,) = children(process.pid)
        process.kill()
        process.wait()
        end = perf_s() + END_TIME
        while Path(f"/proc/{child}").exists():
            assert perf_s() < end
            os.sched_yield()


@pytest.mark.parametrize(
    ("args", "line"),
    [
        (["--listen", "localhost"], "--listen must be an IPv4 address of this machine"),
        (["--listen", "192.0.2.7", "--bare"], "cannot serve dashboard on 192.0.2.7:29999"),
        (["--model", "ur10"], "model of the arm: got 'ur10'; legal values: ur3e, ur5e"),
        (["--persona", "zoe"], "persona 'zoe' is unknown; legal values: none, ana, "),
        (["--onions", "16"], "onions must be from 0 to 15, got 16"),
        (["--seed", "-1"], "seed must be from 0 to 2^63 - 1, got -1"),
        (["--programs", "/nowhere"], "--programs: there is no folder '/nowhere'"),
        (["--fault", "boom"], "--fault: got 'boom'; legal values: delay, drop, "),
    ],
)
def test_mistakes_are_one_line(args: list[str], line: str) -> None:
    assert line in refused(*args)
