"""Move statements of programs, and their targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hil.emulator.interfaces import Robot
from hil.emulator.motion.path import Leg
from hil.emulator.urscript.robot import joints_for, mover_of
from hil.emulator.urscript.values import Pose, Value, number, sixfold

Target = tuple[list[float], bool]
"""Six numbers, and whether they are a pose."""
_SWIFT = (3.14, 15.0)
"""What optimovej takes as all that the arm can do [rad/s], [rad/s^2]."""
_SWIFT_TOOL = (0.5, 2.5)
"""What optimovel takes as that [m/s], [m/s^2]."""


class Targets:
    """Turns targets into those that the mover takes: joint angles for movej, poses for the others.

    Args:
        robot: whose active TCP and present joints count.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._near: list[float] = list(robot.mover.q.tolist())

    def joints(self, target: Target, near: list[float] | None = None) -> tuple[float, ...]:
        """Of a target; a pose gets the solution nearest to the target before it."""
        q = joints_for(self._robot, target[0], near or self._near) if target[1] else target[0]
        self._near = q
        return tuple(q)

    def pose(self, target: Target) -> tuple[float, ...]:
        """Of the TCP, for joint angles too."""
        if target[1]:
            return tuple(target[0])
        self._near = target[0]
        return tuple(mover_of(self._robot).kinematics.pose(target[0], self._robot.tcp.tolist()))


def movej(to: Targets, q: Value, a: Value = 1.4, v: Value = 1.05, t: Value = 0.0, r: Value = 0.0) -> Leg:
    return Leg(to.joints(_target(q)), False, number(v), number(a), number(t), number(r))


def movel(to: Targets, pose: Value, a: Value = 1.2, v: Value = 0.25, t: Value = 0.0, r: Value = 0.0) -> Leg:
    return Leg(to.pose(_target(pose)), True, number(v), number(a), number(t), number(r))


def movep(to: Targets, pose: Value, a: Value = 1.2, v: Value = 0.25, r: Value = 0.0) -> Leg:
    return Leg(to.pose(_target(pose)), True, number(v), number(a), blend=number(r))


def movec(
    to: Targets,
    pose_via: Value,
    pose_to: Value,
    a: Value = 1.2,
    v: Value = 0.25,
    r: Value = 0.0,
    mode: Value = 0,
) -> Leg:
    """The tool turns evenly, whatever the mode; the arc's end is a stop."""
    del r, mode
    via = to.pose(_target(pose_via))[:3]
    return Leg(to.pose(_target(pose_to)), True, number(v), number(a), via=via)


def optimovej(to: Targets, q: Value, a: Value = 0.3, v: Value = 0.3, r: Value = 0.0) -> Leg:
    """v, a are shares of what the arm can do; the real controller reckons that from its torques."""
    v, a = number(v) * _SWIFT[0], number(a) * _SWIFT[1]
    return Leg(to.joints(_target(q)), False, v, a, blend=number(r))


def optimovel(to: Targets, pose: Value, a: Value = 0.3, v: Value = 0.3, r: Value = 0.0) -> Leg:
    """See `optimovej`."""
    v, a = number(v) * _SWIFT_TOOL[0], number(a) * _SWIFT_TOOL[1]
    return Leg(to.pose(_target(pose)), True, v, a, blend=number(r))


MOVES: Mapping[str, Callable[..., Leg]] = {
    f.__name__: f for f in (movej, movel, movep, movec, optimovej, optimovel)
}


def _target(value: Value) -> Target:
    return sixfold(value), isinstance(value, Pose)
