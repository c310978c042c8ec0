"""The task's abstract state and how the outcome of each action moves it."""

from __future__ import annotations

from dataclasses import dataclass

from cell.decision.policy import State
from cell.decision.skills import Ended
from cell.wire.vocabulary import Action, EefLocation, OnionLocation, Prediction, RobotType


@dataclass
class Task:
    """The robot's local state of the sorting domain, and what it has sorted."""

    onion: OnionLocation = OnionLocation.UNKNOWN
    eef: EefLocation = EefLocation.AT_HOME
    prediction: Prediction = Prediction.UNKNOWN
    own_type: RobotType = RobotType.COLLABORATIVE
    indicated: int = 1
    in_bin: int = 0
    on_conveyor: int = 0

    def state(self, belief_bin: int) -> State:
        """The state under which the policy is asked."""
        return State(self.onion, self.eef, self.prediction, self.own_type, self.indicated, belief_bin)

    def apply(self, action: Action, ended: Ended) -> None:
        """Move by what happened. A failed action leaves nothing in focus and an empty hand."""
        if action is Action.SPEED_UP:
            self.own_type, self.indicated = RobotType.INDUSTRIAL, 1
        elif action is Action.SLOW_DOWN:
            self.own_type, self.indicated = RobotType.COLLABORATIVE, 1
        elif action is not Action.NO_OP:
            if ended.done:
                self._succeed(action, ended)
            else:
                self._focus(OnionLocation.UNKNOWN, EefLocation.AT_HOME, Prediction.UNKNOWN)

    def _succeed(self, action: Action, ended: Ended) -> None:
        if action is Action.DETECT:
            self._focus(OnionLocation.ON_CONVEYOR, EefLocation.AT_HOME, ended.prediction)
        elif action is Action.DETECT_PICK:
            self._focus(OnionLocation.AT_HOME, EefLocation.AT_HOME, ended.prediction)
        elif action is Action.PICK:
            self._focus(OnionLocation.AT_HOME, EefLocation.AT_HOME, self.prediction)
        elif action is Action.INSPECT:
            self._focus(OnionLocation.IN_FRONT, EefLocation.IN_FRONT, ended.prediction)
        elif action is Action.PLACE_ON_CONVEYOR:
            self._focus(OnionLocation.UNKNOWN, EefLocation.ON_CONVEYOR, Prediction.UNKNOWN)
            self.on_conveyor += 1
        elif action is Action.PLACE_IN_BIN:
            self._focus(OnionLocation.UNKNOWN, EefLocation.IN_BIN, Prediction.UNKNOWN)
            self.in_bin += 1

    def _focus(self, onion: OnionLocation, eef: EefLocation, prediction: Prediction) -> None:
        self.onion, self.eef, self.prediction = onion, eef, prediction
