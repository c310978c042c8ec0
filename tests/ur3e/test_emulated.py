"""The real arm's backend, its node and `cell recover` on an emulated controller, by unmodified ur-rtde."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell.clock import WallClock, perf_s
from cell.config import CellConfig, to_dict
from cell.errors import BackendError, CellError
from cell.limits import tcp_positions
from cell.run.link import Heart
from cell.wire import types as T
from cell.wire.codec import decode
from cell.wire.session import Session
from hil.backend import make_backend
from hil.node import Node
from hil.ur3e.dashboard import Dashboard
from hil.ur3e.recover import look, recover
from tests.emulated import patient
from tests.test_cli import cell
from tests.test_limits import HOME, move
from tests.ur3e.arm_process import ArmProcess
from tests.wire_helpers import own_port, pause, until

ADDRESS, OTHER_ADDRESS = "127.0.0.52", "127.0.0.53"
AWAY = HOME + np.array([0.3, -0.15, 0.15, 0.1, 0.1, 0.2])


@pytest.fixture(scope="module")
def arm() -> Iterator[ArmProcess]:
    process = ArmProcess(ADDRESS)
    yield process
    process.close()


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Something to look at: one picture per camera."""
    folder = tmp_path_factory.mktemp("pictures")
    for name in ("belt", "person"):
        (folder / name).mkdir()
        cv2.imwrite(str(folder / name / "color_0.png"), np.zeros((480, 640, 3), np.uint8))
        cv2.imwrite(str(folder / name / "depth_0.png"), np.full((480, 640), 800, np.uint16))
    return str(folder)


class Rig:
    """A node on the emulated arm, and a supervisor's end of the wire."""

    def __init__(self, arm: ArmProcess, pictures: str) -> None:
        self.arm = arm
        self.config: CellConfig = patient(own_port())
        self.server = Session.listen(self.config)
        self.backend = make_backend("ur3e", self.config, robot_ip=ADDRESS, cameras=pictures)
        try:
            self.backend.connect()
            self.node = Node(self.config, self.backend, self.server, lock_step=False)
        except CellError:
            self.server.close()
            raise
        self.client = Session.connect(self.config)
        self.keys = self.client.keys
        self.arm_status = self.client.latest(self.keys.arm_status, T.ArmStatus)
        self.joints = self.client.latest(self.keys.joint_states, T.JointState)
        self.events: list[str] = []
        self.track: list[T.JointState] = []
        self.client.listen_all(
            self.keys.events, lambda s: self.events.append(decode(T.Event, s.payload).text)
        )
        self.client.listen_all(
            self.keys.joint_states, lambda s: self.track.append(decode(T.JointState, s.payload))
        )
        pause(0.1)
        self.thread = threading.Thread(target=self._run)
        self.thread.start()
        self.heart = Heart(self.client, "sup", self.config.supervisor.heartbeat_deadline)
        self.heart.loop_lives = lambda: None  # type: ignore[method-assign]
        self.heart._loop_deadline = 1e9
        self._number = 0
        until(lambda: (s := self.arm_status.peek()) is not None and s.lease == "sup")

    def _run(self) -> None:
        self.node.run()

    @property
    def status(self) -> T.ArmStatus:
        status = self.arm_status.peek()
        assert status is not None
        return status

    @property
    def q(self) -> np.ndarray:
        joints = self.joints.peek()
        assert joints is not None
        return joints.q

    def order(self, end: np.ndarray, seconds: float = 1.5) -> T.Reply:
        self._number += 1
        order = move(self.q, end, seconds)
        now = WallClock().now() + 5.0
        return self.client.call(
            self.keys.trajectory,
            T.Trajectory(self._number, "sup", 0.0, now, order.times, order.q, order.qd),
            T.Reply,
        )

    def go(self, end: np.ndarray, seconds: float = 1.5) -> None:
        """Move there and wait for it; the first motion takes longer than asked for."""
        reply = self.order(end, seconds)
        assert reply.accepted, reply
        until(lambda: self.status.trajectory_id == self._number and not self.status.moving, 30.0)
        pause(0.3)

    def resume(self) -> T.Reply:
        return self.client.call(self.keys.resume, T.Resume("sup"), T.Reply)

    def resumed(self, seconds: float = 15.0) -> None:
        """Ask until it is accepted; the control program takes a moment to start."""
        end = perf_s() + seconds
        while not (reply := self.resume()).accepted:  # "backend": what an attempt before came to
            assert reply.code in ("busy", "backend") and perf_s() < end, reply
            pause(0.1)
        until(lambda: not self.status.stopped)

    def close(self) -> None:
        self.node.end()
        self.thread.join(10.0)
        self.heart.close()
        self.client.close()
        self.server.close()
        self.backend.close()


@pytest.fixture(scope="module")
def shared(arm: ArmProcess, pictures: str) -> Iterator[Rig]:
    rig = Rig(arm, pictures)
    yield rig
    rig.close()


@pytest.fixture
def rig(shared: Rig) -> Rig:
    """Ready for a motion, at home, with nothing said and nothing driven yet."""
    if shared.status.stopped:
        shared.resumed()
    if np.abs(shared.q - HOME).max() > 1e-3:
        shared.go(HOME)
    shared.events.clear()
    shared.track.clear()
    return shared


def test_a_trajectory_is_executed_and_the_first_one_is_slow(rig: Rig) -> None:
    length = rig.config.gripper.length
    fine = tcp_positions(move(rig.q, AWAY, 1.5).q, length)
    meant = float(np.linalg.norm(np.diff(fine, axis=0), axis=1).max() / 0.008) if len(fine) > 100 else 1.0
    rig.go(AWAY)
    assert np.abs(rig.q - AWAY).max() <= 1e-3
    track = list(rig.track)  # it still grows
    t, q = np.array([s.t for s in track]), np.array([s.q for s in track])
    keep = np.concatenate([[True], np.diff(t) > 1e-6])
    t, p = t[keep], tcp_positions(q[keep], length)
    window = 31  # 0.25 s: neither packets that come late nor cycles that were made up for count as speed
    speed = np.linalg.norm(p[window:] - p[:-window], axis=1) / (t[window:] - t[:-window])
    assert speed.max() < 0.12 < meant
    assert any("first motion: slowed down" in text for text in rig.events)
    began = perf_s()
    rig.go(HOME, 1.2)
    assert np.abs(rig.q - HOME).max() <= 1e-3 and perf_s() - began < 4.0
    assert rig.arm.press("state")["q"] == pytest.approx(HOME.tolist(), abs=1e-3)


def test_a_stop_is_on_the_path_and_only_a_fresh_plan_goes_on(rig: Rig) -> None:
    assert rig.order(AWAY).accepted
    pause(1.0)
    assert rig.client.call(rig.keys.stop, T.Stop("anyone", "a test"), T.Reply).accepted
    until(lambda: rig.status.stopped and not rig.status.moving)
    pause(0.3)
    at = rig.q
    assert "stopped: a test" in rig.order(AWAY).reason or not rig.order(AWAY).accepted
    rig.resumed()
    pause(0.3)
    assert np.abs(rig.q - at).max() < 1e-3
    rig.go(HOME)


STOPS: list[tuple[str, str, Callable[[Rig], object], Callable[[Rig], object]]] = [
    (
        "protective stop",
        "protective stop",
        lambda rig: rig.arm.press("protective_stop"),
        lambda rig: recovered(),
    ),
    (
        "safeguard stop",
        "safeguard stop",
        lambda rig: rig.arm.press("safeguard", True),
        lambda rig: rig.arm.press("safeguard", False),
    ),
    (
        "paused on the pendant, then play",
        "program stopped",
        lambda rig: pendant("pause"),
        lambda rig: pendant("play"),
    ),
    (
        "emergency stop",
        "emergency stop",
        lambda rig: rig.arm.press("emergency", True),
        lambda rig: (rig.arm.press("emergency", False), recovered()),
    ),
    (
        "cable",
        "disconnected",
        lambda rig: rig.arm.press("pull", True),
        lambda rig: rig.arm.press("pull", False),
    ),
    (
        "silence",
        "disconnected",
        lambda rig: rig.arm.press("silence", True),
        lambda rig: rig.arm.press("silence", False),
    ),
]


def recovered(address: str = ADDRESS) -> None:
    said: list[str] = []
    assert recover(address, said.append) == 0, said
    assert said[-1].startswith("ready")


def pendant(request: str) -> None:
    with Dashboard(ADDRESS) as dashboard:
        dashboard.ask(request)


@pytest.mark.parametrize(("name", "press", "mend"), [s[1:] for s in STOPS], ids=[s[0] for s in STOPS])
def test_a_stop_of_the_robot_has_a_name_and_nothing_goes_on_by_itself(
    rig: Rig, name: str, press: Callable[[Rig], object], mend: Callable[[Rig], object]
) -> None:
    assert rig.order(AWAY).accepted
    until(lambda: np.abs(rig.q - HOME).max() > 0.02, 10.0)
    press(rig)
    until(lambda: rig.status.stopped, 5.0)
    assert rig.status.stop_reason.startswith(name), rig.status.stop_reason
    until(lambda: any(text.startswith(f"stop: {name}") for text in rig.events))
    until(lambda: not rig.status.moving)
    if name != "program stopped":
        assert not rig.resume().accepted
    mend(rig)
    pause(0.5)
    at = np.array(rig.arm.press("state")["q"])
    pause(0.5)
    state = rig.arm.press("state")
    assert np.abs(np.array(state["q"]) - at).max() < 1e-4, "it moved by itself"
    assert rig.status.stopped
    rig.resumed()
    pause(0.3)
    assert np.abs(np.array(rig.arm.press("state")["q"]) - at).max() < 2e-3, "resume moved it"
    rig.go(HOME)
    assert np.abs(rig.q - HOME).max() <= 1e-3


def test_local_control_refuses_the_resume_by_name(rig: Rig) -> None:
    pendant("stop")
    until(lambda: rig.status.stopped)
    rig.arm.press("local", True)
    try:
        until(lambda: "remote control" in rig.resume().reason, 10.0)
    finally:
        rig.arm.press("local", False)
    until(lambda: rig.resume().accepted, 10.0)


def test_the_slider_slows_the_path_down_once(rig: Rig) -> None:
    rig.go(HOME + 0.01, 1.0)  # the first motion
    rig.arm.press("slider", 0.5)
    try:
        until(lambda: abs(rig.status.speed_scaling - 0.5) < 0.01)
        began = perf_s()
        rig.go(HOME, 1.0)
        assert 1.9 < perf_s() - began - 0.3 < 3.5
    finally:
        rig.arm.press("slider", 1.0)


def test_the_light_is_on_the_digital_outputs(rig: Rig) -> None:
    for shown, bits in (("industrial", 0b100), ("hold", 0b111), ("off", 0)):
        order = T.LightCommand("sup", WallClock().now() + 5.0, shown)
        assert rig.client.call(rig.keys.light_command, order, T.Reply).accepted
        until(lambda want=bits: rig.arm.press("state")["digital_out"] & 7 == want)


def test_the_gripper_closes_and_opens(rig: Rig) -> None:
    gripper = rig.client.latest(rig.keys.gripper_state, T.GripperState)
    for width in (0.03, 0.085):
        order = T.GripperCommand("sup", WallClock().now() + 5.0, width, 0.1, 40.0)
        assert rig.client.call(rig.keys.gripper_command, order, T.Reply).accepted
        until(lambda want=width: (s := gripper.peek()) is not None and not s.moving and s.target == want)
        state = gripper.peek()
        assert state is not None and state.width == pytest.approx(width, abs=1e-3)


# -- without the shared node ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def other_arm() -> Iterator[ArmProcess]:
    process = ArmProcess(OTHER_ADDRESS)
    yield process
    process.close()


def test_a_killed_node_leaves_the_arm_at_rest_and_no_program(other_arm: ArmProcess, pictures: str) -> None:
    arm = other_arm
    config = patient(own_port())
    process = _node_process(config, pictures)
    try:
        _drive(config)
        driver = Path("/proc") / str(_driver_of(process.pid)) / "cmdline"
        process.send_signal(signal.SIGKILL)
        process.wait()
        until(lambda: np.abs(arm.press("state")["qd"]).max() < 1e-3, 3.0)
        until(lambda: arm.press("state")["runtime"] == 1, 5.0)
        until(lambda: not driver.exists() or not driver.read_bytes(), 10.0)
    finally:
        process.kill()
        process.wait()


def test_a_frozen_node_is_noticed_by_the_driver(other_arm: ArmProcess, pictures: str) -> None:
    arm = other_arm
    config = patient(own_port())
    process = _node_process(config, pictures)
    try:
        _drive(config)
        process.send_signal(signal.SIGSTOP)
        until(lambda: np.abs(arm.press("state")["qd"]).max() < 1e-3, 3.0)
        at = arm.press("state")["q"]
        process.send_signal(signal.SIGCONT)
        pause(0.5)
        assert arm.press("state")["q"] == pytest.approx(at, abs=1e-4)
    finally:
        process.kill()
        process.wait()
    until(lambda: arm.press("state")["runtime"] == 1, 5.0)


def _node_process(config: CellConfig, pictures: str) -> subprocess.Popen[str]:
    options = ["--backend", "ur3e", "--robot-ip", OTHER_ADDRESS, "--cameras", pictures]
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", *options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(json.dumps(to_dict(config)) + "\n")
    process.stdin.flush()
    assert process.stdout.readline() == "ready\n"
    return process


def _drive(config: CellConfig) -> None:
    """Start a motion through the wire and wait until the arm moves."""
    session = Session.connect(config)
    joints = session.latest(session.keys.joint_states, T.JointState)
    joints.wait(5.0)
    heart = Heart(session, "sup", config.supervisor.heartbeat_deadline)
    heart.loop_lives = lambda: None  # type: ignore[method-assign]
    heart._loop_deadline = 1e9
    status = session.latest(session.keys.arm_status, T.ArmStatus)
    until(lambda: (s := status.peek()) is not None and s.lease == "sup")
    newest = joints.peek()
    assert newest is not None
    goal = AWAY if np.abs(newest.q - AWAY).max() > 0.1 else HOME
    order = move(newest.q, goal, 1.5)
    trajectory = T.Trajectory(1, "sup", 0.0, WallClock().now() + 5.0, order.times, order.q, order.qd)
    assert session.call(session.keys.trajectory, trajectory, T.Reply).accepted
    until(lambda: (s := joints.peek()) is not None and np.abs(s.qd).max() > 0.05, 5.0)
    end = threading.Timer(8.0, lambda: (heart.close(), session.close()))
    end.daemon = True
    end.start()


def _driver_of(node: int) -> int:
    """Process id of a node's arm driver."""
    for entry in Path("/proc").iterdir():
        try:
            command = (entry / "cmdline").read_bytes()
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue
        if b"hil.ur3e.driver_process" in command and parent == node:
            return int(entry.name)
    raise AssertionError(f"node {node} has no driver")


def test_a_controller_that_is_not_ready_is_one_line(other_arm: ArmProcess, pictures: str) -> None:
    backend = make_backend("ur3e", own_port(), robot_ip=OTHER_ADDRESS, cameras=pictures)
    other_arm.press("protective_stop")
    try:
        with pytest.raises(BackendError, match=r"PROTECTIVE_STOP; clear it with: cell recover"):
            backend.connect()
    finally:
        recovered(OTHER_ADDRESS)
    other_arm.press("local", True)
    try:
        with pytest.raises(BackendError, match=r"not in remote control; on the pendant"):
            backend.connect()
        run = cell("recover", "--robot-ip", OTHER_ADDRESS)
        assert run.returncode == 1 and "not in remote control" in run.stdout
        rows = {name: problem or note for name, problem, note in look(OTHER_ADDRESS)}
        assert "not in remote control" in rows["remote"] and rows["port 63352"] == "gripper URCap answers"
    finally:
        other_arm.press("local", False)


def test_surroundings_that_are_not_there_are_one_line(other_arm: ArmProcess) -> None:
    with pytest.raises(CellError, match="no simulated surroundings"):
        make_backend("ur3e", own_port(), robot_ip=OTHER_ADDRESS, cameras="sim").connect()
