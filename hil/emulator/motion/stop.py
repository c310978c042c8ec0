"""Stops from any motion: stopj and stopl."""

from __future__ import annotations

from hil.emulator.kinematics import Kinematics, length, tool_speed
from hil.emulator.motion import DT, HARD, Step, Trouble, advance
from hil.emulator.motion.move import solved
from hil.emulator.poses import Frame


class JointStop:
    """All joints brake together, on a straight line in joint space.

    Args:
        deceleration: of the joint that moves fastest [rad/s^2].
    """

    checked = True

    def __init__(self, deceleration: float) -> None:
        self._step = deceleration * DT

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        del scaling
        fastest = max(abs(v) for v in qd)
        if fastest <= self._step:
            return advance(q, qd, [0.0] * 6), [0.0] * 6, False
        k = 1.0 - self._step / fastest
        after = [k * v for v in qd]
        return advance(q, qd, after), after, True


class ToolStop:
    """The TCP brakes straight ahead; where that asks too much of a joint, all joints brake hard.

    Args:
        tool: TCP in the flange. deceleration: of the TCP [m/s^2] or, if it only turns, [rad/s^2].
    """

    checked = False

    def __init__(self, kinematics: Kinematics, tool: Frame, deceleration: float) -> None:
        self._kinematics, self._tool = kinematics, tool
        self._step = deceleration * DT
        self._twist: list[float] | None = None
        self._instead: JointStop | None = None

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        if self._instead is not None:
            return self._instead.step(q, qd, scaling)
        _, J = self._kinematics.jacobian(q, self._tool)
        twist = self._twist or tool_speed(J, qd)
        size = length(twist)
        try:
            if size <= self._step:
                after, going = [0.0] * 6, False
            else:
                k = 1.0 - self._step / size
                self._twist = [k * v for v in twist]
                after, going = solved(J, self._twist)[0], True
            sharp = max(abs(a - b) for a, b in zip(after, qd, strict=True)) > HARD * DT
        except Trouble:
            sharp = True
        if sharp:
            self._instead = JointStop(HARD)
            return self._instead.step(q, qd, scaling)
        return advance(q, qd, after), after, going
