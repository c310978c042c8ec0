"""Script functions that have a value and take no time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from cell.errors import BackendError
from hil.emulator.interfaces import PERIOD, Robot
from hil.emulator.poses import frame_of, invert, pose_of, pose_trans
from hil.emulator.urscript.robot import joints_for, mover_of
from hil.emulator.urscript.values import Function, Pose, Value, number, sixfold, text_of


def functions(robot: Callable[[], Robot]) -> Mapping[str, Function]:
    """By name. `robot` is asked for when one is called, not before."""

    def forward(q: Value | None = None, tcp: Value | None = None) -> Value:
        at = robot().measured.q.tolist() if q is None else sixfold(q)
        offset = robot().tcp.tolist() if tcp is None else sixfold(tcp)
        return Pose(mover_of(robot()).kinematics.pose(at, offset))

    def inverse(x: Value, qnear: Value | None = None, *tolerances: Value, tcp: Value | None = None) -> Value:
        del tolerances
        pose = sixfold(x)
        if tcp is not None:  # the pose that the active TCP has then
            flange = pose_trans(pose, pose_of(invert(frame_of(sixfold(tcp)))))
            pose = pose_trans(flange, robot().tcp.tolist())
        return list(joints_for(robot(), pose, None if qnear is None else sixfold(qnear)))

    return {
        "get_actual_joint_positions": lambda: list(robot().measured.q.tolist()),
        "get_joint_positions": lambda: list(robot().measured.q.tolist()),
        "get_target_joint_positions": lambda: list(robot().mover.q.tolist()),
        "get_actual_joint_speeds": lambda: list(robot().measured.qd.tolist()),
        "get_target_joint_speeds": lambda: list(robot().mover.qd.tolist()),
        "get_actual_tcp_pose": forward,
        "get_target_tcp_pose": lambda: forward(list(robot().mover.q.tolist())),
        "get_tcp_offset": lambda: Pose(robot().tcp.tolist()),
        "get_forward_kin": forward,
        "get_inverse_kin": inverse,
        "get_steptime": lambda: PERIOD,
        "is_steady": lambda: robot().steady(),
        "pose_trans": lambda a, b: Pose(pose_trans(sixfold(a), sixfold(b))),
        "pose_inv": lambda a: Pose(pose_of(invert(frame_of(sixfold(a))))),
        "d2r": lambda d: math.radians(number(d)),
        "r2d": lambda r: math.degrees(number(r)),
        "to_str": text_of,
        "str_cat": lambda a, b: text_of(a) + text_of(b),
        "read_input_integer_register": lambda i: robot().registers.in_int[index(i, 48)],
        "read_input_float_register": lambda i: robot().registers.in_double[index(i, 48)],
        "read_input_boolean_register": lambda i: robot().registers.in_bit[index(i, 128)],
        "get_standard_digital_in": lambda n: bool(robot().io.digital_in >> index(n, 8) & 1),
        "get_digital_in": lambda n: bool(robot().io.digital_in >> index(n, 8) & 1),
        "get_standard_digital_out": lambda n: bool(robot().io.digital_out >> index(n, 8) & 1),
        "get_digital_out": lambda n: bool(robot().io.digital_out >> index(n, 8) & 1),
    }


def index(value: Value, count: int) -> int:
    n = number(value)
    if n != int(n) or not 0 <= n < count:
        raise BackendError(f"a number 0..{count - 1} is needed, got {value!r:.40}")
    return int(n)
