"""servoc: the TCP after a target that may be changed at any time, at constant speed."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hil.emulator.kinematics import Kinematics, error, length, tool_speed
from hil.emulator.motion import DT, Step, advance
from hil.emulator.motion.move import solved
from hil.emulator.poses import Frame, frame_of

_ROOM = 0.9
_THERE = 1e-7


class Pursuit:
    """Straight towards the target, slowing down before it.

    Args:
        tool: TCP in the flange.
    """

    checked = False

    def __init__(self, kinematics: Kinematics, tool: Frame) -> None:
        self._kinematics, self._tool = kinematics, tool
        self._target: Frame | None = None
        self._speed = self._acceleration = 0.0
        self._twist: list[float] | None = None

    def command(self, pose: Sequence[float], acceleration: float, speed: float) -> None:
        """Another target, pose of the TCP (6,), [m/s^2], [m/s]."""
        self._target, self._speed, self._acceleration = frame_of(pose), speed, acceleration

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        del scaling
        frame, J = self._kinematics.jacobian(q, self._tool)
        twist = self._twist if self._twist is not None else tool_speed(J, qd)
        off = error(self._target or frame, frame)
        away = length(off)
        fastest = min(self._speed, math.sqrt(2 * _ROOM * self._acceleration * away), away / (2 * DT))
        k = fastest / away if away > _THERE else 0.0
        change = [k * e - t for e, t in zip(off, twist, strict=True)]
        size, step = length(change), self._acceleration * DT
        k = 1.0 if size <= step else step / size
        twist = [t + k * c for t, c in zip(twist, change, strict=True)]
        self._twist = twist
        after = solved(J, twist)[0]
        return advance(q, qd, after), after, away > _THERE or length(twist) > _THERE
