"""What the parts of the external control program share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

from hil.emulator.interfaces import Robot
from hil.emulator.mover import Mover
from hil.emulator.urscript.link import Link
from hil.emulator.urscript.robot import mover_of

STOP = 4.0
"""Deceleration of the program's own stops [rad/s^2]."""
MULTIPLIER = 1e6
_FASTEST = 20.0
"""Targets that need a higher joint speed are not heeded [rad/s]."""


class Mode(IntEnum):
    """Last integer of a message on the reverse interface."""

    STOPPED = -2
    UNINITIALIZED = -1
    IDLE = 0
    SERVOJ = 1
    SPEEDJ = 2
    FORWARD = 3
    SPEEDL = 4
    POSE = 5
    FREEDRIVE = 6
    TOOL_IN_CONTACT = 7
    TORQUE = 8


class Result(IntEnum):
    """What is sent back on the trajectory interface."""

    SUCCESS = 0
    CANCELED = 1
    FAILURE = 2


@dataclass(frozen=True)
class Settings:
    """What the script's text has of its own.

    Attributes:
        host: address of the client. reverse, trajectory, command: its ports.
        lookahead: of servoj [s]. gain: of servoj.
        voltage: that the tool gets at the start; None: as it is.
    """

    host: str
    reverse: int
    trajectory: int
    command: int
    lookahead: float
    gain: float
    voltage: int | None = None


@dataclass
class Session:
    """The program as it runs on a robot.

    Attributes:
        mode: of control.
        left: points of the trajectory that are still to be read.
        streaming: more points may be announced.
        contact: a contact of the tool is waited for.
    """

    robot: Robot
    settings: Settings
    reverse: Link
    trajectory: Link
    command: Link
    mode: int = Mode.UNINITIALIZED
    left: int = 0
    streaming: bool = False
    contact: bool = False
    _refused: bool = field(default=False)

    @property
    def mover(self) -> Mover:
        return mover_of(self.robot)

    def feasible(self, start: Sequence[float], end: Sequence[float], t: float) -> bool:
        """Whether a target can be meant; says so once when it cannot, and when the next one can."""
        speeds = [abs(b - a) / t if t > 0.0 else math.inf for a, b in zip(start, end, strict=True)]
        fastest = max(speeds)
        if fastest > _FASTEST:
            if not self._refused:
                self.robot.message(
                    f"Velocity {fastest:.1f} rad/s required in joint {speeds.index(fastest)} is exceeding "
                    "the joint velocity limits. Ignoring commands until a valid command is received.",
                    2,
                )
            self._refused = True
            return False
        if self._refused:
            self._refused = False
            self.robot.message("Received valid command. Resuming execution.")
        return True

    def close(self) -> None:
        for link in (self.reverse, self.trajectory, self.command):
            link.close()


def scaled(values: Sequence[int]) -> list[float]:
    """Integers of a message as what they stand for."""
    return [v / MULTIPLIER for v in values]
