"""Commands of ur-rtde's control script that move the arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hil.emulator.interfaces import PERIOD
from hil.emulator.motion.path import Leg
from hil.emulator.poses import frame_of, turn
from hil.emulator.urscript import actions
from hil.emulator.urscript.functions import functions
from hil.emulator.urscript.moves import MOVES, Targets
from hil.emulator.urscript.robot import Wait, joints_for, retreat, settle, stop
from hil.emulator.urscript.rtde_state import CONTACT, Script
from hil.emulator.urscript.values import Evaluator

Command = Callable[[Script], Wait | None]
_JOG_STOP = 1.2


def _move(make: Callable[[Script], Leg]) -> Command:
    """A move: waited for, or in a thread of its own."""

    def command(s: Script) -> Wait:
        leg = make(s)
        s.stop_operation()
        if s.int_in(1) == 1:
            s.threads["move"] = _operation(s, leg)
            return
        s.mover.path([leg])
        yield
        yield from settle(s.mover)

    return command


def _operation(s: Script, leg: Leg) -> Wait:
    s.progress(0)
    s.mover.path([leg])
    yield
    yield from settle(s.mover)
    s.finished()


def _speeds(s: Script) -> tuple[float, float]:
    return s.double_in(6), s.double_in(7)


def _joint_leg(s: Script) -> Leg:
    return Leg(tuple(s.six_in(0)), False, *_speeds(s))


def _joint_leg_to_pose(s: Script) -> Leg:
    return Leg(tuple(joints_for(s.robot, s.six_in(0))), False, *_speeds(s))


def _tool_leg(s: Script) -> Leg:
    return Leg(tuple(s.six_in(0)), True, *_speeds(s))


def _tool_leg_to_joints(s: Script) -> Leg:
    pose = s.mover.kinematics.pose(s.six_in(0), s.robot.tcp.tolist())
    return Leg(tuple(pose), True, *_speeds(s))


def move_path(s: Script) -> Wait:
    s.stop_operation()
    if s.int_in(1) == 1:
        s.threads["move"] = _path_operation(s)
        return
    yield from _path(s)  # as in the script, nothing says that it is finished


def _path_operation(s: Script) -> Wait:
    s.progress(0)
    yield from _path(s)
    s.finished()


def _path(s: Script) -> Wait:
    scope, targets = Evaluator(functions(lambda: s.robot)), Targets(s.robot)
    legs = []
    for _, statement in s.upload.path:
        arguments, named = scope.arguments(statement.call)
        legs.append(MOVES[statement.move](targets, *arguments, **named))
    if not legs:
        return
    s.mover.path(legs)
    told = -1
    while True:
        while told < s.mover.leg:
            told += 1
            if (value := s.upload.path[told][0]) is not None:
                s.progress(value)
        if not s.mover.busy:
            return
        yield


def _stop(s: Script) -> Wait:
    """stopL and stopJ alike: which of them it is follows from the stops before, not from the command."""
    deceleration = s.double_in(0)
    if "stop" in s.threads:
        s.kill("stop")
        s.finished()
    else:
        s.stop_operation()
    if s.int_in(1) == 1:
        s.latest.stop_linear = True
        s.threads["stop"] = _stop_operation(s, deceleration)
        return
    yield from stop(s.mover, deceleration, s.latest.stop_linear)


def _stop_operation(s: Script, deceleration: float) -> Wait:
    s.progress(0)
    yield from stop(s.mover, deceleration, s.latest.stop_linear)
    s.finished()


def speed_j(s: Script) -> None:
    _speed(s, linear=False)


def speed_l(s: Script) -> None:
    _speed(s, linear=True)


def _speed(s: Script, linear: bool) -> None:
    s.latest.speed = (linear, s.six_in(0), s.double_in(6), s.double_in(7))
    s.threads.setdefault("speed", _speed_thread(s))


def _speed_thread(s: Script) -> Wait:
    """A speed is kept for its time, or until it is reached, before the next one is read."""
    while True:
        linear, target, acceleration, t = s.latest.speed
        if linear:
            s.mover.speedl(target, acceleration)
        else:
            s.mover.speedj(target, acceleration)
        yield
        if t > 0.0:
            for _ in range(max(1, round(t / PERIOD)) - 1):
                yield
        else:
            while not s.mover.reached:
                yield


def speed_stop(s: Script) -> Wait:
    s.kill("speed")
    yield from stop(s.mover, s.double_in(0), s.latest.speed[0])


def servo_j(s: Script) -> None:
    _servo(s, s.six_in(0))


def servo_l(s: Script) -> None:
    _servo(s, joints_for(s.robot, s.six_in(0)))


def _servo(s: Script, q: list[float]) -> None:
    s.latest.servo = (q, s.double_in(8), s.double_in(9), s.double_in(10))
    s.threads.setdefault("servo", _servo_thread(s))


def _servo_thread(s: Script) -> Wait:
    while True:
        q, t, lookahead, gain = s.latest.servo
        s.mover.servoj(q, t, lookahead, gain)
        for _ in range(max(1, round(t / PERIOD))):
            yield


def servo_c(s: Script) -> None:
    s.latest.circle = (s.six_in(0), s.double_in(7), s.double_in(6))
    s.threads.setdefault("circle", _circle_thread(s))


def _circle_thread(s: Script) -> Wait:
    while True:
        s.mover.servoc(*s.latest.circle)
        yield


def servo_stop(s: Script) -> Wait:
    s.kill("servo", "circle")
    yield from stop(s.mover, s.double_in(0), linear=True)


def force_mode(s: Script) -> None:
    selection = [float(s.int_in(i)) for i in range(2, 8)]
    actions.start_force_mode(s.robot, s.six_in(0), selection, s.six_in(6), s.int_in(1), s.six_in(12))


def force_mode_stop(s: Script) -> Wait:
    s.mover.end_force_mode()
    yield from stop(s.mover, 10.0, linear=True)


def jog_start(s: Script) -> None:
    s.latest.jog = (s.six_in(0), s.double_in(7))
    feature, custom = round(s.double_in(6)), s.six_in(8)
    if "jog" not in s.threads:
        tool = s.mover.kinematics.pose(s.robot.measured.q.tolist(), s.robot.tcp.tolist())
        s.threads["jog"] = _jog_thread(s, {1: tool, 2: custom}.get(feature, [0.0] * 6))


def _jog_thread(s: Script, feature: list[float]) -> Wait:
    frame = frame_of(feature)
    while True:
        twist, acceleration = s.latest.jog
        s.mover.speedl([*turn(frame, twist[:3]), *turn(frame, twist[3:])], acceleration)
        yield


def jog_stop(s: Script) -> Wait:
    s.kill("jog")
    yield from stop(s.mover, _JOG_STOP, linear=True)


def move_until_contact(s: Script) -> Wait:
    speed, direction, acceleration = s.six_in(0), s.six_in(6), s.double_in(12)
    while not (steps := s.mover.memory.contact(direction)):
        s.mover.speedl(speed, acceleration, 2 * PERIOD)
        yield
    yield from retreat(s.robot, steps)


def start_contact_detection(s: Script) -> None:
    s.threads["contact"] = _contact_thread(s, s.six_in(0))


def _contact_thread(s: Script, direction: list[float]) -> Wait:
    s.step_back = 0
    along_motion = sum(direction) < 1e-10  # the script's own test of a null vector

    def steps() -> int:
        return s.mover.memory.contact(s.mover.tool_velocity(s.robot.measured) if along_motion else direction)

    while steps() > 0:
        yield
    while not (found := steps()):
        yield
    s.step_back, s.internal = found, CONTACT


def stop_contact_detection(s: Script) -> None:
    s.kill("contact")
    s.int_out(1, s.step_back)


def contact_found(s: Script) -> Wait:
    s.stop_operation()
    yield from retreat(s.robot, s.step_back)


def freedrive(s: Script) -> None:
    s.mover.freedrive([s.int_in(i) != 0 for i in range(1, 7)], s.six_in(0))


def teach_mode(s: Script) -> None:
    s.mover.freedrive([True] * 6)


def end_freedrive(s: Script) -> None:
    s.mover.stopj(4.0)


MOTION: Mapping[int, Command] = {
    1: _move(_joint_leg),
    2: _move(_joint_leg_to_pose),
    3: _move(_tool_leg),
    4: _move(_tool_leg_to_joints),
    6: force_mode,
    7: force_mode_stop,
    9: speed_j,
    10: speed_l,
    11: servo_j,
    12: servo_c,
    15: speed_stop,
    16: servo_stop,
    18: teach_mode,
    19: end_freedrive,
    24: servo_l,
    33: _stop,
    34: _stop,
    41: jog_start,
    42: jog_stop,
    45: move_path,
    51: move_until_contact,
    52: freedrive,
    53: end_freedrive,
    62: start_contact_detection,
    63: stop_contact_detection,
    CONTACT: contact_found,
}
