"""`python -m hil` as a process: its one line, its exit codes, and the arm at rest when it ends."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Callable

import numpy as np
import pytest

from cell.clock import perf_s
from cell.config import CellConfig, to_dict
from cell.limits import hermite
from cell.run.link import Heart
from cell.wire import types as T
from cell.wire.codec import decode
from cell.wire.session import Session
from tests.test_limits import HOME, move
from tests.wire_helpers import own_port, pause, until


def node(*options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "hil", "--onions", "1", *options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def configure(process: subprocess.Popen[str], config: CellConfig) -> None:
    assert process.stdin is not None
    process.stdin.write(json.dumps(to_dict(config)) + "\n")
    process.stdin.flush()


def close_stdin(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.close()


def terminate(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGTERM)


@pytest.mark.parametrize("end", [close_stdin, terminate])
def test_ending_the_process_stops_the_arm_on_its_path(end: Callable[[subprocess.Popen[str]], None]) -> None:
    config = own_port()
    process = node()
    out: list[str] = []
    try:
        configure(process, config)
        assert process.stdout is not None
        out.append(process.stdout.readline())
        process.send_signal(signal.SIGINT)  # Ctrl-C is for the supervisor
        seen: list[T.JointState] = []
        status: list[T.ArmStatus] = []
        with Session.connect(config) as session:
            k = session.keys
            session.listen_all(k.joint_states, lambda s: seen.append(decode(T.JointState, s.payload)))
            session.listen_all(k.arm_status, lambda s: status.append(decode(T.ArmStatus, s.payload)))
            heart = Heart(session, "sup", config.supervisor.heartbeat_deadline)
            alive = threading.Event()

            def live() -> None:
                while not alive.wait(0.05):
                    heart.loop_lives()

            threading.Thread(target=live, daemon=True).start()
            until(lambda: bool(status) and status[-1].lease == "sup")
            order = move(HOME, HOME + np.array([0.9, -0.2, 0.2, 0.3, 0.3, 0.6]), 1.6)
            now = seen[-1].t
            order = T.Trajectory(1, "sup", 0.0, now + 5.0, order.times, order.q, order.qd)
            assert session.call(k.trajectory, order, T.Reply).accepted
            pause(0.8)  # the middle of the motion, at its fastest
            speed = float(np.abs(seen[-1].qd).max())
            asked = perf_s()
            end(process)
            process.wait(8.0)
            took = perf_s() - asked
            alive.set()
            heart.close()
        assert speed > 0.5 and took < 4.0
        fine = hermite(order.times, order.q, order.qd, np.linspace(0.0, 1.6, 5000))[0]
        assert max(np.abs(fine - s.q).max(axis=1).min() for s in seen[::10]) < 5e-3
        assert 0.0 < status[-1].progress < 1.0
        assert (status[-1].stop_reason, status[-1].moving) == ("the node ends", False)
        assert process.returncode == 0
        assert process.stderr is not None
        assert [*out, process.stdout.read()] == ["ready\n", ""] and process.stderr.read() == ""
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("not json\n", "expected the configuration as one line of JSON on standard input"),
        ('{"name": "cell"}\n', "standard input: Object missing required field"),
        ("", "expected the configuration as one line of JSON on standard input"),
    ],
)
def test_a_configuration_that_cannot_be_read_is_one_line_and_code_2(line: str, words: str) -> None:
    process = node()
    out, err = process.communicate(line, timeout=30)
    assert (process.returncode, out) == (2, "")
    assert len(err.splitlines()) == 1 and err.startswith(words)


def test_a_port_in_use_is_one_line_and_code_2() -> None:
    config = own_port()
    with Session.listen(config):
        process = node()
        out, err = process.communicate(json.dumps(to_dict(config)) + "\n", timeout=30)
    assert (process.returncode, out) == (2, "")
    assert len(err.splitlines()) == 1 and str(config.port) in err


def test_an_unknown_backend_is_one_line_and_code_2() -> None:
    process = node("--backend", "magic")
    out, err = process.communicate(json.dumps(to_dict(own_port())) + "\n", timeout=30)
    assert (process.returncode, out, err) == (2, "", "backend: got 'magic'; legal values: sim, ur3e\n")
