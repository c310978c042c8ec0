"""Unmodified ur-rtde 1.6.5 drives the emulated controller: one process here, the controller in another."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from cell.clock import WallClock, perf_s
from hil.emulator.kinematics import Kinematics, error
from hil.emulator.models import UR3E
from hil.emulator.poses import frame_of
from tests.emulator.serve import served

rtde_control = pytest.importorskip("rtde_control", reason="ur-rtde is not installed")
rtde_receive = pytest.importorskip("rtde_receive")
dashboard_client = pytest.importorskip("dashboard_client")

HOST = f"127.0.31.{1 + os.getpid() % 254}"
"""Fixed ports need an address of their own, also beside another run of these tests."""
PATIENCE = 15.0
HOME = [-1.54, -1.83, -2.28, -0.59, 1.6, 0.023]
ARM = Kinematics(UR3E)


class Robot:
    """Control, receive and dashboard interface of one controller."""

    def __init__(self) -> None:
        self.clock = WallClock()
        self.control: Any = None
        self.receive: Any = None
        self.eventually(self._connect)

    def _connect(self) -> bool:
        try:
            self.control = self.control or rtde_control.RTDEControlInterface(HOST, 500.0)
            self.receive = self.receive or rtde_receive.RTDEReceiveInterface(HOST, 500.0)
        except RuntimeError:  # not up yet
            return False
        return True

    def eventually(self, condition: Callable[[], bool]) -> None:
        end = self.clock.now() + PATIENCE
        while not condition():
            assert self.clock.now() < end, "it did not happen"
            self.wait(0.01)

    def wait(self, t: float) -> None:
        self.clock.sleep_until(self.clock.now() + t)

    @property
    def q(self) -> np.ndarray:
        return np.array(self.receive.getActualQ())

    def at(self, q: object) -> bool:
        return bool(np.abs(self.q - np.asarray(q)).max() < 1e-4)

    def off(self, pose: list[float]) -> float:
        return max(abs(v) for v in error(frame_of(pose), frame_of(self.receive.getActualTCPPose())))

    def still(self) -> bool:
        return bool(np.abs(self.receive.getActualQd()).max() < 1e-9)

    def unlock(self) -> None:
        """Lift a protective stop, which the controller refuses to do at once."""
        dashboard = dashboard_client.DashboardClient(HOST)
        dashboard.connect()

        def lifted() -> bool:
            try:
                dashboard.unlockProtectiveStop()
            except RuntimeError as refusal:
                assert "Cannot unlock protective stop" in str(refusal)
                return False
            return True

        self.eventually(lifted)
        self.eventually(lambda: not self.receive.isProtectiveStopped())
        dashboard.disconnect()

    def fresh(self) -> None:
        """Running, at home, nothing left over from the test before."""
        if not self.control.isProgramRunning():
            self.control.reuploadScript()
            self.eventually(self.control.isProgramRunning)
        assert self.control.moveJ(HOME, 3.0, 20.0)
        self.eventually(lambda: self.at(HOME) and self.still())


@pytest.fixture(scope="module")
def shared() -> Iterator[Robot]:
    with served(HOST):
        robot = Robot()
        yield robot
        robot.control.stopScript()
        robot.control.disconnect()
        robot.receive.disconnect()


@pytest.fixture
def robot(shared: Robot) -> Robot:
    shared.fresh()
    return shared


def moved(*change: float) -> list[float]:
    return (np.array(HOME) + np.array([*change, *[0.0] * (6 - len(change))])).tolist()


def test_move_j(robot: Robot) -> None:
    target = moved(0.3, 0.1, -0.2, 0.1, 0.2, 0.3)
    begin = perf_s()
    assert robot.control.moveJ(target, 1.0, 2.0)
    assert perf_s() - begin > 0.3 / 1.0 + 0.4
    robot.eventually(lambda: robot.at(target))
    assert robot.control.moveJ_IK(ARM.pose(HOME, [0.0] * 6), 2.0, 10.0)
    robot.eventually(lambda: robot.at(HOME))


def test_move_l(robot: Robot) -> None:
    pose = robot.receive.getActualTCPPose()
    up = [pose[0], pose[1], pose[2] + 0.05, *pose[3:]]
    assert robot.control.moveL(up, 0.25, 1.2)
    robot.eventually(lambda: robot.off(up) < 1e-5)
    assert robot.control.moveL_FK(HOME, 0.5, 3.0)
    robot.eventually(lambda: robot.at(HOME))


def test_a_servo_stream_is_followed_one_lookahead_time_late(robot: Robot) -> None:
    late = []
    for i in range(300):
        start = robot.control.initPeriod()
        ahead = 0.3 * i * 0.002
        robot.control.servoJ(moved(ahead), 0.5, 0.5, 0.002, 0.03, 300)
        if i > 150:
            late.append((ahead - (robot.q[0] - HOME[0])) / 0.3)
        robot.control.waitPeriod(start)
    assert 0.015 < float(np.median(late)) < 0.3  # 0.032 on a machine with time to spare
    robot.eventually(lambda: robot.at(moved(0.3 * 299 * 0.002)))
    assert robot.control.servoStop(10.0)
    robot.eventually(robot.still)


def test_servo_to_a_pose(robot: Robot) -> None:
    pose = robot.receive.getActualTCPPose()
    for i in range(100):
        start = robot.control.initPeriod()
        robot.control.servoL([pose[0] + i * 1e-4, *pose[1:]], 0.5, 0.5, 0.002, 0.05, 500)
        robot.control.waitPeriod(start)
    robot.eventually(lambda: robot.off([pose[0] + 99e-4, *pose[1:]]) < 1e-5)
    assert robot.control.servoStop(10.0)


def test_speed_j_and_l(robot: Robot) -> None:
    assert robot.control.speedJ([0.3, 0, 0, 0, 0, 0], 2.0, 0.0)
    robot.eventually(lambda: abs(robot.receive.getActualQd()[0] - 0.3) < 1e-9)
    assert robot.control.speedStop(5.0)
    robot.eventually(robot.still)
    assert robot.control.speedL([0, 0, 0.05, 0, 0, 0], 1.0, 0.0)
    robot.eventually(lambda: abs(robot.receive.getActualTCPSpeed()[2] - 0.05) < 1e-3)
    assert robot.control.speedStop(1.0)
    robot.eventually(robot.still)


def test_moves_that_are_not_waited_for(robot: Robot) -> None:
    control = robot.control
    assert control.moveJ(moved(0.4), 0.8, 4.0, True)
    assert control.getAsyncOperationProgress() >= 0
    assert control.getAsyncOperationProgressEx().isAsyncOperationRunning()
    robot.eventually(lambda: control.getAsyncOperationProgress() < 0)
    robot.eventually(lambda: robot.at(moved(0.4)))
    assert control.moveJ(moved(-0.6), 0.5, 4.0, True)
    robot.wait(0.3)
    control.stopJ(4.0, False)
    robot.eventually(robot.still)
    assert control.getAsyncOperationProgress() < 0
    assert HOME[0] - 0.59 < robot.q[0] < HOME[0] + 0.39
    assert control.moveJ(moved(0.4), 0.5, 4.0, True)
    control.stopJ(4.0, True)
    robot.eventually(lambda: robot.still() and control.getAsyncOperationProgress() < 0)


def test_paths(robot: Robot) -> None:
    control, kind = robot.control, rtde_control.PathEntry
    legs = [[*moved(0.2), 1.0, 4.0, 0.02], [*moved(0.2, 0.2), 1.0, 4.0, 0.0], [*HOME, 1.0, 4.0, 0.0]]
    assert control.moveJ(legs, False)
    robot.eventually(lambda: robot.at(HOME))
    path = rtde_control.Path()
    for leg in legs[:2]:
        path.addEntry(kind(kind.MoveJ, kind.PositionJoints, leg))
    path.addEntry(kind(kind.MoveL, kind.PositionTcpPose, [*ARM.pose(HOME, [0.0] * 6), 0.5, 3.0, 0.0]))
    assert control.movePath(path, True)
    seen: list[int] = []

    def done() -> bool:
        seen.append(control.getAsyncOperationProgress())
        return bool(seen[-1] < 0)

    robot.eventually(done)
    assert {0, 1, 2} <= set(seen)
    robot.eventually(lambda: robot.at(HOME))


def test_kinematics_by_the_controller(robot: Robot) -> None:
    q, tcp = moved(0.1, 0.2), [0.0, 0.0, 0.12, 0.0, 0.0, 0.1]
    assert robot.control.getForwardKinematics(q, tcp) == pytest.approx(ARM.pose(q, tcp), abs=1e-9)
    pose = ARM.pose(q, [0.0] * 6)
    assert robot.control.getInverseKinematics(pose) == pytest.approx(q, abs=1e-7)
    assert robot.control.getInverseKinematics(pose, q) == pytest.approx(q, abs=1e-7)
    assert robot.control.getInverseKinematicsHasSolution(pose)
    assert not robot.control.getInverseKinematicsHasSolution([2.0, 0, 0, 0, 0, 0])
    assert robot.control.isJointsWithinSafetyLimits(q) and not robot.control.isJointsWithinSafetyLimits(
        [9.0] * 6
    )
    assert robot.control.poseTrans([1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0]) == pytest.approx(
        [1, 1, 0, 0, 0, 0]
    )


def test_payload_tool_and_steadiness(robot: Robot) -> None:
    assert robot.control.setTcp([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
    assert robot.control.getTCPOffset() == [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
    robot.eventually(lambda: robot.off(ARM.pose(HOME, [0.0, 0.0, 0.12, 0.0, 0.0, 0.0])) < 1e-6)
    assert robot.control.setTcp([0.0] * 6)
    assert robot.control.setPayload(1.5, [0.0, 0.01, 0.05])
    robot.eventually(lambda: robot.receive.getPayload() == 1.5)
    assert robot.receive.getPayloadCog() == [0.0, 0.01, 0.05]
    robot.eventually(robot.control.isSteady)


def test_a_custom_function(robot: Robot) -> None:
    assert robot.control.sendCustomScriptFunction("lamp", "set_standard_digital_out(3, True)\nsleep(0.02)\n")
    robot.eventually(lambda: robot.receive.getActualDigitalOutputBits() == 1 << 3)


def test_a_watchdog_ends_the_program(robot: Robot) -> None:
    assert robot.control.setWatchdog(2.0)
    for _ in range(10):
        assert robot.control.kickWatchdog()
        robot.wait(0.1)
    assert robot.control.isProgramRunning()
    robot.eventually(lambda: not robot.control.isProgramRunning())


def test_a_protective_stop_and_the_way_back(robot: Robot) -> None:
    assert robot.control.triggerProtectiveStop()
    robot.eventually(robot.receive.isProtectiveStopped)
    assert not robot.control.moveJ(moved(0.2), 1.0, 2.0)
    robot.unlock()
    assert robot.control.reuploadScript()
    robot.eventually(robot.control.isProgramRunning)
    assert robot.control.moveJ(moved(0.2), 1.0, 4.0)
    robot.eventually(lambda: robot.at(moved(0.2)))


def test_an_unreachable_target_is_a_protective_stop(robot: Robot) -> None:
    assert not robot.control.moveL([1.0, 1.0, 1.0, 0.0, 0.0, 0.0], 0.1, 1.0)
    robot.eventually(robot.receive.isProtectiveStopped)
    robot.unlock()


def test_registers_of_the_upper_range(robot: Robot) -> None:
    interface = rtde_control.RTDEControlInterface
    robot.control.stopScript()
    robot.control.disconnect()  # its inputs are free for another client then
    flags = interface.FLAG_UPLOAD_SCRIPT | interface.FLAG_UPPER_RANGE_REGISTERS
    robot.control = interface(HOST, 500.0, flags)
    assert robot.control.moveJ(moved(0.1), 2.0, 10.0)
    robot.eventually(lambda: robot.at(moved(0.1)))
