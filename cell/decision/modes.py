"""Which mode the robot works in, and which speed cap binds.

The policy may only request industrial mode; what is measured must permit it, and losing
either ends it at once. The cap in force is the least of all caps.
"""

from __future__ import annotations

from dataclasses import dataclass

from cell.config import MotionConfig
from cell.wire.vocabulary import Mode, RobotType


@dataclass(frozen=True)
class Permit:
    """What separation and health allow.

    Attributes:
        industrial: industrial mode is permitted.
        separation: nearest person [m]; infinity when the cell is configured without a person.
        cap: TCP speed that the separation allows [m/s].
        reason: why industrial mode is not permitted, empty otherwise.
    """

    industrial: bool
    separation: float
    cap: float
    reason: str = ""


NOBODY = Permit(industrial=True, separation=float("inf"), cap=float("inf"))
"""The permit of a cell in which no person works."""


@dataclass(frozen=True)
class ModeState:
    """The mode in force. cap [m/s] is the TCP speed cap, `binding` the name of the cap that binds."""

    mode: Mode
    requested: bool
    permitted: bool
    separation: float
    cap: float
    binding: str


def decide(config: MotionConfig, own_type: RobotType, permit: Permit, stopped: bool) -> ModeState:
    """The mode that follows from the policy's request, the permit and a latched stop."""
    requested = own_type is RobotType.INDUSTRIAL
    if stopped:
        return ModeState(Mode.STOPPED, requested, permit.industrial, permit.separation, 0.0, "stop")
    industrial = requested and permit.industrial
    mode = Mode.INDUSTRIAL if industrial else Mode.COLLABORATIVE
    mode_cap = config.industrial_speed if industrial else config.collaborative_speed
    # At or below the collaborative speed the arm's own force limiting is relied upon.
    separation_cap = max(permit.cap, config.collaborative_speed)
    cap = min(mode_cap, separation_cap)
    binding = mode.name.lower() if mode_cap <= separation_cap else "separation"
    return ModeState(mode, requested, permit.industrial, permit.separation, cap, binding)
