"""Which mode the robot works in, and which speed cap binds.

The policy may only request industrial mode; what is measured must permit it, and losing either
ends it at once. The cap in force is the least of all caps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from cell.config import CellConfig
from cell.decision.operator import Operator
from cell.motion.ssm import allowed_speed
from cell.settings import MotionConfig
from cell.wire.vocabulary import Mode, RobotType

_UNDERSTOOD = 0.5
"""Belief from which the light shows that the person's fatigue was understood."""
_FALLS, _RISES = 0.01, 0.04
"""The separation cap follows changes larger than these [m/s] ..."""
_RISE_HOLD = 0.3
"""... and rises only when it could have done so for this long [s]."""


@dataclass(frozen=True)
class Sensed:
    """What is measured of the person at one tick.

    Attributes:
        separation: to the nearest point of a person [m]; infinity when nobody is in sight.
        age: of that [s]; infinity when there never was any.
        problem: why the measurement is not to be trusted, empty when it is.
        sign_up: this tick's frame shows a credible thumbs-up.
        fresh: a new frame came at this tick.
    """

    separation: float
    age: float
    problem: str = ""
    sign_up: bool = False
    fresh: bool = True


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


NOBODY = Permit(industrial=True, separation=math.inf, cap=math.inf)
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

    def signal(self, belief: float) -> str:
        """What the mode light shows, one of `vocabulary.SIGNALS`."""
        if self.mode in (Mode.STOPPED, Mode.HOLD, Mode.INDUSTRIAL):
            return self.mode.name.lower()
        return "requested" if belief >= _UNDERSTOOD else "collaborative"


class PermitKeeper:
    """The permit over time: it is lost at once, and gained only when all was well for a while."""

    def __init__(self, config: CellConfig) -> None:
        self._config = config.separation
        self._floor, self._top = config.motion.collaborative_speed, config.motion.industrial_speed
        self._clear_since: float | None = None
        self._cap = self._floor
        self._risen_since: float | None = None

    def update(self, t: float, sensed: Sensed) -> Permit:
        """The permit at time t [s]."""
        problem = self._problem(sensed)
        if problem or sensed.sign_up:
            self._clear_since = None
        elif self._clear_since is None:
            self._clear_since = t
        waited = self._clear_since is not None and t - self._clear_since >= self._config.permit_hold
        blind = bool(sensed.problem) or sensed.age > self._config.max_age
        self._follow(
            t, self._floor if blind else allowed_speed(sensed.separation, self._config), sensed.fresh
        )
        reason = problem or (
            "a thumb is up" if sensed.sign_up else "" if waited else "not clear for long yet"
        )
        return Permit(waited, sensed.separation, self._cap, reason)

    def _problem(self, s: Sensed) -> str:
        if s.problem:
            return s.problem
        if s.age > self._config.max_age:
            return f"the person camera is {s.age:.2f} s old"
        if s.separation < self._config.permit:
            return f"a person is {s.separation:.2f} m away"
        return ""

    def _follow(self, t: float, allowed: float, fresh: bool) -> None:
        """Down at once; up by steps that last, so that the motion is not retimed at every frame."""
        allowed = float(min(max(allowed, self._floor), self._top))
        if allowed < self._cap - _FALLS or (allowed <= self._floor < self._cap):
            self._cap, self._risen_since = allowed, None
        elif allowed > self._cap + _RISES or (fresh and allowed >= self._top > self._cap):
            self._risen_since = t if self._risen_since is None else self._risen_since
            if t - self._risen_since >= _RISE_HOLD:
                self._cap, self._risen_since = allowed, None
        elif fresh:
            self._risen_since = None


def decide(
    config: MotionConfig,
    own_type: RobotType,
    permit: Permit,
    stopped: bool,
    waiting: bool = False,
    *,
    recovering: bool = False,
    operator: Operator | None = None,
) -> ModeState:
    """The mode that follows from the policy's request, the permit, a latched stop and a wait on the path.

    Args:
        recovering: the arm finds its way back after a stop. operator: may wish for a hold and a cap.
    """
    requested = own_type is RobotType.INDUSTRIAL
    if stopped:
        return ModeState(Mode.STOPPED, requested, permit.industrial, permit.separation, 0.0, "stop")
    industrial = requested and permit.industrial and not recovering
    mode = Mode.INDUSTRIAL if industrial else Mode.COLLABORATIVE
    mode_cap = config.industrial_speed if industrial else config.collaborative_speed
    # At or below the collaborative speed the arm's own force limiting is relied upon.
    separation_cap = max(permit.cap, config.collaborative_speed)
    cap = min(mode_cap, separation_cap)
    binding = mode.name.lower() if mode_cap <= separation_cap else "separation"
    if operator is not None and operator.cap < cap:
        cap, binding = operator.cap, "operator"
    if operator is not None and operator.hold:
        return ModeState(Mode.HOLD, requested, permit.industrial, permit.separation, cap, "operator")
    if waiting:
        return ModeState(Mode.HOLD, requested, permit.industrial, permit.separation, cap, "person in the way")
    if recovering:
        mode = Mode.RECOVERING
    return ModeState(mode, requested, permit.industrial, permit.separation, cap, binding)
