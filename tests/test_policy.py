"""Policy tables: the shipped ones load, the expert follows the published rules, bad files are named."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.decision import expert, policy
from cell.decision.policy import State
from cell.errors import PolicyError
from cell.wire.vocabulary import Action, EefLocation, OnionLocation, Prediction, RobotType

TEXT = policy.shipped()["expert"].read_text()


def state(
    onion: str, eef: str, prediction: str, own_type: int = 0, belief_bin: int = 0, indicated: int = 1
) -> State:
    return State(
        OnionLocation[onion],
        EefLocation[eef],
        Prediction[prediction],
        RobotType(own_type),
        indicated,
        belief_bin,
    )


def test_there_are_sixteen_valid_triples() -> None:
    # The published environment has 16 valid (onion, eef, prediction) triples.
    assert len({s[:3] for s in policy.states(2)}) == 16
    assert len(list(policy.states(2))) == 16 * 2 * 2 * 2


@pytest.mark.parametrize("name", sorted(expert.EXPERTS))
def test_the_shipped_files_are_the_experts(name: str) -> None:
    assert policy.load(name).actions == expert.table(name)


@pytest.mark.parametrize(
    ("where", "action"),
    [
        (state("UNKNOWN", "AT_HOME", "UNKNOWN"), Action.DETECT),
        (state("UNKNOWN", "AT_HOME", "UNKNOWN", own_type=1, belief_bin=1), Action.DETECT_PICK),
        (state("ON_CONVEYOR", "AT_HOME", "BLEMISHED"), Action.PICK),
        (state("AT_HOME", "AT_HOME", "UNBLEMISHED"), Action.INSPECT),
        (state("AT_HOME", "AT_HOME", "BLEMISHED"), Action.PLACE_IN_BIN),
        (state("IN_FRONT", "IN_FRONT", "UNBLEMISHED"), Action.PLACE_ON_CONVEYOR),
        (state("IN_FRONT", "IN_FRONT", "BLEMISHED"), Action.PLACE_IN_BIN),
        (state("UNKNOWN", "IN_BIN", "UNKNOWN", own_type=0, indicated=0), Action.SPEED_UP),
        (state("UNKNOWN", "IN_BIN", "UNKNOWN", own_type=1, indicated=0), Action.SLOW_DOWN),
    ],
)
def test_the_expert_follows_the_published_rules(where: State, action: Action) -> None:
    assert policy.load("expert").action(where) is action


def test_belief_chooses_the_bin() -> None:
    table = policy.load("expert")
    assert [table.belief_bin(b) for b in (0.0, 0.49, 0.5, 1.0)] == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: "\n".join(t.splitlines()[:-1]), "no row for"),
        (lambda t: t.replace("onion_location", "onions", 1), "header must be"),
        (lambda t: t + t.splitlines()[-1] + "\n", "second row"),
        (lambda t: t.replace(",detect,", ",fly,", 1), "legal values"),
        (lambda t: t.replace("belief_bins=0,0.5,1", "belief_bins=0,2"), "belief_bins"),
        (lambda t: t.replace(",0,1,0,0,0,0,0,0,0", ",0,1,1,0,0,0,0,0,0", 1), "probabilities"),
        (lambda t: t.replace(",0,1,0,0,0,0,0,0,0", ",0,nan,0,0,0,0,0,0,0", 1), "probabilities"),
        (lambda t: "", "header"),
    ],
)
def test_a_bad_table_is_refused_in_one_line(change: object, words: str) -> None:
    with pytest.raises(PolicyError, match=words) as caught:
        policy.parse(change(TEXT), "test")  # type: ignore[operator]
    assert "\n" not in str(caught.value)


def test_a_missing_file_lists_the_shipped_policies(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="always-industrial"):
        policy.load(str(tmp_path / "absent.csv"))


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=400))
def test_garbage_never_raises_anything_else(text: str) -> None:
    with pytest.raises(PolicyError):
        policy.parse(text, "fuzz")


@settings(max_examples=100, deadline=None)
@given(st.integers(0, len(TEXT) - 1), st.characters())
def test_a_flipped_character_is_refused_or_harmless(at: int, character: str) -> None:
    with contextlib.suppress(PolicyError):
        policy.parse(TEXT[:at] + character + TEXT[at + 1 :], "fuzz")
