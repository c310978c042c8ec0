"""Commands of ur-rtde's control script that ask for something or set something."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.emulator.interfaces import PERIOD
from hil.emulator.poses import pose_of, pose_trans
from hil.emulator.urscript import robot as on
from hil.emulator.urscript.robot import joints_for
from hil.emulator.urscript.rtde_motion import Command
from hil.emulator.urscript.rtde_state import Script, Watchdog


def zero_ft_sensor(s: Script) -> None:
    s.mover.memory.zero()


def set_payload(s: Script) -> None:
    """A centre of gravity of 0 means the one that is set."""
    cog = [s.double_in(i) for i in (1, 2, 3)]
    on.set_payload(s.robot, s.double_in(0), cog if any(cog) else None)


def set_damping(s: Script) -> None:
    s.mover.force.damping = min(max(s.double_in(0), 0.0), 1.0)


def set_gain(s: Script) -> None:
    s.mover.force.gain = min(max(s.double_in(0), 0.0), 2.0)


def tool_contact(s: Script) -> None:
    s.int_out(1, s.mover.memory.contact(s.six_in(0)))


def step_time(s: Script) -> None:
    s.doubles_out([PERIOD])


def joint_history(s: Script) -> None:
    s.doubles_out(s.mover.memory.joints(s.int_in(1)))


def target_waypoint(s: Script) -> None:
    s.doubles_out(s.mover.waypoint())


def set_tcp(s: Script) -> None:
    s.robot.tcp = np.array(s.six_in(0))


def tcp_offset(s: Script) -> None:
    s.doubles_out(s.robot.tcp.tolist())


def inverse(s: Script) -> None:
    s.doubles_out(joints_for(s.robot, s.six_in(0)))


def inverse_near(s: Script) -> None:
    s.doubles_out(joints_for(s.robot, s.six_in(0), s.six_in(6)))


def has_inverse(s: Script) -> None:
    s.int_out(1, s.mover.ik(s.six_in(0), s.robot.measured.q) is not None)


def has_inverse_near(s: Script) -> None:
    s.int_out(1, s.mover.ik(s.six_in(0), s.six_in(6)) is not None)


def joints_within_limits(s: Script) -> None:
    s.int_out(1, s.mover.kinematics.within(s.six_in(0)))


def protective_stop(s: Script) -> None:
    s.robot.protective_stop("protective_stop() in the program")


def set_watchdog(s: Script) -> None:
    frequency = s.double_in(0)
    if frequency > 0.0:
        s.watchdog = Watchdog(s.robot, s.upload.first_int, frequency)


def joint_torques(s: Script) -> None:
    s.doubles_out(s.robot.measured.effort.tolist())


def trans(s: Script) -> None:
    s.doubles_out(pose_trans(s.six_in(0), s.six_in(6)))


def forward(s: Script) -> None:
    s.doubles_out(s.mover.kinematics.pose(s.robot.measured.q.tolist(), s.robot.tcp.tolist()))


def forward_of(s: Script) -> None:
    """The offset is whatever is in the registers, which a client may not have written."""
    s.doubles_out(s.mover.kinematics.pose(s.six_in(0), s.six_in(6)))


def steady(s: Script) -> None:
    s.int_out(1, s.robot.steady())


def freedrive_status(s: Script) -> None:
    s.int_out(1, 0)


def external_sensor(s: Script) -> None:
    if s.int_in(1) == 1:
        s.robot.message("An external force sensor is not emulated; the robot's own goes on to be used", 2)


def flange_pose(s: Script) -> None:
    s.doubles_out(pose_of(s.mover.kinematics.flange(s.robot.measured.q.tolist())))


def set_gravity(s: Script) -> None:
    s.robot.gravity = np.array([s.double_in(i) for i in range(3)])


def read_contact(s: Script) -> None:
    s.int_out(1, s.step_back)


ANSWERS: Mapping[int, Command] = {
    8: zero_ft_sensor,
    17: set_payload,
    20: set_damping,
    21: set_gain,
    25: tool_contact,
    26: step_time,
    27: joint_history,
    28: target_waypoint,
    29: set_tcp,
    30: inverse_near,
    31: protective_stop,
    35: set_watchdog,
    36: has_inverse,
    37: joints_within_limits,
    38: joint_torques,
    39: trans,
    40: tcp_offset,
    43: forward,
    44: forward_of,
    46: inverse,
    47: steady,
    54: freedrive_status,
    56: external_sensor,
    57: external_sensor,
    58: flange_pose,
    59: set_gravity,
    60: has_inverse,
    61: has_inverse_near,
    64: read_contact,
    65: set_payload,
}
