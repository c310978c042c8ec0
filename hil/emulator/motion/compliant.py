"""Giving way to forces: force mode and freedrive, as an admittance on the measured wrench.

The real controller's control law is not published. Here the TCP moves, in each compliant direction,
at a speed proportional to the force that is missing or felt, behind a first-order lag. The wrench is
what the surroundings exert on the tool.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hil.emulator.kinematics import Kinematics, tool_speed
from hil.emulator.motion import DT, Step, advance
from hil.emulator.motion.move import solved
from hil.emulator.poses import IDENTITY, Frame, frame_of, turn, turn_back

_RESISTANCE = (200.0, 200.0, 200.0, 10.0, 10.0, 10.0)
"""Force per speed of force mode at gain 1 [N s/m], [Nm s/rad]."""
_LAG = 0.03
_DAMPED = 2.0
"""Time constant of force mode without damping [s], and what damping adds to it."""
_LIGHT = (60.0, 60.0, 60.0, 4.0, 4.0, 4.0)
"""Force per speed of freedrive [N s/m], [Nm s/rad]."""
_BREAKAWAY = (3.0, 3.0, 3.0, 0.3, 0.3, 0.3)
"""Forces below this do not move the arm in freedrive [N], [Nm]."""
_FREE_LAG = 0.1
_FREE_SPEED = (0.5, 0.5, 0.5, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class ForceTask:
    """Arguments of force_mode.

    Attributes:
        frame: task frame in B. compliant: which of its axes give way.
        wrench: what the robot shall exert on its surroundings along them, shape (6,) [N], [Nm].
        limits: largest speed along compliant axes, largest deviation along the others, shape (6,).
    """

    frame: Frame
    compliant: tuple[bool, ...]
    wrench: tuple[float, ...]
    limits: tuple[float, ...]


class ForceMode:
    """Replaces what the arm's own motion does along the compliant axes.

    Attributes:
        damping: 0..1. gain: 0..2.
    """

    def __init__(self) -> None:
        self.damping, self.gain = 0.025, 0.5
        self.task: ForceTask | None = None
        self._speed = [0.0] * 6

    def start(self, task: ForceTask) -> None:
        """Start, or go on with other arguments."""
        self.task = task

    def end(self) -> None:
        """The arm gives way no more."""
        self.task, self._speed = None, [0.0] * 6

    def blend(
        self,
        kinematics: Kinematics,
        tool: Frame,
        q: Sequence[float],
        own: tuple[Sequence[float], Sequence[float]],
        wrench: Sequence[float],
    ) -> list[float]:
        """Joint speeds [rad/s] at q [rad].

        Args:
            own: where the arm's own motion would have the joints, and their speeds there.
            wrench: measured, axes of B, shape (6,).
        """
        task = self.task
        assert task is not None
        _, J = kinematics.jacobian(q, tool)
        twist = [0.0] * 6
        if any(own[1]):
            twist = _in(task.frame, tool_speed(kinematics.jacobian(own[0], tool)[1], own[1]))
        felt = _in(task.frame, wrench)
        share = DT / (_LAG + _DAMPED * self.damping)
        for i in range(6):
            if not task.compliant[i]:
                continue
            missing = task.wrench[i] + felt[i]
            goal = self.gain * missing / _RESISTANCE[i]
            most = abs(task.limits[i])
            self._speed[i] += share * (min(max(goal, -most), most) - self._speed[i])
            twist[i] = self._speed[i]
        return solved(J, [*turn(task.frame, twist[:3]), *turn(task.frame, twist[3:])])[0]


class Freedrive:
    """The arm follows the hand that pushes its tool.

    Args:
        tool: TCP in the flange. axes: which axes of the feature are free.
        feature: pose in B (6,) whose axes those are; None: B.
    """

    checked = False

    def __init__(
        self,
        kinematics: Kinematics,
        tool: Frame,
        axes: Sequence[bool],
        feature: Sequence[float] | None = None,
    ) -> None:
        self._kinematics, self._tool, self._axes = kinematics, tool, list(axes)
        self._frame = IDENTITY if feature is None else frame_of(feature)
        self._speed = [0.0] * 6
        self.wrench: Sequence[float] = [0.0] * 6
        """Measured, axes of B; set before every step."""

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        del scaling
        felt = _in(self._frame, self.wrench)
        for i in range(6):
            beyond = max(abs(felt[i]) - _BREAKAWAY[i], 0.0) if self._axes[i] else 0.0
            goal = min(beyond / _LIGHT[i], _FREE_SPEED[i])
            self._speed[i] += DT / _FREE_LAG * (math.copysign(goal, felt[i]) - self._speed[i])
            if goal == 0.0 and abs(self._speed[i]) < 1e-6:
                self._speed[i] = 0.0
        if not any(self._speed):
            return advance(q, qd, [0.0] * 6), [0.0] * 6, True
        _, J = self._kinematics.jacobian(q, self._tool)
        twist = [*turn(self._frame, self._speed[:3]), *turn(self._frame, self._speed[3:])]
        after = solved(J, twist)[0]
        return advance(q, qd, after), after, True


def _in(frame: Frame, six: Sequence[float]) -> list[float]:
    """A twist or wrench in the axes of `frame`."""
    return [*turn_back(frame, six[:3]), *turn_back(frame, six[3:6])]
