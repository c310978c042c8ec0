"""The hand-coded expert: the sorting rules of the published domain as a policy table.

`tools/write_policies` writes these tables to the CSV files that are shipped.
"""

from __future__ import annotations

from cell.decision.policy import State, states
from cell.wire.vocabulary import Action, OnionLocation, Prediction, RobotType

BELIEF_BINS = (0.0, 0.5, 1.0)
"""Two bins: the person is probably unfatigued, probably fatigued."""


def adaptive(state: State) -> Action:
    """Sort; work in industrial mode while the person is believed to be fatigued."""
    if not state.indicated:
        return _announce(state)
    wanted = RobotType.INDUSTRIAL if state.belief_bin == 1 else RobotType.COLLABORATIVE
    if state.own_type is RobotType.INDUSTRIAL and wanted is RobotType.COLLABORATIVE:
        return Action.SLOW_DOWN  # at once, whatever is in the hand
    if state.own_type is not wanted and state.onion is OnionLocation.UNKNOWN:
        return Action.SPEED_UP
    return _sort(state)


def always_industrial(state: State) -> Action:
    """Sort, always in industrial mode (as far as separation permits it)."""
    return Action.SPEED_UP if state.own_type is RobotType.COLLABORATIVE else _sort(state)


def always_collaborative(state: State) -> Action:
    """Sort, always in collaborative mode."""
    return Action.SLOW_DOWN if state.own_type is RobotType.INDUSTRIAL else _sort(state)


EXPERTS = {
    "expert": adaptive,
    "always-industrial": always_industrial,
    "always-collaborative": always_collaborative,
}
"""Shipped policies by name."""


def table(name: str) -> dict[State, Action]:
    """The whole table of one expert."""
    rule = EXPERTS[name]
    return {state: rule(state) for state in states(len(BELIEF_BINS) - 1)}


def _announce(state: State) -> Action:
    """A change of the partner's type that was not answered yet: answer it."""
    return Action.SPEED_UP if state.own_type is RobotType.COLLABORATIVE else Action.SLOW_DOWN


def _sort(state: State) -> Action:
    blemished = state.prediction is Prediction.BLEMISHED
    if state.onion is OnionLocation.UNKNOWN:
        fast = state.own_type is RobotType.INDUSTRIAL
        return Action.DETECT_PICK if fast else Action.DETECT
    if state.onion is OnionLocation.ON_CONVEYOR:
        return Action.PICK
    if blemished:
        return Action.PLACE_IN_BIN
    return Action.INSPECT if state.onion is OnionLocation.AT_HOME else Action.PLACE_ON_CONVEYOR
