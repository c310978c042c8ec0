"""A motion under way: followed, retimed when the cap changes, held while a person is in the way.

Every change is planned for the state a little ahead of now and starts there: the node swaps to it
only where position and speed match. A change that comes too late is planned again, farther ahead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cell.config import CellConfig
from cell.decision.io import Inputs
from cell.frames import Array
from cell.motion.retiming import resume, retime, stop_on_path
from cell.motion.timing import TimedPath
from cell.wire.types import Reply, Trajectory

_SAME_CAP = 1e-6
_LONGEST_LEAD = 0.4
"""A change is planned at most this far ahead [s]; how far is learnt from what the node refuses."""
_LAST = 0.06
"""A motion that ends within this is left as it is [s]."""
_CLEAR_FOR = 0.2
"""The way must have been clear for so long before the arm goes on [s]."""

Obstructed = Callable[[Array], bool]
"""Whether a motion through configurations (N, 6) [rad] would come too near to a person."""


@dataclass
class Lead:
    """How far ahead a change is planned [s]; grows when the node says that it came too late."""

    start: float
    value: float

    def late(self) -> None:
        self.value = min(2.0 * self.value, _LONGEST_LEAD)

    def in_time(self) -> None:
        self.value = max(self.start, 0.9 * self.value)


@dataclass(frozen=True)
class _Change:
    """A replacement that was sent: its plan, when it starts, and whether the arm is to wait at its end."""

    ticket: int
    number: int
    timed: TimedPath
    start: float
    holds: bool


class Following:
    """One motion from its acceptance on. Pure: told the inputs, it says what to send.

    Args:
        timed: the accepted plan. number: of its trajectory. start: node time of its start [s].
        cap: under which it was planned [m/s].

    Attributes:
        waiting: the arm rests on its path because a person is in the way, since `since` [s].
        timed: the plan in force.
    """

    def __init__(
        self, config: CellConfig, timed: TimedPath, number: int, start: float, cap: float, lead: Lead
    ) -> None:
        self._config, self._lead = config, lead
        self.timed, self._number, self._start, self._cap = timed, number, start, cap
        self._full = timed
        self._change: _Change | None = None
        self._holds = False
        self._clear_since: float | None = None
        self.waiting = False
        self.since = 0.0

    # -- what the skill asks ------------------------------------------------------------------------

    def ended(self, inputs: Inputs) -> bool:
        """The arm has arrived at the end of the whole motion."""
        return self._at_end(inputs) and not self._holds

    def note(self, inputs: Inputs) -> None:
        """Take in the arm's progress and the reply to a change."""
        arm = inputs.arm
        if self._change is not None:
            for ticket, reply in inputs.replies:
                if ticket == self._change.ticket:
                    self._answered(reply)
                    break
        duration = self._wire_duration(self.timed)
        if arm.trajectory_id == self._number and arm.moving and 0.0 < arm.progress < 1.0:
            self._start = arm.t - arm.progress * duration
        if self._holds and self._at_end(inputs) and not self.waiting:
            self.waiting, self.since, self._clear_since = True, inputs.t, None

    def change(
        self, inputs: Inputs, cap: float, obstructed: Obstructed, horizon: float
    ) -> tuple[TimedPath, float, bool] | None:
        """The replacement that is due now: its plan, start (0 from rest) and whether the arm waits after it.

        Args:
            cap: TCP speed cap now in force [m/s]. obstructed: see `Obstructed`.
            horizon: how far ahead a person may be in the way [s].
        """
        if self._change is not None:
            return None
        if self.waiting:
            return self._going_on(inputs.t, cap, obstructed, horizon)
        at = inputs.t + self._lead.value - self._start
        left = self.timed.duration - at
        if self._holds or left <= 0.0:
            return None
        if obstructed(self._ahead(at, horizon)):
            return stop_on_path(self.timed, at, self._config), self._start + at, True
        if abs(cap - self._cap) > _SAME_CAP and left > _LAST:
            self._cap = cap
            return retime(self.timed, at, cap, self._config), self._start + at, False
        return None

    def sent(self, ticket: int, number: int, timed: TimedPath, start: float, holds: bool) -> None:
        """The replacement was sent as trajectory `number`."""
        self._change = _Change(ticket, number, timed, start, holds)

    def q_end(self) -> Array:
        """Joint angles (6,) [rad] where the plan in force ends."""
        out: Array = self.timed.path(self.timed.s[-1:])[0]
        return out

    def stop_here(self, inputs: Inputs) -> tuple[TimedPath, float, bool] | None:
        """The replacement that stops on the path as soon as the joints allow; None when it is under way."""
        if self._change is not None or self._holds:
            return None
        at = inputs.t + self._lead.value - self._start
        if at >= self.timed.duration:
            return None
        return stop_on_path(self.timed, at, self._config), self._start + at, True

    def longest(self) -> float:
        """Time that what is left may take [s], from now on."""
        rest = (self._full if self._holds else self.timed).duration
        if self._change is not None:  # under a lower cap it takes longer than what it replaces
            rest = max(rest, self._change.timed.duration)
        return self._config.separation.patience + rest + self._lead.value

    # -- internals --------------------------------------------------------------------------------------

    def _answered(self, reply: Reply) -> None:
        change, self._change = self._change, None
        assert change is not None
        if not reply.accepted:
            self._cap = -1.0  # not in force: plan it again
            self._lead.late()
            return
        self._lead.in_time()
        self.timed, self._number, self._start = change.timed, change.number, change.start
        self._holds, self.waiting = change.holds, False
        if not change.holds:
            self._full = change.timed

    def _at_end(self, inputs: Inputs) -> bool:
        return self._change is None and inputs.arm.trajectory_id == self._number and not inputs.arm.moving

    def _going_on(
        self, now: float, cap: float, obstructed: Obstructed, horizon: float
    ) -> tuple[TimedPath, float, bool] | None:
        """From rest on the path, once the way has been clear for a while."""
        s = float(self.timed.s[-1])
        rest = resume(self._full, s, cap, self._config)
        q = rest.path(np.linspace(s, float(rest.s[-1]), 12))
        if obstructed(q[: max(2, int(np.ceil(12 * min(1.0, horizon / max(rest.duration, 1e-6)))))]):
            self._clear_since = None
            return None
        self._clear_since = now if self._clear_since is None else self._clear_since
        if now - self._clear_since < _CLEAR_FOR:
            return None
        self._cap = cap
        return rest, 0.0, False

    def _ahead(self, at: float, horizon: float) -> Array:
        """Configurations (N, 6) on the way of the next `horizon` seconds from time `at` [s] of the plan."""
        times = np.linspace(at, min(at + horizon, self.timed.duration), 8)
        return self.timed.sample(times)[0]

    def _wire_duration(self, timed: TimedPath) -> float:
        period = self._config.arm.control_period
        return period * max(1, int(np.ceil(timed.duration / period - 1e-9)))


def trajectory(
    timed: TimedPath, number: int, holder: str, start: float, expires: float, period: float
) -> Trajectory:
    """The plan as it goes to the node."""
    times, q, qd = timed.to_points(period)
    return Trajectory(number, holder, start, expires, times, q, qd)
