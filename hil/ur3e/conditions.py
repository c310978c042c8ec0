"""Names for everything that keeps the arm from moving, in the words that people read."""

from __future__ import annotations

from enum import IntEnum

from hil.ur3e.block import Measured

RUNNING, PLAYING, STOPPED = 7, 2, 1
"""RTDE: robot_mode and runtime_state in which the arm can be driven; runtime_state without a program."""
SAFETY_FINE = (1, 2)
"""RTDE safety_mode: normal and reduced."""
SILENCE = 0.1
"""A robot, or a driver, that has said nothing for so long counts as gone [s]."""
_E_STOPS = (6, 7, 15)
_E_STOP_BITS = 0b1110_0000
_SAFETY = {
    3: "protective stop: the controller stopped the arm (collision, or a limit)",
    4: "recovery: a joint is outside its safety limits; move it back by hand on the pendant",
    5: "safeguard stop: a safeguard (light curtain, gate, scanner) is open",
    6: "emergency stop: a button of the system is pressed",
    7: "emergency stop: the button of the robot is pressed",
    8: "fault: a safety limit was violated",
    9: "fault: the safety system found a defect",
    11: "fault: the safety system has not been started",
    12: "safeguard stop: the automatic-mode safeguard is open",
    13: "safeguard stop: the three-position switch of the system is not held",
    14: "safeguard stop: the three-position switch of the pendant is not held",
    15: "emergency stop: a button is pressed (immediate stop)",
    16: "safeguard stop: a safeguard is open (immediate stop)",
}
_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "safety configuration not confirmed",
    2: "booting",
    3: "powered off",
    4: "powering on",
    5: "idle, brakes on",
    6: "backdrive",
    8: "updating its firmware",
}


class Cause(IntEnum):
    """Why the driver stopped following set-points."""

    NONE = 0
    ROBOT = 1
    PROGRAM = 2
    DISCONNECTED = 3
    STARVED = 4
    IMPLAUSIBLE = 5
    SERVO = 6
    RELEASED = 7
    UPLOAD = 8
    HELD_UP = 9


_CAUSES = {
    Cause.NONE: "not armed: the control program has not been started",
    Cause.ROBOT: "not armed: the robot stopped the arm",
    Cause.PROGRAM: "program stopped: the control program was stopped or paused on the pendant",
    Cause.DISCONNECTED: "disconnected: the connection to the robot was lost",
    Cause.STARVED: "set-points stopped coming: the node was late or frozen, and the driver braked",
    Cause.IMPLAUSIBLE: "implausible set-point: the driver refused it and braked",
    Cause.SERVO: "servo refused: the control program did not take a set-point",
    Cause.RELEASED: "not armed: the arm was let go",
    Cause.HELD_UP: "driver held up: it was kept from sending set-points for too long, and braked",
    Cause.UPLOAD: "program not started: the controller did not run the control program",
}


def robot_condition(safety_mode: int, safety_bits: int, robot_mode: int) -> str:
    """What the robot itself reports against moving; empty when it may move."""
    if safety_bits & _E_STOP_BITS and safety_mode not in _E_STOPS:
        return "emergency stop: a button is pressed, or was and has not been recovered from"
    if safety_mode not in SAFETY_FINE:
        return _SAFETY.get(safety_mode, f"safety mode {safety_mode}: see the robot's log")
    if robot_mode != RUNNING:
        return f"robot not running: {_MODES.get(robot_mode, f'robot mode {robot_mode}')}"
    return ""


def condition(measured: Measured | None, now: float, epoch: int) -> str:
    """The one thing that now keeps the arm from following, by name; empty when nothing does.

    Args:
        measured: newest of the driver, None when there never was one.
        now: wall clock [s]. epoch: of the set-points that the driver should follow.
    """
    if measured is None or now - measured.beat > SILENCE:
        return "driver silent: the arm's driver process does not answer"
    if now - measured.heard > SILENCE:
        return "disconnected: nothing comes from the robot; look at cable, switch and controller"
    if problem := robot_condition(measured.safety_mode, measured.safety_bits, measured.robot_mode):
        return problem
    if measured.armed != epoch or not epoch:
        return _CAUSES[Cause(measured.cause)]
    if measured.runtime != PLAYING:
        return _CAUSES[Cause.PROGRAM]
    return ""
