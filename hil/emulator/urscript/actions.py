"""Script functions that do something. Those that take time are generators."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from cell.errors import BackendError
from hil.emulator.interfaces import PERIOD, Robot
from hil.emulator.motion.compliant import ForceTask
from hil.emulator.poses import frame_of
from hil.emulator.urscript import robot as on
from hil.emulator.urscript.functions import index
from hil.emulator.urscript.robot import Wait, mover_of
from hil.emulator.urscript.values import Value, number, sixfold, text_of, threefold

Action = Callable[..., Wait | None]
_LEVELS = {"error": 1, "warning": 2, "info": 3}


def sleep(robot: Robot, t: Value) -> Wait:
    for _ in range(max(1, math.ceil(number(t) / PERIOD - 1e-9))):
        yield


def sync(robot: Robot) -> Wait:
    yield


def servoj(
    robot: Robot,
    q: Value,
    a: Value = 0.0,
    v: Value = 0.0,
    t: Value = PERIOD,
    lookahead_time: Value = 0.1,
    gain: Value = 300.0,
) -> Wait:
    del a, v  # not used by the controller either
    mover_of(robot).servoj(sixfold(q), number(t), number(lookahead_time), number(gain))
    yield from sleep(robot, t)


def speedj(robot: Robot, qd: Value, a: Value = 1.4, t: Value = 0.0) -> Wait:
    mover = mover_of(robot)
    mover.speedj(sixfold(qd), _above_0("a", a), number(t))
    yield from _speed(robot, number(t))


def speedl(robot: Robot, xd: Value, a: Value = 1.2, t: Value = 0.0, aRot: Value = 0.0) -> Wait:
    del aRot
    mover_of(robot).speedl(sixfold(xd), _above_0("a", a), number(t))
    yield from _speed(robot, number(t))


def stopj(robot: Robot, a: Value) -> Wait:
    yield from on.stop(mover_of(robot), _above_0("a", a), linear=False)


def stopl(robot: Robot, a: Value, aRot: Value = 0.0) -> Wait:
    del aRot
    yield from on.stop(mover_of(robot), _above_0("a", a), linear=True)


def set_digital_out(robot: Robot, n: Value, b: Value) -> None:
    on.set_output(robot, "standard", index(n, 8), bool(b))


def set_configurable_digital_out(robot: Robot, n: Value, b: Value) -> None:
    on.set_output(robot, "configurable", index(n, 8), bool(b))


def set_tool_digital_out(robot: Robot, n: Value, b: Value) -> None:
    on.set_output(robot, "tool", index(n, 2), bool(b))


def set_analog_out(robot: Robot, n: Value, f: Value) -> None:
    """f: 0..1 of 10 V, or of 4..20 mA."""
    i, ratio = index(n, 2), number(f)
    if not 0.0 <= ratio <= 1.0:
        raise BackendError(f"set_analog_out: the level must be 0..1, got {ratio:g}")
    voltage = robot.io.analog_out_type >> i & 1
    robot.io.analog_out[i] = 10.0 * ratio if voltage else 0.004 + 0.016 * ratio


def set_analog_outputdomain(robot: Robot, port: Value, domain: Value) -> None:
    """0 current, 1 voltage."""
    i = index(port, 2)
    robot.io.analog_out_type = robot.io.analog_out_type & ~(1 << i) | index(domain, 2) << i


def textmsg(robot: Robot, s1: Value, s2: Value = "") -> None:
    robot.message(text_of(s1) + text_of(s2))


def popup(
    robot: Robot,
    s: Value,
    title: Value = "Popup",
    warning: Value = False,
    error: Value = False,
    blocking: Value = False,
) -> None:
    """Nobody can press its button, so it never blocks."""
    del blocking
    kind = "error" if error else "warning" if warning else "info"
    robot.message(f"{text_of(title)}: {text_of(s)}", _LEVELS[kind])


def set_payload(robot: Robot, m: Value, cog: Value | None = None, inertia: Value | None = None) -> None:
    del inertia
    on.set_payload(robot, number(m), None if cog is None else threefold(cog))


def set_tcp(robot: Robot, pose: Value, tcp_name: Value = "") -> None:
    del tcp_name
    robot.tcp = np.array(sixfold(pose))


def set_gravity(robot: Robot, d: Value) -> None:
    robot.gravity = np.array(threefold(d))


def set_tool_voltage(robot: Robot, voltage: Value) -> None:
    on.set_tool_voltage(robot, number(voltage))


def zero_ftsensor(robot: Robot) -> None:
    mover_of(robot).memory.zero()


def force_mode(
    robot: Robot, task_frame: Value, selection_vector: Value, wrench: Value, type: Value, limits: Value
) -> None:
    frame, selection, forces = sixfold(task_frame), sixfold(selection_vector), sixfold(wrench)
    start_force_mode(robot, frame, selection, forces, number(type), sixfold(limits))


def start_force_mode(
    robot: Robot,
    frame: list[float],
    selection: list[float],
    wrench: list[float],
    kind: float,
    limits: list[float],
) -> None:
    """Force mode; of its three types only 2 (the task frame as it is) is known here.

    Raises:
        BackendError: another type.
    """
    if kind != 2:
        raise BackendError(f"force_mode: only type 2 is emulated, got {kind:g}")
    compliant = tuple(v != 0 for v in selection)
    mover_of(robot).force_mode(ForceTask(frame_of(frame), compliant, tuple(wrench), tuple(limits)))


def end_force_mode(robot: Robot) -> None:
    mover_of(robot).end_force_mode()


def force_mode_set_damping(robot: Robot, damping: Value) -> None:
    mover_of(robot).force.damping = min(max(number(damping), 0.0), 1.0)


def force_mode_set_gain_scaling(robot: Robot, scaling: Value) -> None:
    mover_of(robot).force.gain = min(max(number(scaling), 0.0), 2.0)


def freedrive_mode(robot: Robot, freeAxes: Value | None = None, feature: Value | None = None) -> None:
    axes = [True] * 6 if freeAxes is None else [v != 0 for v in sixfold(freeAxes)]
    mover_of(robot).freedrive(axes, None if feature is None else sixfold(feature))


def end_freedrive_mode(robot: Robot) -> None:
    mover_of(robot).stopj(4.0)


def write_output_integer_register(robot: Robot, address: Value, value: Value) -> None:
    robot.registers.out_int[index(address, 48)] = round(number(value))


def write_output_float_register(robot: Robot, address: Value, value: Value) -> None:
    robot.registers.out_double[index(address, 48)] = number(value)


def write_output_boolean_register(robot: Robot, address: Value, value: Value) -> None:
    robot.registers.out_bit[index(address, 128)] = bool(value)


def protective_stop(robot: Robot) -> Wait:
    robot.protective_stop("protective_stop() in the program")
    yield  # the program is not gone on with


def _speed(robot: Robot, t: float) -> Wait:
    """For its time, or until the speed is reached."""
    if t > 0.0:
        yield from sleep(robot, t)
        return
    yield
    while not mover_of(robot).reached:
        yield


def _above_0(name: str, value: Value) -> float:
    a = number(value)
    if not a > 0.0:
        raise BackendError(f"{name} must be above 0, got {a:g}")
    return a


ACTIONS: Mapping[str, Action] = {
    f.__name__: f
    for f in (
        sleep, sync, servoj, speedj, speedl, stopj, stopl, set_digital_out, set_configurable_digital_out,
        set_tool_digital_out, set_analog_out, set_analog_outputdomain, textmsg, popup, set_payload, set_tcp,
        set_gravity, set_tool_voltage, zero_ftsensor, force_mode, end_force_mode, force_mode_set_damping,
        force_mode_set_gain_scaling, freedrive_mode, end_freedrive_mode, write_output_integer_register,
        write_output_float_register, write_output_boolean_register, protective_stop,
    )
} | {
    "set_standard_digital_out": set_digital_out,
    "set_standard_analog_out": set_analog_out,
    "set_target_payload": set_payload,
    "teach_mode": freedrive_mode,
    "end_teach_mode": end_freedrive_mode,
}  # fmt: skip
