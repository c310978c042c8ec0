"""speedj and speedl: towards a joint or tool speed, for a time or until another command."""

from __future__ import annotations

from collections.abc import Sequence

from hil.emulator.kinematics import Kinematics, length, tool_speed
from hil.emulator.motion import DT, Step, advance, towards
from hil.emulator.motion.move import solved
from hil.emulator.poses import Frame

_ROUNDING = 1e-9


class _Speed:
    """What both share: when the time is over, the speed goes down to 0 as it came up.

    Attributes:
        reached: the commanded speed is reached.
    """

    checked = False

    def __init__(self) -> None:
        self.reached = False
        self._target = [0.0] * 6
        self._step = 0.0
        self._left: float | None = None

    def command(self, target: Sequence[float], acceleration: float, t: float) -> None:
        """Another speed (6,), for t [s]; 0: until the next command."""
        self._target = [float(v) for v in target]
        self._step = acceleration * DT
        self._left = t if t > 0.0 else None
        self.reached = False

    def _goal(self) -> list[float]:
        if self._left is None:
            return self._target
        self._left -= DT
        return self._target if self._left > -DT + _ROUNDING else [0.0] * 6

    def _over(self, speed: Sequence[float]) -> bool:
        return self._left is not None and self._left <= _ROUNDING and not any(speed)


class JointSpeed(_Speed):
    """speedj: the joint whose speed changes most does so with the acceleration [rad/s^2]."""

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        del scaling
        goal = self._goal()
        after = towards(qd, goal, self._step)
        self.reached = after == goal
        return advance(q, qd, after), after, not self._over(after)


class ToolSpeed(_Speed):
    """speedl: the twist of the TCP changes with the acceleration [m/s^2], and [rad/s^2] if it turns.

    Args:
        tool: TCP in the flange.
    """

    def __init__(self, kinematics: Kinematics, tool: Frame) -> None:
        super().__init__()
        self._kinematics, self._tool = kinematics, tool
        self._twist: list[float] | None = None

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        del scaling
        _, J = self._kinematics.jacobian(q, self._tool)
        twist = self._twist if self._twist is not None else tool_speed(J, qd)
        goal = self._goal()
        change = [b - a for a, b in zip(twist, goal, strict=True)]
        size = length(change)
        k = 1.0 if size <= self._step else self._step / size
        self.reached = k == 1.0
        twist = goal if self.reached else [a + k * c for a, c in zip(twist, change, strict=True)]
        self._twist = twist
        after = solved(J, twist)[0]
        return advance(q, qd, after), after, not self._over(twist)
