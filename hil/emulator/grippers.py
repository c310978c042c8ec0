"""Grippers behind the Robotiq socket: one of the physics, and one that only moves.

A command comes from the socket's thread and is taken over by the plant's; both sides only assign
whole tuples, so neither ever waits for the other.
"""

from __future__ import annotations

import itertools

from cell.settings import GripperConfig
from hil.sim.gripper import SimGripper

_ARRIVED = 1e-6


class _Handover:
    """A numbered command one way, and the state that answers it the other way."""

    def __init__(self, config: GripperConfig) -> None:
        self.stroke = config.stroke
        self._config = config
        self._numbers = itertools.count(1)
        self._command = (0, config.stroke, config.max_speed, config.min_force)
        self._state = (0, config.stroke, False, False)

    def command(self, width: float, speed: float, force: float) -> None:
        """Move to a width [m] at a speed [m/s] with at most a force [N]; clipped to the device."""
        c = self._config
        self._command = (
            next(self._numbers),
            min(max(width, 0.0), c.stroke),
            min(max(speed, c.min_speed), c.max_speed),
            min(max(force, c.min_force), c.max_force),
        )

    def state(self) -> tuple[float, bool, bool]:
        """(width [m], still moving, stopped on an object)."""
        number, width, moving, holding = self._state
        if number != self._command[0]:
            return width, True, False  # the plant has not seen the newest command yet
        return width, moving, holding


class IdealGripper(_Handover):
    """Fingers that move at the speed they are told, and stop at an object when closing.

    Attributes:
        object: width of what lies between the fingers [m]; None: nothing.
    """

    def __init__(self, config: GripperConfig) -> None:
        super().__init__(config)
        self.object: float | None = None

    def advance(self, period: float) -> None:
        """Let time pass [s]; called by the plant."""
        number, target, speed, _ = self._command
        width = self._state[1]
        goal = target
        if self.object is not None and target < self.object <= width + _ARRIVED:
            goal = self.object
        step = speed * period
        width += min(max(goal - width, -step), step)
        moving = abs(goal - width) > _ARRIVED
        self._state = (number, width, moving, not moving and goal != target)


class WorldGripper(_Handover):
    """The fingers of the simulated cell."""

    def __init__(self, config: GripperConfig, gripper: SimGripper) -> None:
        super().__init__(config)
        self._gripper = gripper
        self._taken = 0

    def drive(self, period: float) -> None:
        """Command the motors for the coming control period [s]; called by the plant."""
        number, width, speed, force = self._command
        if number != self._taken:
            self._taken = number
            self._gripper.command(width, speed, force)
        moving = self._gripper.drive(period)
        self._state = (number, self._gripper.measure()[0], moving, self._gripper.holding)
