"""What the person does, from where the working hand is: one of the domain's nine actions.

The place of the hand says most: low over the belt it picks or puts down, over the bin it drops,
raised before the body with an onion it inspects, empty it looks. Whether it holds something follows
from what it did before, as for somebody who watches. Only a recognised sign is a thumb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.config import CellConfig
from cell.frames import Array
from cell.perception.hand_regions import Region
from cell.perception.hands.gesture import Gesture
from cell.perception.person import PersonView
from cell.wire.vocabulary import Action

_LOW = 0.15
"""A hand lower than this over the belt works on it [m]."""
_BIN_MARGIN, _BIN_HEIGHT = 0.06, 0.30
"""A hand so near to the bin's opening and so low over it drops something [m]."""
_AWAY = 0.40
"""A trunk this far behind the working place is away [m]."""
_DWELL = 0.15
"""A hand that was low for less than this has not picked anything [s]."""
_STILL = 0.22
"""Slower than this the hand rests before the eyes [m/s]."""
_RAISED = 0.02
"""A hand higher than this over the hips may be before the eyes [m]."""
_SURE, _LIKELY, _GUESS = 0.95, 0.8, 0.6


@dataclass(frozen=True)
class ActionReading:
    """The action at time t [s], with confidence 0..1; `began` is when it was first seen [s]."""

    t: float
    action: Action
    confidence: float
    began: float


class HumanActions:
    """The person's action over time; one instance per round."""

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self._carrying = False
        self._low_since: float | None = None
        self._last_hand: tuple[float, Array] | None = None
        self.reading = ActionReading(0.0, Action.NO_OP, 0.0, 0.0)
        self.placed = 0

    @property
    def busy(self) -> bool:
        """The person holds an onion, as far as one can tell."""
        return self._carrying

    def update(self, view: PersonView) -> ActionReading:
        """Take in a frame's view."""
        action, confidence = self._judge(view)
        began = self.reading.began if action is self.reading.action else view.t
        self.reading = ActionReading(view.t, action, confidence, began)
        return self.reading

    def _judge(self, view: PersonView) -> tuple[Action, float]:
        if view.sign is not Gesture.NONE:
            return (Action.SPEED_UP if view.sign is Gesture.UP else Action.SLOW_DOWN), _SURE
        if view.problem:
            return Action.NO_OP, 0.0
        if self._away(view):
            self._carrying, self._low_since, self._last_hand = False, None, None
            return Action.NO_OP, _SURE
        hand = self._working_hand(view)
        if hand is None:
            self._leave_low(view.t)
            return (self.reading.action, _GUESS) if self._carrying else (Action.DETECT, _LIKELY)
        speed = self._speed(view.t, hand.p_W)
        return self._by_place(view.t, hand.p_W, speed)

    def _by_place(self, t: float, p: Array, speed: float) -> tuple[Action, float]:
        belt, strip = self._config.belt, self._config.person.sorted_x
        if self._over_bin(p):
            self._low_since = None
            if self._carrying or self.reading.action is Action.PLACE_IN_BIN:
                self._done()
                return Action.PLACE_IN_BIN, _SURE
            return Action.DETECT, _GUESS
        if p[0] < belt.x[1] + 0.02 and p[2] < belt.top_z + _LOW:
            if self._carrying and p[0] > strip[0] - 0.05:
                self._low_since = t if self._low_since is None else self._low_since
                return Action.PLACE_ON_CONVEYOR, _LIKELY
            if self.reading.action is Action.PLACE_ON_CONVEYOR:
                return Action.PLACE_ON_CONVEYOR, _LIKELY
            self._low_since = t if self._low_since is None else self._low_since
            return Action.PICK, _LIKELY
        self._leave_low(t)
        if self._carrying:
            if speed < _STILL and p[0] > belt.x[1] - 0.10 and p[2] > _RAISED:
                return Action.INSPECT, _LIKELY
            return (
                self.reading.action if self.reading.action is not Action.DETECT else Action.INSPECT
            ), _GUESS
        return Action.DETECT, _LIKELY

    def _leave_low(self, t: float) -> None:
        """The hand is not low over the belt any more: it has picked, or put down."""
        if self._low_since is not None and t - self._low_since >= _DWELL:
            if self.reading.action is Action.PLACE_ON_CONVEYOR:
                self._done()
            else:
                self._carrying = True
        self._low_since = None

    def _done(self) -> None:
        if self._carrying:
            self.placed += 1
        self._carrying = False

    def _over_bin(self, p: Array) -> bool:
        b = self._config.person.bin
        inside = np.all(np.abs(p[:2] - b.center[:2]) < np.array(b.size[:2]) / 2 + _BIN_MARGIN)
        return bool(inside and p[2] < b.center[2] + _BIN_HEIGHT)

    def _away(self, view: PersonView) -> bool:
        p = view.cloud.p_WP
        if len(p) < 30:
            return True
        return bool(np.median(p[:, 0]) > self._config.person.station[0] + _AWAY)

    def _working_hand(self, view: PersonView) -> Region | None:
        """The end of the arm that reaches farthest towards the robot, or into the bin."""
        return min(view.regions, key=lambda r: float(r.p_W[0])) if view.regions else None

    def _speed(self, t: float, p: Array) -> float:
        last, self._last_hand = self._last_hand, (t, p)
        if last is None or not 0.0 < t - last[0] < 0.5:
            return 0.0
        return float(np.linalg.norm(p - last[1]) / (t - last[0]))
