"""The register protocol of ur-rtde's control script, against a client that keeps to it."""

from __future__ import annotations

import time

import numpy as np
import pytest

from cell.errors import BackendError
from hil.emulator.interfaces import PERIOD
from hil.emulator.kinematics import error
from hil.emulator.poses import frame_of, pose_trans
from hil.emulator.programs import recognise
from hil.emulator.urscript.rtde_control import RtdeControl
from tests.emulator.fake_robot import HOME, FakeRobot

MOVEJ, MOVEL, SERVOJ, SPEEDJ, PATH, STOPJ = 1, 3, 11, 9, 45, 34
TOOL = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]


def script(offset: int = 0, path: str = "") -> str:
    return (
        "def rtde_control():\n# HEADER_BEGIN\n"
        f"    global reg_offset_float = # float register offset\n{offset}"
        f"    global reg_offset_int = # int register offset\n{offset}"
        f"    global other = 2\n    def exec_move_path():\n        # inject move path\n{path}    end\n"
        "    while keep_running:\n    end\nend\n"
    )


class Client:
    """Does what `RTDEControlInterface` does with the registers.

    Attributes:
        robot: with the script running.
    """

    def __init__(self, offset: int = 0, path: str = "", robot: FakeRobot | None = None) -> None:
        self.robot, self.offset = robot or FakeRobot(), offset
        self.robot.run(recognise(script(offset, path), "test:1"))

    @property
    def status(self) -> int:
        return self.robot.registers.out_int[self.offset]

    @property
    def answer(self) -> int:
        return self.robot.registers.out_int[1 + self.offset]

    @property
    def operation(self) -> tuple[bool, int, int, int]:
        """Running, progress, operation id, writes."""
        word = self.robot.registers.out_int[2 + self.offset]
        return bool(word >> 15 & 1), word & 0x7FFF, word >> 24 & 0x7F, word >> 16 & 0x7F

    def answers(self, count: int = 6) -> list[float]:
        return self.robot.registers.out_double[self.offset : self.offset + count]

    def write(self, command: int, values: list[float], *ints: int) -> None:
        self.robot.write(values, command, *ints, offset=self.offset)

    def call(self, command: int, *values: float, ints: tuple[int, ...] = ()) -> float:
        """A normal command; the time it took [s]."""
        assert self.robot.until(lambda: self.status == 1, 1.0) < 0.1
        self.write(command, list(values), *ints)
        took = self.robot.until(lambda: self.status == 2 or not self.robot.running)
        self.write(0, [])
        return took

    def stream(self, command: int, *values: float) -> None:
        """A realtime command: nobody waits for its end."""
        self.robot.until(lambda: self.status == 1, 1.0)
        self.write(command, list(values))
        self.robot.tick()


@pytest.mark.parametrize("offset", [0, 24])
def test_a_command_is_carried_out_once_and_acknowledged(offset: int) -> None:
    c = Client(offset)
    c.robot.tick()
    assert c.status == 1 and not c.operation[0]
    took = c.call(MOVEJ, *(HOME + 0.2), 1.0, 2.0, ints=(0,))
    assert took == pytest.approx(0.2 / 1.0 + 0.5, abs=0.3)
    assert np.abs(c.robot.mover.q - HOME - 0.2).max() < 1e-6
    c.write(MOVEJ, [*HOME, 1.0, 2.0], 0)
    c.robot.until(lambda: c.status == 2)
    c.robot.tick(100)  # held by the client: not carried out again
    assert c.status == 2 and not c.robot.mover.moving
    c.write(0, [])
    c.robot.tick(2)
    assert c.status == 1


def test_moves_of_all_kinds_reach_their_targets() -> None:
    c = Client()
    c.robot.tcp = np.array(TOOL)
    k = c.robot.mover.kinematics
    q = HOME + np.array([0.1, 0.1, -0.1, 0.0, 0.1, 0.2])
    pose = k.pose(q.tolist(), TOOL)
    for command, target in ((2, pose), (1, HOME.tolist()), (3, pose), (4, HOME.tolist())):
        c.call(command, *target, 0.3, 1.5, ints=(0,))
        wanted = pose if target is pose else k.pose(HOME.tolist(), TOOL)
        off = error(frame_of(wanted), frame_of(k.pose(c.robot.mover.q.tolist(), TOOL)))
        assert max(abs(v) for v in off) < 1e-8 and c.robot.running


def test_an_operation_that_is_not_waited_for() -> None:
    c = Client()
    c.robot.tick()
    before = c.operation
    assert c.call(MOVEJ, *(HOME + 0.3), 1.0, 2.0, ints=(1,)) <= 2 * PERIOD
    running, progress, number, writes = c.operation
    assert running and progress == 0 and number == before[2] + 1 and writes == before[3] + 1
    c.robot.until(lambda: not c.operation[0])
    assert c.operation[2] == number and np.array_equal(c.robot.mover.q, HOME + 0.3)
    for _ in range(140):  # numbers of operations and writes go round at 127
        c.call(MOVEJ, *(HOME + 0.3), 1.0, 2.0, ints=(1,))
        c.robot.tick(3)
    assert c.operation[2] <= 127 and c.operation[2] == (number + 140) % 128


def test_another_move_takes_over_from_one_that_is_not_waited_for() -> None:
    c = Client()
    c.call(MOVEJ, *(HOME + 1.0), 1.0, 2.0, ints=(1,))
    c.robot.tick(200)
    c.call(MOVEJ, *HOME, 1.0, 2.0, ints=(0,))
    assert not c.operation[0] and np.array_equal(c.robot.mover.q, HOME)
    assert c.robot.acceleration() <= 2.0 + 1e-6


def test_stops_are_the_kind_that_the_script_makes_of_them() -> None:
    """A stop that is waited for is stopj until one was not waited for, whatever was asked."""
    c = Client()
    for command, expected in ((33, 0.25), (34, 0.25)):
        c.call(MOVEJ, *(c.robot.mover.q + 1.0), 0.5, 5.0, ints=(1,))
        c.robot.tick(200)
        assert c.call(command, 2.0, ints=(0,)) == pytest.approx(expected, abs=0.01)
        assert not c.operation[0]
    c.call(MOVEJ, *(c.robot.mover.q + 0.5), 0.5, 5.0, ints=(1,))
    c.robot.tick(200)
    number = c.operation[2]
    assert c.call(STOPJ, 0.5, ints=(1,)) <= 2 * PERIOD
    assert c.operation[0] and c.operation[2] == number + 1
    c.robot.until(lambda: not c.operation[0])
    assert not c.robot.mover.moving
    c.call(MOVEJ, *(c.robot.mover.q - 0.5), 0.5, 5.0, ints=(1,))
    c.robot.tick(200)
    tool_speed = np.linalg.norm(c.robot.mover.tool_velocity(c.robot.measured)[:3])
    took = c.call(STOPJ, 0.5, ints=(0,))
    assert took == pytest.approx(tool_speed / 0.5, rel=0.2)  # now it is stopl


def test_servo_stream_and_stop() -> None:
    c = Client()
    for i in range(400):
        c.stream(SERVOJ, *(HOME + 0.2 * i * PERIOD), 0.5, 0.5, 0.002, 0.03, 300.0)
        assert c.status == 1
    lag = (0.2 * 399 * PERIOD - (c.robot.mover.q - HOME)[0]) / 0.2
    assert lag == pytest.approx(0.0323, abs=0.002)
    c.robot.tick(100)  # the script goes on with the last target
    assert np.abs(c.robot.mover.q - HOME - 0.2 * 399 * PERIOD).max() < 1e-6
    c.write(0, [])
    c.call(16, 10.0)
    assert not c.robot.mover.moving and c.robot.acceleration() < 80.1


def test_servo_to_poses() -> None:
    c = Client()
    pose = np.array(c.robot.mover.pose())
    for i in range(300):
        c.stream(24, *(pose + np.array([0.05 * i * PERIOD, 0, 0, 0, 0, 0])), 0.5, 0.5, 0.002, 0.05, 500.0)
    assert c.robot.mover.pose()[0] - pose[0] == pytest.approx(0.05 * (0.598 - 0.052), abs=3e-4)
    c.write(0, [])
    c.call(16, 5.0)
    assert c.robot.running


def test_speeds_and_their_stop() -> None:
    c = Client()
    c.stream(SPEEDJ, 0.4, 0, 0, 0, 0, 0, 2.0, 0.0)
    c.robot.tick(300)
    assert c.robot.mover.qd[0] == pytest.approx(0.4)
    c.write(0, [])
    assert c.call(15, 4.0) == pytest.approx(0.1, abs=0.01)
    c.stream(10, 0.0, 0.0, 0.05, 0, 0, 0, 1.0, 0.1)
    c.robot.tick(200)
    assert c.robot.mover.tool_velocity(c.robot.measured)[2] == pytest.approx(0.05, abs=1e-4)
    c.write(0, [])
    c.call(15, 1.0)
    assert not c.robot.mover.moving


def test_a_speed_is_kept_for_its_time_before_the_next_is_read() -> None:
    c = Client()
    c.stream(SPEEDJ, 0.2, 0, 0, 0, 0, 0, 10.0, 0.5)
    c.robot.tick(100)
    c.stream(SPEEDJ, 0.0, 0, 0, 0, 0, 0, 10.0, 0.5)
    c.robot.tick(100)
    assert c.robot.mover.qd[0] == pytest.approx(0.2)
    c.robot.tick(100)
    assert c.robot.mover.qd[0] == 0.0


PATH_TEXT = (
    "\tsignal_async_progress(0)\n\tmovej([-1.44,-1.83,-2.28,-0.59,1.6,0.023],a=3,v=1,r=0.02)\n"
    "\tsignal_async_progress(1)\n\tmovej([-1.44,-1.73,-2.28,-0.59,1.6,0.023],a=3,v=1,r=0)\n"
    "\tsignal_async_progress(2)\n\tmovel([-1.44,-1.63,-2.28,-0.59,1.6,0.023],a=1.4,v=0.3,r=0)\n"
)


@pytest.mark.parametrize("waited_for", [True, False])
def test_an_injected_path_signals_its_waypoints(waited_for: bool) -> None:
    c = Client(path=PATH_TEXT)
    c.robot.tick()
    c.write(PATH, [], int(not waited_for))
    seen = []
    for _ in range(3000):
        c.robot.tick()
        if not seen or seen[-1] != c.operation[:2]:
            seen.append(c.operation[:2])
        if c.status == 2:
            c.write(0, [])
            if waited_for:
                break
        if seen[-1] == (False, 0) and len(seen) > 2:
            break
    expected = [(True, 0), (True, 1), (True, 2)]
    # As in the script, a path that is waited for never says that it is finished.
    assert seen == (expected if waited_for else [*expected, (False, 0)])
    assert np.abs(c.robot.mover.q - [-1.44, -1.63, -2.28, -0.59, 1.6, 0.023]).max() < 1e-9


def test_questions() -> None:
    c = Client()
    r = c.robot
    r.tcp = np.array(TOOL)
    k, q = r.mover.kinematics, HOME.tolist()
    other = (HOME + 0.1).tolist()
    c.call(43)
    assert c.answers() == pytest.approx(k.pose(q, TOOL))
    c.call(44, *other, *TOOL)
    assert c.answers() == pytest.approx(k.pose(other, TOOL))
    c.call(44, *q)  # what was in the other registers still counts
    assert c.answers() == pytest.approx(k.pose(q, TOOL))
    c.call(46, *k.pose(other, TOOL))
    assert c.answers() == pytest.approx(other, abs=1e-8)
    c.call(30, *k.pose(other, TOOL), *other, 1e-10, 1e-10)
    assert c.answers() == pytest.approx(other, abs=1e-8)
    c.call(39, *TOOL, *k.pose(q, TOOL))
    assert c.answers() == pytest.approx(pose_trans(TOOL, k.pose(q, TOOL)))
    c.call(40)
    assert c.answers() == TOOL
    for command, values, expected in (
        (47, [], 1), (60, k.pose(q, TOOL), 1), (60, [2.0] * 6, 0), (61, [*k.pose(q, TOOL), *q, 0, 0], 1),
        (36, [2.0] * 6, 0), (37, q, 1), (37, [7.0] * 6, 0), (54, [], 0), (64, [], 0), (60, [np.nan] * 6, 0),
    ):  # fmt: skip
        c.call(command, *values)
        assert c.answer == expected, command
    c.stream(26)
    assert c.answers(1) == [PERIOD]
    c.stream(58)
    assert c.answers() == pytest.approx(k.pose(q, [0.0] * 6))
    c.stream(27)
    assert c.answers() == pytest.approx(q)
    c.write(0, [])
    c.call(28)
    assert c.answers() == pytest.approx(k.pose(q, TOOL))


def test_settings() -> None:
    c = Client()
    r = c.robot
    c.call(29, *TOOL)
    c.call(17, 1.5, 0.01, 0.02, 0.03)
    c.call(17, 1.2, 0.0, 0.0, 0.0)
    c.call(59, 0.0, 1.0, 9.0)
    c.call(20, 0.5)
    c.call(21, 1.5)
    assert r.tcp.tolist() == TOOL and r.payload == 1.2 and r.cog.tolist() == [0.01, 0.02, 0.03]
    assert r.gravity.tolist() == [0.0, 1.0, 9.0]
    assert (r.mover.force.damping, r.mover.force.gain) == (0.5, 1.5)


@pytest.mark.parametrize("command", [55, 67, 99, 200])
def test_commands_that_the_script_does_not_know_count_as_done(command: int) -> None:
    c = Client()
    if command == 67:
        c.stream(command)
        assert c.status == 1
    else:
        c.call(command)
    assert c.robot.running


def test_force_mode_and_freedrive() -> None:
    c = Client()
    z = c.robot.mover.pose()[2]
    c.write(6, [*[0.0] * 6, 0, 0, -10, 0, 0, 0, *[0.1] * 6], 2, 0, 0, 1, 0, 0, 0)
    c.robot.tick(200)
    assert c.robot.mover.pose()[2] < z - 1e-3
    c.write(0, [])
    c.call(7)
    assert not c.robot.mover.moving
    c.call(52, *[0.0] * 6, ints=(1, 1, 1, 0, 0, 0))
    c.robot.wrench = lambda: np.array([0, 0, 20.0, 0, 0, 0])
    z = c.robot.mover.pose()[2]
    c.robot.tick(200)
    assert c.robot.mover.pose()[2] > z + 1e-3
    c.call(53)
    c.robot.rest(1.0)


def test_jog_in_the_tool_frame() -> None:
    c = Client()
    r = c.robot
    tool = frame_of(r.mover.kinematics.pose(HOME.tolist(), [0.0] * 6))
    c.call(41, 0, 0, 0.03, 0, 0, 0, 1.0, 0.5, *[0.0] * 6)
    r.tick(200)
    assert r.mover.tool_velocity(r.measured)[:3] == pytest.approx([0.03 * v for v in tool[3]], abs=1e-4)
    c.call(42)
    assert not r.mover.moving


def test_move_until_contact_comes_back_to_the_contact() -> None:
    c = Client()
    r = c.robot
    floor = r.mover.pose()[2] - 0.05

    def wrench() -> np.ndarray:
        return np.array([0, 0, 2e4 * max(0.0, floor - r.mover.pose()[2]), 0, 0, 0])

    r.wrench = wrench
    c.call(51, 0, 0, -0.05, 0, 0, 0, 0, 0, -1, 0, 0, 0, 0.5)
    assert r.mover.pose()[2] == pytest.approx(floor, abs=3e-4) and not r.mover.moving


def test_contact_detection_stops_a_move() -> None:
    c = Client()
    r = c.robot
    r.wrench = lambda: np.array([0, 0, -20.0 if r.now > 0.5 else 0.0, 0, 0, 0])
    c.call(62, 0, 0, 1, 0, 0, 0)
    c.call(MOVEJ, *(HOME + np.array([1.0, 0, 0, 0, 0, 0])), 1.0, 2.0, ints=(1,))
    r.until(lambda: not c.operation[0], 5.0)
    r.tick(1500)
    assert not r.mover.moving and r.mover.q[0] - HOME[0] == pytest.approx(0.25, abs=0.01)
    c.call(63)
    assert c.answer > 0


def test_a_watchdog_ends_the_script_unless_the_register_is_written() -> None:
    c = Client()
    c.call(35, 10.0)
    for _ in range(20):
        c.robot.tick(40)
        c.write(0, [])
    assert c.robot.running
    c.robot.tick(60)
    assert not c.robot.running and any("watchdog" in text for text in c.robot.said)


def test_the_end_by_command_and_by_protective_stop() -> None:
    c = Client()
    c.call(MOVEJ, *(HOME + 1.0), 1.0, 2.0, ints=(1,))
    c.robot.tick(200)
    c.call(255)
    assert not c.robot.running
    c.robot.rest(0.5)
    c = Client()
    c.call(31)
    assert not c.robot.running and c.robot.stops
    c = Client()
    c.call(MOVEL, 2.0, 2.0, 2.0, 0, 0, 0, 0.1, 1.0, ints=(0,))
    assert "out of reach" in c.robot.stops[0]


def test_the_script_is_recognised_with_its_offsets_and_path() -> None:
    program = recognise(script(24, PATH_TEXT), "test:1")
    assert isinstance(program, RtdeControl) and program.upload.first_int == 24
    assert [progress for progress, _ in program.upload.path] == [0, 1, 2]
    with pytest.raises(BackendError, match="register offset of 0 or 24"):
        recognise("def rtde_control():\n  foo()\nend\n", "test:1")
    with pytest.raises(BackendError, match=r"set_digital_out.* is no movej"):
        recognise(script(0, "set_digital_out(1, True)\n"), "test:1")


def test_a_cycle_is_cheap() -> None:
    c = Client()
    for command in (0, SERVOJ, 24, SPEEDJ, 10):
        target = c.robot.mover.pose() if command == 24 else HOME if command == SERVOJ else np.zeros(6)
        costs = []
        for _ in range(100):
            c.write(command, [*target, 0.5, 0.5, 0.002, 0.03, 300.0])
            begin = time.perf_counter()
            assert c.robot.program is not None and c.robot.program.tick(c.robot)
            c.robot.mover.tick(1.0, c.robot.measured)
            costs.append(time.perf_counter() - begin)
        assert sorted(costs)[10] < 0.3e-3
