"""The controller's modes, stops and programs, cycle by cycle and without a network."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hil.emulator.controller import Controller
from hil.emulator.inputs import Inputs
from hil.emulator.interfaces import PERIOD, RobotMode, RuntimeState, SafetyMode
from hil.emulator.models import UR3E, UR5E
from hil.emulator.outputs import Outputs
from hil.emulator.safety import SafetyIo
from hil.rtde.fields import FORMATS, fields
from tests.emulator.ideal import HOME, QUICK, SWEEP, IdealMover, IdealPlant, Sweep, recognise


class Rig:
    """A controller that runs, with the sweeping program if asked for."""

    def __init__(self, safety_io: SafetyIo | None = None, sweep: bool = False, **more: object) -> None:
        self.plant, self.mover = IdealPlant(), IdealMover()
        self.programs: list[Sweep] = []

        def remember(text: str, peer: str) -> Sweep:
            self.programs.append(recognise(text, peer))
            return self.programs[-1]

        self.c = Controller(
            UR3E,
            self.plant,
            self.mover,
            remember,
            durations=QUICK,
            safety_io=safety_io,
            power_up=True,
            **more,  # type: ignore[arg-type]
        )
        self.said: list[tuple[str, int]] = []
        self.c.listeners.append(lambda text, level: self.said.append((text, level)))
        if safety_io is not None:
            for bit in range(8, 16):
                self.c.digital_input(bit, bit != safety_io.reset)
        self.run(0.1)
        if sweep:
            assert self.c.upload(SWEEP, "test")
            self.run(0.3)
            assert self.c.runtime_state is RuntimeState.PLAYING

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.c.tick()

    def until(self, condition: object, most: float = 2.0) -> float:
        start = self.c.now
        while not condition():  # type: ignore[operator]
            assert self.c.now - start < most, "it did not happen"
            self.c.tick()
        return self.c.now - start


def test_power_on_and_brake_release() -> None:
    c = Controller(UR3E, IdealPlant(), IdealMover(), recognise, durations=QUICK)
    seen = [c.robot_mode]

    def run() -> None:
        for _ in range(30):
            c.tick()
            if c.robot_mode is not seen[-1]:
                seen.append(c.robot_mode)

    run()
    assert c.joint_mode == 239 and not c.robot_status_bits & 1
    assert not c.upload(SWEEP, "test")
    assert c.power_on()
    run()
    assert c.brake_release()
    run()
    assert seen == [
        RobotMode.BOOTING,
        RobotMode.POWER_OFF,
        RobotMode.POWER_ON,
        RobotMode.IDLE,
        RobotMode.RUNNING,
    ]
    assert (c.joint_mode, c.robot_status_bits, c.safety_status_bits) == (253, 1, 1)
    c.power_off()
    c.brake_release()
    run()
    assert c.robot_mode is RobotMode.POWER_OFF, "a brake release does not undo a power off under way"
    c.brake_release()
    run()
    assert c.robot_mode is RobotMode.RUNNING, "brake release powers on by itself"


def test_a_program_lives_and_ends() -> None:
    rig = Rig()
    assert rig.c.upload("def short():\nend\n", "test")
    seen = []
    for _ in range(40):
        rig.c.tick()
        seen.append((rig.c.runtime_state, rig.c.robot_status_bits >> 1 & 1))
    assert [state for state, _ in seen if state is RuntimeState.PLAYING]
    assert seen[-1] == (RuntimeState.STOPPED, 0)
    assert all(running == (state is RuntimeState.PLAYING) for state, running in seen)
    assert rig.programs[0].ticks == 5 and not rig.programs[0].stopped


def test_an_upload_replaces_what_runs_once_the_arm_rests() -> None:
    rig = Rig(sweep=True)
    rig.c.upload("def count():\nend\n", "test")
    assert rig.programs[0].stopped and rig.c.runtime_state is RuntimeState.STOPPING
    rig.until(lambda: rig.c.runtime_state is RuntimeState.PLAYING)
    assert not rig.mover.moving and rig.c.runtime.program is rig.programs[1]


def test_text_that_is_no_program_changes_nothing() -> None:
    rig = Rig(sweep=True)
    assert not rig.c.upload("def nonsense(", "test")
    assert rig.c.runtime_state is RuntimeState.PLAYING
    assert rig.said[-1] == ("Program refused: this text is no program that can be run here", 1)


def test_a_program_that_fails_ends_and_the_controller_goes_on() -> None:
    rig = Rig()
    rig.c.upload("def fails():\nend\n", "test")
    rig.run(0.1)
    assert rig.c.runtime_state is RuntimeState.STOPPED
    assert ("Runtime exception in fails: division by zero", 0) in rig.said


def test_pause_and_resume_scale_motion_smoothly() -> None:
    rig = Rig(sweep=True)
    speeds = [rig.mover.qd[0]]

    def watch(state: RuntimeState) -> float:
        def reached() -> bool:
            speeds.append(rig.mover.qd[0])
            return rig.c.runtime_state is state

        return rig.until(reached)

    ticks = rig.programs[0].ticks
    assert rig.c.runtime.pause()
    assert 0.1 < watch(RuntimeState.PAUSED) < 0.4
    assert speeds[-1] == 0.0 and rig.c.speed_scaling == 0.0
    rig.run(0.1)
    assert rig.programs[0].ticks == ticks and rig.mover.moving
    assert rig.c.runtime.resume()
    watch(RuntimeState.PLAYING)
    rig.run(0.05)
    assert rig.mover.qd[0] == pytest.approx(0.5) and rig.programs[0].ticks > ticks
    assert max(abs(b - a) for a, b in pairwise(speeds)) < 0.01


def test_a_pause_also_stops_what_is_not_scaled() -> None:
    rig = Rig()
    rig.c.upload("def count():\nend\n", "test")
    rig.run(0.1)
    rig.mover.push(np.array([0, 0, 1.0, 0, 0, 0]))
    rig.run(0.1)
    rig.c.runtime.pause()
    rig.run(0.5)
    assert rig.c.runtime_state is RuntimeState.PAUSED and not rig.mover.qd.any()


def test_the_slider_is_a_ramp() -> None:
    rig = Rig(sweep=True)
    take = Inputs(rig.c).taker(["speed_slider_mask", "speed_slider_fraction"])
    take([1, 0.25])
    outputs = Outputs(rig.c).getters
    assert outputs["target_speed_fraction"]() == (0.25,)
    rig.run(0.1)
    assert 0.7 < rig.c.speed_scaling < 0.9
    rig.run(0.5)
    assert rig.c.speed_scaling == pytest.approx(0.25) and rig.mover.qd[0] == pytest.approx(0.125)
    assert outputs["speed_scaling"]()[0] == pytest.approx(1.0), "times the fraction it is the ratio"
    take([1, 0.0])
    assert rig.c.io.speed_slider == 0.01
    take([0, 0.7])
    take([1, float("nan")])
    assert rig.c.io.speed_slider == 0.01


def test_protective_stop_kills_the_program_and_waits_five_seconds() -> None:
    rig = Rig(sweep=True)
    rig.c.protective_stop("asked for")
    assert (rig.c.safety_mode, rig.c.robot_mode) == (SafetyMode.PROTECTIVE_STOP, RobotMode.RUNNING)
    assert rig.c.safety_status_bits == 1 << 2 | 1 << 10
    assert rig.programs[0].stopped and rig.c.runtime_state is RuntimeState.STOPPING
    rig.run(0.1)
    assert not rig.mover.qd.any() and rig.c.speed_scaling == 0.0
    assert not rig.c.upload(SWEEP, "test")
    assert not rig.c.play()
    rig.run(4.85)
    assert rig.c.unlock_protective_stop().startswith(
        "Cannot unlock protective stop until 5s after occurrence"
    )
    rig.run(0.1)
    assert rig.c.unlock_protective_stop() == ""
    assert (rig.c.safety_mode, rig.c.safety_status_bits) == (SafetyMode.NORMAL, 1)
    rig.run(0.5)
    assert rig.c.runtime_state is RuntimeState.STOPPED and not rig.mover.moving
    assert rig.c.upload(SWEEP, "test")
    rig.run(0.3)
    assert rig.mover.qd[0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda rig: rig.mover.push(np.array([0, 0, 0, 0, 0, 6.5])), "Joint 5 speed limit"),
        (lambda rig: setattr(rig.mover, "trouble", "pose out of reach"), "pose out of reach"),
        (lambda rig: setattr(rig.mover, "q", HOME + np.eye(6)[0] * 7.0), "Joint 0 position limit"),
        (lambda rig: setattr(rig.mover, "q", HOME * np.nan), "Joint 0 position limit"),
        (lambda rig: setattr(rig.plant, "blocked", True), "something is in the way"),
    ],
)
def test_what_no_joint_may_do_is_a_protective_stop(spoil: object, said: str) -> None:
    rig = Rig(sweep=True)
    spoil(rig)  # type: ignore[operator]
    rig.until(lambda: rig.c.safety_mode is SafetyMode.PROTECTIVE_STOP)
    assert any(said in text for text, level in rig.said if level == 1)
    rig.run(1.0)
    assert np.isfinite(rig.plant.q).all()


def test_the_safeguard_pauses_and_goes_on_by_itself() -> None:
    rig = Rig(SafetyIo(safeguard=(8, 9)), sweep=True)
    rig.c.digital_input(9, False)
    rig.c.tick()
    assert rig.c.safety_mode is SafetyMode.SAFEGUARD_STOP
    assert rig.c.safety_status_bits == 1 << 4 | 1 << 10
    rig.run(0.5)
    assert rig.c.runtime_state is RuntimeState.PAUSED and rig.mover.moving and not rig.mover.qd.any()
    rig.c.digital_input(9, True)
    rig.run(0.5)
    assert rig.c.runtime_state is RuntimeState.PLAYING and rig.mover.qd[0] == pytest.approx(0.5)


def test_a_safeguard_with_reset_needs_a_rising_edge() -> None:
    rig = Rig(SafetyIo(safeguard=(8,), reset=10), sweep=True)
    rig.c.digital_input(10, True)
    rig.run(0.1)
    rig.c.digital_input(8, False)
    rig.run(0.5)
    rig.c.digital_input(8, True)
    rig.run(0.5)
    assert rig.c.safety_mode is SafetyMode.SAFEGUARD_STOP, "the reset was high all the time"
    rig.c.digital_input(10, False)
    rig.run(0.1)
    rig.c.digital_input(10, True)
    rig.run(0.5)
    assert rig.c.safety_mode is SafetyMode.NORMAL and rig.c.runtime_state is RuntimeState.PLAYING


def test_a_paused_program_stays_paused_after_the_safeguard() -> None:
    rig = Rig(SafetyIo(safeguard=(8,)), sweep=True)
    rig.c.runtime.pause()
    rig.run(0.5)
    for closed in (False, True):
        rig.c.digital_input(8, closed)
        rig.run(0.3)
    assert rig.c.runtime_state is RuntimeState.PAUSED


@pytest.mark.parametrize(
    ("stop", "release", "mode", "bits"),
    [
        (
            lambda c: c.emergency_stop(True),
            lambda c: c.emergency_stop(False),
            SafetyMode.ROBOT_EMERGENCY_STOP,
            1 << 6 | 1 << 7 | 1 << 10,
        ),
        (
            lambda c: c.digital_input(12, False),
            lambda c: c.digital_input(12, True),
            SafetyMode.SYSTEM_EMERGENCY_STOP,
            1 << 5 | 1 << 7 | 1 << 10,
        ),
    ],
)
def test_emergency_stops_end_powered_off(stop: object, release: object, mode: SafetyMode, bits: int) -> None:
    rig = Rig(SafetyIo(emergency=(12,)), sweep=True)
    stop(rig.c)  # type: ignore[operator]
    rig.run(0.2)
    assert (rig.c.safety_mode, rig.c.safety_status_bits) == (mode, bits)
    assert rig.c.robot_mode is RobotMode.POWER_OFF and rig.programs[0].stopped
    assert rig.c.robot_status_bits == 0 and rig.c.joint_mode == 239
    assert not rig.c.power_on() and not rig.c.brake_release()
    release(rig.c)  # type: ignore[operator]
    rig.run(0.2)
    assert (rig.c.safety_mode, rig.c.robot_mode) == (SafetyMode.NORMAL, RobotMode.POWER_OFF)
    assert rig.c.brake_release()
    rig.run(0.2)
    assert rig.c.robot_mode is RobotMode.RUNNING and rig.c.upload(SWEEP, "test")


@pytest.mark.parametrize("which", ["violation", "fault"])
def test_violation_and_fault_need_a_restart(which: str) -> None:
    rig = Rig(sweep=True)
    getattr(rig.c, which)("broken on purpose")
    rig.run(0.2)
    assert rig.c.safety_mode.name == which.upper() and rig.c.joint_mode == 252
    assert rig.c.robot_mode is RobotMode.POWER_OFF and not rig.c.power_on()
    assert rig.c.unlock_protective_stop() == "" and rig.c.safety_mode.name == which.upper()
    rig.c.restart_safety()
    assert (rig.c.safety_mode, rig.c.robot_mode) == (SafetyMode.NORMAL, RobotMode.BOOTING)
    rig.run(0.1)
    assert rig.c.robot_mode is RobotMode.POWER_OFF and rig.c.brake_release()
    rig.run(0.1)
    assert rig.c.robot_mode is RobotMode.RUNNING


def test_reduced_mode_goes_on() -> None:
    rig = Rig(SafetyIo(reduced=(14,)), sweep=True)
    rig.c.digital_input(14, False)
    rig.run(0.1)
    assert (rig.c.safety_mode, rig.c.safety_status_bits) == (SafetyMode.REDUCED, 2)
    assert rig.c.runtime_state is RuntimeState.PLAYING and rig.c.speed_scaling == 1.0


def test_steady_after_half_a_second_of_rest() -> None:
    rig = Rig(sweep=True)
    rig.c.runtime.stop()
    rig.until(lambda: not rig.mover.moving)
    assert 0.45 < rig.until(rig.c.steady) < 0.55


def test_inputs_act_on_registers_and_outputs() -> None:
    rig = Rig()
    inputs = Inputs(rig.c)
    inputs.taker(["input_int_register_3", "input_double_register_47"])([-5, 2.5])
    inputs.taker(["input_bit_registers32_to_63", "input_bit_register_64"])([0x8000_0001, True])
    registers = rig.c.registers
    assert (registers.in_int[3], registers.in_double[47]) == (-5, 2.5)
    assert [i for i, bit in enumerate(registers.in_bit) if bit] == [32, 63, 64]
    digital = ["standard_digital_output_mask", "standard_digital_output"]
    inputs.taker(digital)([0b101, 0b111])
    inputs.taker([name.replace("standard", "configurable") for name in digital])([1, 1])
    inputs.taker([name.replace("standard", "tool") for name in digital])([2, 2])
    inputs.taker(digital)([0b100, 0])
    rig.run(0.01)
    assert rig.c.io.digital_out == 0b1 | 1 << 8 | 1 << 17 and rig.plant.lamps[-1] == rig.c.io.digital_out
    analog = [f"standard_analog_output_{part}" for part in ("mask", "type", "0", "1")]
    inputs.taker(analog)([3, 0b01, 0.5, 0.5])
    assert rig.c.io.analog_out == [5.0, pytest.approx(0.012)]
    rig.c.payload = 1.5
    rig.run(0.01)
    assert rig.plant.masses == [1.5]


def test_every_output_has_a_value_of_its_type() -> None:
    rig = Rig(sweep=True)
    getters = Outputs(rig.c).getters
    missing = {name for name, field in fields().items() if not field.input} - set(getters)
    assert missing == {"target_base_wrench"}
    for name, getter in getters.items():
        char, count = FORMATS[fields()[name].type]
        values = list(getter())
        assert len(values) == count, name
        assert all(isinstance(v, float if char == "d" else int) for v in values), name


@pytest.mark.parametrize("model", [UR3E, UR5E])
def test_tcp_pose_and_speed_follow_the_joints(model: object) -> None:
    rig = Rig(sweep=True)
    rig.c.tcp = np.array([0.01, 0.02, 0.15, 0.1, 0.2, 0.3])
    outputs = Outputs(rig.c).getters
    rig.run(0.3)
    poses, speeds, elbows = [], [], []
    for _ in range(3):
        rig.c.tick()
        poses.append(np.array(outputs["actual_TCP_pose"]()))
        speeds.append(np.array(outputs["actual_TCP_speed"]()))
        elbows.append(np.array(outputs["elbow_position"]()))
    rate = (poses[2] - poses[0]) / (2 * PERIOD)
    assert speeds[1][:3] == pytest.approx(rate[:3], abs=1e-6)
    assert speeds[1][3:] == pytest.approx([0.0, 0.0, 0.5])
    elbow_rate = (elbows[2] - elbows[0]) / (2 * PERIOD)
    assert outputs["elbow_velocity"]() == pytest.approx(elbow_rate.tolist(), abs=1e-3)
    assert np.linalg.norm(outputs["actual_tool_accelerometer"]()) == pytest.approx(9.82, abs=0.3)


@pytest.mark.parametrize(
    ("q", "pose"),
    [
        (
            [-1.54, -1.83, -2.28, -0.59, 1.60, 0.023],
            [-0.119995, -0.273535, 0.120594, -0.012413, 3.11199, -0.018048],
        ),
        (
            [0.3, -1.2, 1.1, -1.4, -1.5, 0.7],
            [-0.321443, -0.243430, 0.302456, 2.546676, 1.683626, 0.073301],
        ),
    ],
)
def test_reported_pose_against_reference_values(q: list[float], pose: list[float]) -> None:
    rig = Rig()
    rig.mover.reset(np.array(q))
    rig.run(PERIOD)
    assert Outputs(rig.c).getters["actual_TCP_pose"]() == pytest.approx(pose, abs=2e-6)
