"""The belief while the robot works: the same numbers as in training, without torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cell.decision.belief import Gru, LastGesture, make_belief
from cell.errors import ConfigError
from cell.learn.belief.gru import GruBelief
from cell.learn.belief.store import load, shipped
from cell.wire.vocabulary import Action

UP, DOWN = Action.SPEED_UP, Action.SLOW_DOWN
WORK = [Action.DETECT, Action.PICK, Action.INSPECT, Action.PLACE_IN_BIN]


@pytest.mark.parametrize("preset", ["paper", "cell"])
def test_the_network_says_what_it_said_in_training(preset: str) -> None:
    actions = np.random.default_rng(1).integers(0, 9, 60)
    learnt, online = GruBelief(load(preset)), Gru(shipped(preset, "announced"))
    assert online.value == pytest.approx(float(learnt.reset(1)[0]), abs=1e-6)
    for action in actions:
        expected = float(learnt.update(np.array([action], np.int8))[0])
        assert online.observe(Action(int(action))) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("name", ["gru", "last-gesture"])
def test_it_rises_with_the_thumb_down_and_falls_with_the_thumb_up(name: str) -> None:
    belief = make_belief(name)
    for action in WORK:
        belief.observe(action)
    assert belief.value < 0.2
    for _ in range(3):
        belief.observe(DOWN)
    assert belief.value > 0.8
    for _ in range(10):
        belief.observe(Action.NO_OP)
    assert belief.value > 0.8
    for action in [UP, UP, *WORK]:
        belief.observe(action)
    assert belief.value < 0.2


def test_work_does_not_change_what_was_told() -> None:
    belief = LastGesture()
    belief.observe(DOWN)
    for action in WORK:
        assert belief.observe(action) == 1.0


def test_unknown_names_and_bad_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"gru, last-gesture"):
        make_belief("crystal ball")
    with pytest.raises(ConfigError, match="cannot read"):
        make_belief(str(tmp_path / "none.safetensors"))
    bad = tmp_path / "bad.safetensors"
    bad.write_bytes(b"\x08\0\0\0\0\0\0\0{}      ")
    with pytest.raises(ConfigError, match="does not hold belief weights"):
        make_belief(str(bad))
