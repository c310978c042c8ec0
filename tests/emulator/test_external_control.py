"""The external control program against a client with three listening sockets."""

from __future__ import annotations

import array
import fcntl
import select
import socket
import struct
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest

from cell.clock import WallClock
from cell.errors import BackendError
from hil.emulator.interfaces import PERIOD
from hil.emulator.poses import frame_of, pose_of
from hil.emulator.programs import recognise
from hil.emulator.urscript.external_control import ExternalControl
from hil.emulator.urscript.external_state import Mode, Session
from tests.emulator.fake_robot import HOME, FakeRobot
from tests.emulator.rig import eventually

SUCCESS, CANCELED, FAILURE = 0, 1, 2


def text(reverse: int, trajectory: int, command: int, host: str = "127.0.0.1", more: str = "") -> str:
    """What is read of the client's script."""
    return (
        f"{more}\tsteptime = get_steptime()\n\tREVERSE_INTERFACE_DATA_DIMENSION = 8\n"
        "\tTRAJECTORY_DATA_DIMENSION = 3 * 6 + 1\n\tSCRIPT_COMMAND_DATA_DIMENSION = 28\n"
        "\tservoj(q, t=steptime, lookahead_time=0.03, gain=2000)\n"
        f'\ttraj_flag = connect_socket_with_retry("{host}", {trajectory}, "trajectory_socket")\n'
        f'\tcom_flag = connect_socket_with_retry("{host}", {command}, "script_command_socket")\n'
        f'\trev_flag = connect_socket_with_retry("{host}", {reverse}, "reverse_socket")\n'
        "# NODE_CONTROL_LOOP_ENDS\n"
    )


class Client:
    """Three servers and what is said over them.

    Attributes:
        robot: with the program running, connected.
    """

    def __init__(self, headless: bool = True) -> None:
        self._servers = [socket.create_server(("127.0.0.1", 0)) for _ in range(4)]
        self.ports = [s.getsockname()[1] for s in self._servers]
        self.robot = FakeRobot()
        script = text(*self.ports[:3], more="\tset_tool_voltage(24)\n")
        if headless:
            self.robot.run(recognise(f"stop program\ndef externalControl():\n{script}end\n", ""))
        else:
            self.robot.run(recognise(f'external_control("127.0.0.1", {self.ports[3]})', ""))
            self.real(lambda: select.select([self._servers[3]], [], [], 0)[0])
            self.robot.tick()
            sender, _ = self._servers[3].accept()
            assert sender.recv(100) == b"request_program\n"
            sender.sendall(script.encode())  # takes real time
            self._sender = sender
        self.real(lambda: any("External control active" in line for line in self.robot.said))
        self.reverse, self.trajectory, self.command = (s.accept()[0] for s in self._servers[:3])
        for s in (self.reverse, self.trajectory, self.command):
            s.settimeout(5.0)

    def close(self) -> None:
        for s in (*self._servers, self.reverse, self.trajectory, self.command):
            s.close()

    def real(self, condition: object, limit: float = 10.0) -> None:
        """Cycle while real time passes, until something that depends on sockets is true."""
        clock = WallClock()
        end = clock.now() + limit
        while not condition():  # type: ignore[operator]
            self.robot.tick()
            assert clock.now() < end, f"it did not happen; said {self.robot.said[-3:]}"

    def send(
        self, mode: int, values: list[float] | None = None, timeout: int = 200, raw: tuple[int, ...] = ()
    ) -> None:
        scaled = [round(v * 1e6) for v in values or [0.0] * 6]
        fields = [*raw, *[0] * (6 - len(raw))] if raw else scaled
        self._deliver("reverse", struct.pack(">8i", timeout, *fields, mode))

    def point(
        self, kind: int, first: list[float], second: list[float] | None = None,
        third: list[float] | None = None, time: float = 0.0, last: float = 0.0,
    ) -> None:  # fmt: skip
        numbers = [*first, *(second or [0.0] * 6), *(third or [0.0] * 6)]
        variant = round(last) if kind == 51 else round(last * 1e6)
        values = [round(v * 1e6) for v in numbers]
        self._deliver("trajectory", struct.pack(">21i", *values, round(time * 1e6), variant, kind))

    def order(self, command: int, *values: float) -> None:
        scaled = [round(v * 1e6) for v in values]
        self._deliver("command", struct.pack(">28i", command, *scaled, *[0] * (27 - len(scaled))))
        self.robot.tick(2)

    def _deliver(self, role: str, data: bytes) -> None:
        """Send, and wait until it lies at the program's end: cycles here are faster than real ones."""
        link = getattr(self._session, role)
        before = _waiting(link._sock)
        getattr(self, role).sendall(data)
        eventually(lambda: _waiting(link._sock) >= before + len(data))

    @property
    def _session(self) -> Session:
        program: Any = self.robot.program
        session: Session = getattr(program, "_program", program)._session
        return session

    def result(self, sock: socket.socket | None = None, keep: bool = True) -> int:
        """The next answer on the trajectory or another socket, kept alive meanwhile."""
        sock = sock or self.trajectory
        sock.setblocking(False)
        data = b""

        def there() -> bool:
            nonlocal data
            if keep and len(self.robot.q) % 20 == 0:
                self.send(Mode.FORWARD)
            with suppress(BlockingIOError):
                data += sock.recv(4 - len(data))
            return len(data) == 4

        self.real(there, 20.0)
        (value,) = struct.unpack(">i", data)
        return int(value)


def _waiting(sock: socket.socket) -> int:
    """Bytes that can be read."""
    count = array.array("i", [0])
    fcntl.ioctl(sock, termios.FIONREAD, count)
    return count[0]


@contextmanager
def client(headless: bool = True) -> Iterator[Client]:
    c = Client(headless)
    try:
        yield c
    finally:
        c.robot.end()
        c.close()


@pytest.mark.parametrize("headless", [True, False])
def test_it_connects_back_and_ends_when_it_is_told(headless: bool) -> None:
    with client(headless) as c:
        assert c.robot.io.tool_voltage == 24
        c.send(Mode.IDLE)
        c.robot.tick(5)
        assert c.robot.running
        c.send(Mode.STOPPED)
        c.real(lambda: not c.robot.running)
        assert c.reverse.recv(1) == b""


def test_silence_longer_than_the_time_out_ends_it_with_a_stop() -> None:
    with client() as c:
        c.robot.tick(500)  # the first message is waited for without limit
        assert c.robot.running
        c.send(Mode.SPEEDJ, [0.3, 0, 0, 0, 0, 0], timeout=100)
        c.robot.tick(45)
        assert c.robot.running and c.robot.mover.qd[0] == pytest.approx(0.3)
        c.robot.tick(10)
        assert any("timed out" in line for line in c.robot.said)
        c.robot.until(lambda: not c.robot.running, 1.0)
        assert not c.robot.mover.qd.any() and c.robot.acceleration() <= 40.0 * 1.001


def test_a_time_out_of_0_waits_for_ever_and_a_lost_connection_ends_it() -> None:
    with client() as c:
        c.send(Mode.IDLE, timeout=0)
        c.robot.tick(3000)
        assert c.robot.running
        c.reverse.close()
        c.real(lambda: not c.robot.running)


def test_a_client_that_writes_without_a_pause_does_not_hold_up_the_controller() -> None:
    with client() as c:
        keepalive = struct.pack(">8i", 200, *[0] * 6, Mode.IDLE)
        c._deliver("reverse", keepalive * 1000 + struct.pack(">8i", 200, *[0] * 6, Mode.STOPPED))
        c.robot.tick(5)
        assert c.robot.running  # most of it is still to be read
        c.robot.until(lambda: not c.robot.running, 0.1)


def test_servoing_follows_and_goes_on_through_a_gap() -> None:
    with client() as c:
        v = np.array([0.3, 0, 0, 0, 0, 0.2])
        for i in range(300):
            if i not in (150, 151):
                c.send(Mode.SERVOJ, (HOME + v * (i + 1) * PERIOD).tolist())
            c.robot.tick()
        lag = (0.3 * 300 * PERIOD - (c.robot.mover.q - HOME)[0]) / 0.3
        assert lag == pytest.approx(0.0305, abs=0.002)
        speeds = np.array(c.robot.qd)[120:300, 0]
        assert speeds.min() > 0.28 and speeds.max() < 0.32
        c.send(Mode.IDLE)
        c.robot.tick(100)
        assert not c.robot.mover.moving and c.robot.running


def test_pose_servoing_and_speeds() -> None:
    with client() as c:
        start = c.robot.mover.pose()
        for i in range(200):
            c.send(Mode.POSE, [start[0] + 0.05 * i * PERIOD, *start[1:]])
            c.robot.tick()
        assert c.robot.mover.pose()[0] - start[0] == pytest.approx(0.05 * (0.4 - 0.033), abs=3e-4)
        c.send(Mode.SPEEDL, [0.0, 0.0, 0.04, 0, 0, 0])
        c.robot.tick(90)  # stops before it changes mode
        assert c.robot.mover.tool_velocity(c.robot.measured)[2] == pytest.approx(0.04, abs=1e-3)
        c.send(Mode.SPEEDJ, [0, 0, 0, 0, 0, 0.5])
        c.robot.tick(90)
        assert c.robot.mover.qd[5] == pytest.approx(0.5)


def test_a_target_too_far_for_a_cycle_is_not_heeded() -> None:
    with client() as c:
        c.send(Mode.SERVOJ, HOME.tolist())
        c.robot.tick(5)
        c.send(Mode.SERVOJ, (HOME + 0.5).tolist())
        c.robot.tick(60)
        assert np.abs(c.robot.mover.q - HOME).max() < 1e-6
        assert sum("Ignoring commands" in line for line in c.robot.said) == 1


def test_a_trajectory_of_moves() -> None:
    with client() as c:
        q1 = HOME + np.array([0.2, 0, 0, 0, 0, 0])
        q2 = HOME + np.array([0.2, 0.2, 0, 0, 0, 0])
        pose = c.robot.mover.kinematics.pose(HOME.tolist(), [0.0] * 6)
        c.send(Mode.FORWARD, raw=(1, 3))
        c.point(0, q1.tolist(), third=[1.0, 4.0, 0, 0, 0, 0], last=0.02)
        c.point(0, q2.tolist(), third=[1.0, 4.0, 0, 0, 0, 0])
        c.point(1, pose, third=[0.4, 2.0, 0, 0, 0, 0])
        assert c.result() == SUCCESS
        assert np.abs(c.robot.mover.q - HOME).max() < 1e-5  # micrometres on the wire
        passed = np.abs(np.array(c.robot.q) - q1).max(axis=1).min()
        assert 1e-3 < passed < 0.05  # the corner was rounded
        c.send(Mode.FORWARD, raw=(1, 1))
        c.point(6, pose, second=HOME.tolist(), third=[1, 1, 1, 0, 0, 0], time=0.8)
        assert c.result() == SUCCESS
        c.send(Mode.FORWARD, raw=(1, 2))
        c.point(4, q1.tolist(), third=[0.5, 0.5, 0, 0, 0, 0], last=0.01)
        c.point(12, pose, second=HOME.tolist(), third=[0.5, 0.5, 1, 0, 0, 0])
        assert c.result() == SUCCESS
        assert np.abs(c.robot.mover.q - HOME).max() < 1e-5


@pytest.mark.parametrize("kind", [1, 2])
def test_a_trajectory_of_splines_passes_its_points(kind: int) -> None:
    with client() as c:
        times = np.arange(1, 11) * 0.1
        smooth = 0.3 * (1 - np.cos(np.pi * times)) / 2
        speed = 0.3 * np.pi * np.sin(np.pi * times) / 2
        bend = 0.3 * np.pi**2 * np.cos(np.pi * times) / 2
        c.send(Mode.FORWARD, raw=(1, 10))
        for s, v, a in zip(smooth, speed, bend, strict=True):
            c.point(51, (HOME + s).tolist(), [v] * 6, [a] * 6, 0.1, kind)
        assert c.result() == SUCCESS
        assert np.abs(c.robot.mover.q - HOME - 0.3).max() < 1e-6
        moving = [i for i, qd in enumerate(c.robot.qd) if qd.any()]
        assert len(moving) * PERIOD == pytest.approx(1.0, abs=0.01)
        assert c.robot.acceleration() < 6.0 and c.robot.slip() < 1e-5


@pytest.mark.parametrize(("kind", "via_pose", "pose"), [(3, 1, 1), (9, 0, 0), (10, 1, 0), (11, 0, 1)])
def test_arcs_take_joints_and_poses(kind: int, via_pose: int, pose: int) -> None:
    with client() as c:
        k, start = c.robot.mover.kinematics, np.array(c.robot.mover.pose())
        poses = [(start + np.array(d)).tolist() for d in ([0.03, 0, 0.03, 0, 0, 0], [0.06, 0, 0, 0, 0, 0])]
        joints = [k.ik(p, [0.0] * 6, HOME) for p in poses]
        via, end = (
            p if as_pose else q for p, q, as_pose in zip(poses, joints, (via_pose, pose), strict=True)
        )
        assert via is not None and end is not None
        c.send(Mode.FORWARD, raw=(1, 1))
        c.point(kind, end, via, [0.2, 1.0, 0, 0, 0, 0])
        assert c.result() == SUCCESS
        p = np.array([k.pose(q.tolist(), [0.0] * 6)[:3] for q in c.robot.q])
        away = np.linalg.norm(p - (start[:3] + np.array([0.03, 0, 0])), axis=1)
        assert np.abs(away - 0.03).max() < 1e-5
        assert np.abs(p[-1] - poses[1][:3]).max() < 1e-5


def test_a_streamed_trajectory_ends_by_announcement() -> None:
    with client() as c:
        c.send(Mode.FORWARD, raw=(2, 0))
        for k in range(1, 6):
            v = 0.5 if k < 5 else 0.0
            c.point(51, (HOME + 0.05 * k).tolist(), [v] * 6, None, 0.1, 1)
        c.robot.tick(100)
        c.send(Mode.FORWARD, raw=(3, 5))
        assert c.result() == SUCCESS
        assert np.abs(c.robot.mover.q - HOME - 0.25).max() < 1e-6


def test_cancelling_missing_points_and_what_cannot_be() -> None:
    with client() as c:
        far = (HOME + 1.0).tolist()
        c.send(Mode.FORWARD, raw=(1, 3))
        for _ in range(3):
            c.point(0, far, third=[1, 2, 0, 0, 0, 0])
        c.robot.tick(80)
        c.send(Mode.FORWARD, raw=(-1,))
        assert c.result() == CANCELED and not c.robot.mover.moving
        c.send(Mode.FORWARD, raw=(1, 2))
        c.point(0, (c.robot.mover.q + 0.1).tolist(), third=[1, 5, 0, 0, 0, 0])
        assert c.result() == FAILURE
        c.send(Mode.FORWARD, raw=(1, 1))
        c.point(20, far, third=[1, 1, 0, 0, 0, 0])
        assert c.result() == FAILURE and any("type 20" in line for line in c.robot.said)
        c.send(Mode.FORWARD, raw=(1, 1))
        c.point(51, far, None, None, 0.001, 1)
        assert c.result() == CANCELED
        c.send(Mode.FORWARD, raw=(1, 2))
        for _ in range(2):
            c.point(0, HOME.tolist(), third=[1, 5, 0, 0, 0, 0])
        c.robot.tick(50)
        c.send(Mode.IDLE)  # leaving the mode gives the trajectory up
        assert c.result(keep=False) == CANCELED and c.robot.running


def test_freedrive() -> None:
    with client() as c:
        c.robot.wrench = lambda: np.array([0, 0, 20.0, 0, 0, 0])
        z = c.robot.mover.pose()[2]
        c.send(Mode.FREEDRIVE, raw=(1,), timeout=0)
        c.robot.tick(200)
        assert c.robot.mover.pose()[2] > z + 1e-3
        c.send(Mode.FREEDRIVE, raw=(-1,), timeout=0)
        c.robot.tick(2)
        c.robot.rest(1.0)


def test_script_commands() -> None:
    with client() as c:
        c.order(1, 1.5, 0.01, 0.02, 0.03)
        c.order(2, 12)
        c.order(9, 0.0, 0.0, 9.5)
        c.order(10, 0, 0, 0.1, 0, 0, 0)
        c.real(lambda: c.robot.tcp[2] == 0.1)
        assert c.robot.payload == 1.5 and c.robot.cog.tolist() == [0.01, 0.02, 0.03]
        assert c.robot.io.tool_voltage == 12 and c.robot.gravity.tolist() == [0.0, 0.0, 9.5]
        c.order(77)
        c.order(2, 13)
        c.real(
            lambda: (
                sum("77 is not emulated" in s or "legal values: 0, 12, 24" in s for s in c.robot.said) == 2
            )
        )
        z = c.robot.mover.pose()[2]
        c.order(3, *[0.0] * 6, 0, 0, 1, 0, 0, 0, 0, 0, -10, 0, 0, 0, 2, *[0.1] * 6, 0.025, 1.0)
        c.robot.tick(100)
        assert c.robot.mover.pose()[2] < z - 1e-3 and c.robot.mover.force.gain == 1.0
        c.order(4)
        c.robot.tick(50)
        assert not c.robot.mover.moving and c.robot.running


def test_a_tool_contact_stops_the_motion_and_is_reported() -> None:
    with client() as c:
        c.order(5)
        floor = c.robot.mover.pose()[2] - 0.004
        c.robot.wrench = lambda: np.array([0, 0, 2e4 * max(0.0, floor - c.robot.mover.pose()[2]), 0, 0, 0])
        c.command.setblocking(False)
        for _ in range(450):
            c.send(Mode.SPEEDL, [0, 0, -0.03, 0, 0, 0])
            c.robot.tick()
        c.command.settimeout(5.0)
        assert c.command.recv(4) == struct.pack(">i", 0)
        assert c.robot.mover.pose()[2] == pytest.approx(floor, abs=3e-4) and not c.robot.mover.moving
        c.order(6)
        c.send(Mode.IDLE)
        c.robot.tick(3)
        c.order(5)
        c.order(6)
        assert c.command.recv(4) == struct.pack(">i", 1)


def test_nobody_listens() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    r = FakeRobot()
    r.run(recognise(text(port, port, port), ""))
    took = r.until(lambda: not r.running, 5.0)
    assert 0.7 < took < 1.0 and any("trajectory_socket. Please check" in line for line in r.said)
    r.run(recognise(f'external_control("127.0.0.1", {port})', ""))
    with pytest.raises(BackendError, match="nobody sends a script"):
        r.tick(10)


@pytest.mark.parametrize(
    ("script", "says"),
    [
        (text(1, 2, 3, host="example.org"), "IPv4 address, got 'example.org'"),
        (text(1, 2, 70000), "port must be 1..65535, got 70000"),
        (text(1, 2, 3).replace("= 28", "= 26"), "SCRIPT_COMMAND_DATA_DIMENSION must be 28, got 26"),
        (text(1, 2, 3).replace('"trajectory_socket"', '"other"'), "opens no trajectory_socket"),
    ],
)
def test_scripts_of_another_make_are_refused(script: str, says: str) -> None:
    with pytest.raises(BackendError, match=says):
        recognise(f"def externalControl():\n{script}end\n", "")


def test_the_program_knows_its_settings() -> None:
    found = recognise(f"def externalControl():\n{text(50001, 50003, 50004)}end\n", "")
    assert isinstance(found, ExternalControl) and found.name == "externalControl"
    s = found.settings
    assert (s.host, s.reverse, s.trajectory, s.command) == ("127.0.0.1", 50001, 50003, 50004)
    assert (s.lookahead, s.gain, s.voltage) == (0.03, 2000.0, None)
    assert pose_of(frame_of([0.0] * 6)) == [0.0] * 6
