"""Unmodified ur-rtde against the emulated controller: all of its interfaces, and the way out of a stop."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from cell.clock import WallClock
from hil.emulator.models import UR3E
from tests.emulator.ideal import HOME
from tests.emulator.rig import LATEST
from tests.emulator.serve import UNLOCK_AFTER, served

pytest.importorskip("rtde_control")
pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs an address of its own on the loopback")
ADDRESS = f"127.0.{os.getpid() // 250 % 250 + 1}.{os.getpid() % 250 + 1}"
"""The library's ports are built in, so every run of the tests takes another address."""


@pytest.fixture(scope="module")
def process() -> Iterator[subprocess.Popen[str]]:
    with served(ADDRESS) as running:
        yield running


@pytest.fixture(scope="module")
def receive(process: object) -> Iterator[Any]:
    from rtde_receive import RTDEReceiveInterface

    interface = RTDEReceiveInterface(ADDRESS)
    yield interface
    interface.disconnect()


@pytest.fixture(scope="module")
def control(receive: object) -> Iterator[Any]:
    from rtde_control import RTDEControlInterface

    interface = RTDEControlInterface(ADDRESS)
    yield interface
    interface.stopScript()
    interface.disconnect()


@pytest.fixture
def dashboard(process: object) -> Iterator[Any]:
    from dashboard_client import DashboardClient

    client = DashboardClient(ADDRESS)
    client.connect()
    yield client
    client.disconnect()


def eventually(condition: Callable[[], bool]) -> None:
    clock = WallClock()
    end = clock.now() + LATEST
    while not condition():
        assert clock.now() < end, "it did not happen"
        clock.sleep_until(clock.now() + 0.005)


def pause(seconds: float) -> None:
    clock = WallClock()
    clock.sleep_until(clock.now() + seconds)


def test_receive(receive: Any) -> None:
    assert receive.isConnected()
    assert receive.getActualQ() == pytest.approx(HOME.tolist())
    assert (receive.getRobotMode(), receive.getSafetyMode(), receive.getRuntimeState()) == (7, 1, 1)
    assert (receive.getRobotStatus(), receive.getSafetyStatusBits()) == (1, 1)
    assert not receive.isProtectiveStopped() and not receive.isEmergencyStopped()
    assert np.linalg.norm(receive.getActualTCPPose()[:3]) < 0.7
    assert receive.getSpeedScalingCombined() == 1.0
    assert receive.getPayload() == 0.0 and receive.getJointMode() == [253] * 6
    first = receive.getTimestamp()
    eventually(lambda: receive.getTimestamp() > first + 0.1)


def test_outputs_and_registers(receive: Any) -> None:
    from rtde_io import RTDEIOInterface

    io = RTDEIOInterface(ADDRESS)
    assert io.setStandardDigitalOut(3, True)
    assert io.setConfigurableDigitalOut(2, True)
    assert io.setToolDigitalOut(1, True)
    eventually(lambda: receive.getActualDigitalOutputBits() == 1 << 3 | 1 << 10 | 1 << 17)
    assert io.setStandardDigitalOut(3, False)
    eventually(lambda: receive.getActualDigitalOutputBits() == 1 << 10 | 1 << 17)
    assert io.setAnalogOutputVoltage(0, 0.5)
    eventually(lambda: receive.getStandardAnalogOutput0() == pytest.approx(5.0))
    assert io.setSpeedSlider(0.5)
    eventually(lambda: receive.getTargetSpeedFraction() == 0.5)
    assert io.setSpeedSlider(1.0)
    eventually(lambda: receive.getSpeedScalingCombined() == pytest.approx(1.0))
    assert io.setInputIntRegister(20, 5) and io.setInputDoubleRegister(20, 0.5)
    io.disconnect()
    again = RTDEIOInterface(ADDRESS)  # its inputs were free again
    assert again.setStandardDigitalOut(0, False)
    again.disconnect()


def test_dashboard(dashboard: Any) -> None:
    assert dashboard.isConnected()
    assert dashboard.robotmode() == "Robotmode: RUNNING"
    assert dashboard.safetymode() == "Safetymode: NORMAL"
    assert dashboard.polyscopeVersion().startswith("5.22")
    assert dashboard.getSerialNumber() == UR3E.serial
    assert dashboard.getRobotModel() == "UR3"
    assert dashboard.isInRemoteControl() and not dashboard.running()
    dashboard.popup("Mind the gap")
    dashboard.closePopup()


def test_control_moves_the_arm(control: Any, receive: Any) -> None:
    assert control.isProgramRunning()
    goal = HOME + np.array([0.2, 0.1, 0, 0, 0, 0.2])
    assert control.moveJ(goal.tolist(), 3.0, 20.0)
    eventually(lambda: receive.getActualQ() == pytest.approx(goal.tolist(), abs=1e-6))
    pose = receive.getActualTCPPose()
    assert control.getForwardKinematics() == pytest.approx(pose, abs=1e-6)
    pose[2] += 0.05
    assert control.moveL(pose, 0.5, 3.0)
    eventually(lambda: receive.getActualTCPPose()[:3] == pytest.approx(pose[:3], abs=1e-5))


def test_set_points_are_followed(control: Any, receive: Any) -> None:
    start = receive.getActualQ()
    for step in range(1, 101):
        begun = control.initPeriod()
        goal = [*start[:5], start[5] + 0.002 * step]
        assert control.servoJ(goal, 0.0, 0.0, 0.002, 0.03, 2000)
        control.waitPeriod(begun)
    eventually(lambda: receive.getActualQ()[5] == pytest.approx(goal[5], abs=2e-3))
    assert control.servoStop()


def test_the_way_out_of_a_protective_stop(
    process: subprocess.Popen[str], control: Any, receive: Any, dashboard: Any
) -> None:
    assert process.stdin is not None
    process.stdin.write("stop\n")
    process.stdin.flush()
    eventually(receive.isProtectiveStopped)
    assert not control.moveJ(HOME.tolist(), 1.0, 1.0)
    pause(UNLOCK_AFTER + 0.2)
    dashboard.unlockProtectiveStop()
    eventually(lambda: receive.getSafetyMode() == 1)
    assert not control.isProgramRunning()
    assert control.reuploadScript()
    eventually(control.isProgramRunning)
    assert control.moveJ(HOME.tolist(), 3.0, 20.0)
