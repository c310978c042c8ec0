"""How the abstract state of the task moves by what really happened."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.decision import policy
from cell.decision.fsm import Task
from cell.decision.policy import possible_actions, states
from cell.decision.skills import Ended
from cell.wire.vocabulary import Action, EefLocation, OnionLocation, Prediction, RobotType

BLEMISHED, SOUND = Prediction.BLEMISHED, Prediction.UNBLEMISHED
FAILURES = ["missed_grasp", "lost_onion", "refused", "timeout", "no_path", "no_image", "unreachable"]
STATES = set(states(2))


def after(*steps: tuple[Action, Ended]) -> Task:
    task = Task()
    for action, ended in steps:
        task.apply(action, ended)
    return task


def where(task: Task) -> tuple[OnionLocation, EefLocation, Prediction]:
    return task.onion, task.eef, task.prediction


def test_a_sound_onion_goes_round_and_back_to_the_belt() -> None:
    task = Task()
    assert where(task) == (OnionLocation.UNKNOWN, EefLocation.AT_HOME, Prediction.UNKNOWN)
    task.apply(Action.DETECT, Ended("done", "", SOUND))
    assert where(task) == (OnionLocation.ON_CONVEYOR, EefLocation.AT_HOME, SOUND)
    task.apply(Action.PICK, Ended("done"))
    assert where(task) == (OnionLocation.AT_HOME, EefLocation.AT_HOME, SOUND)
    task.apply(Action.INSPECT, Ended("done", "", SOUND))
    assert where(task) == (OnionLocation.IN_FRONT, EefLocation.IN_FRONT, SOUND)
    task.apply(Action.PLACE_ON_CONVEYOR, Ended("done"))
    assert where(task) == (OnionLocation.UNKNOWN, EefLocation.ON_CONVEYOR, Prediction.UNKNOWN)
    assert (task.on_conveyor, task.in_bin) == (1, 0)


def test_inspection_overrules_what_was_seen_from_above() -> None:
    task = after(
        (Action.DETECT_PICK, Ended("done", "", SOUND)),
        (Action.INSPECT, Ended("done", "blemish seen", BLEMISHED)),
        (Action.PLACE_IN_BIN, Ended("done")),
    )
    assert where(task) == (OnionLocation.UNKNOWN, EefLocation.IN_BIN, Prediction.UNKNOWN)
    assert (task.on_conveyor, task.in_bin) == (0, 1)


@pytest.mark.parametrize("code", FAILURES)
@pytest.mark.parametrize(
    "action",
    [
        Action.DETECT,
        Action.DETECT_PICK,
        Action.PICK,
        Action.INSPECT,
        Action.PLACE_ON_CONVEYOR,
        Action.PLACE_IN_BIN,
    ],
)
def test_a_failed_action_sorts_nothing_and_leaves_nothing_in_focus(action: Action, code: str) -> None:
    task = after((Action.DETECT, Ended("done", "", BLEMISHED)), (action, Ended(code, "why")))
    assert where(task) == (OnionLocation.UNKNOWN, EefLocation.AT_HOME, Prediction.UNKNOWN)
    assert (task.on_conveyor, task.in_bin) == (0, 0)


def test_mode_changes_move_nothing_else() -> None:
    task = after((Action.DETECT, Ended("done", "", SOUND)))
    before = where(task)
    task.indicated = 0
    task.apply(Action.SPEED_UP, Ended("done"))
    assert (task.own_type, task.indicated, where(task)) == (RobotType.INDUSTRIAL, 1, before)
    task.apply(Action.SLOW_DOWN, Ended("done"))
    assert (task.own_type, task.indicated, where(task)) == (RobotType.COLLABORATIVE, 1, before)
    task.apply(Action.NO_OP, Ended("done"))
    assert where(task) == before


endings = st.one_of(
    st.sampled_from([BLEMISHED, SOUND]).map(lambda p: Ended("done", "", p)),
    st.sampled_from(FAILURES).map(Ended),
)


@given(st.lists(st.tuples(st.integers(0, 8), endings), max_size=30), st.integers(0, 1))
def test_every_state_that_can_come_up_is_in_the_policy_table(
    steps: list[tuple[int, Ended]], belief_bin: int
) -> None:
    """Whatever legal actions are taken and however they end, the table knows the state."""
    task = Task()
    for choice, ended in steps:
        legal = possible_actions(task.state(belief_bin))
        task.apply(legal[choice % len(legal)], ended)
        assert task.state(belief_bin) in STATES


@pytest.mark.parametrize("name", sorted(policy.shipped()))
@given(st.lists(endings, min_size=40, max_size=40), st.integers(0, 1))
def test_shipped_policies_never_stall(name: str, ends: list[Ended], belief_bin: int) -> None:
    """They need at most one mode change in a row and never wait."""
    table, task, still = policy.load(name), Task(), 0
    for ended in ends:
        action = table.action(task.state(belief_bin))
        change = action in (Action.NO_OP, Action.SPEED_UP, Action.SLOW_DOWN)
        still = still + 1 if change else 0
        assert still <= 1
        task.apply(action, Ended("done") if change else ended)
