"""Calibration: what is measured comes back as durations, and the task then predicts the rounds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cell.errors import ConfigError
from cell.trials.campaign import Campaign, Results, read
from cell.trials.schedule import schedule
from cell.wire.vocabulary import Action
from tests.trials.made import Made, settings

pytest.importorskip("torch")

from cell.learn.domain.presets import preset
from cell.learn.domain.semi_markov import load_durations
from cell.trials import calibrate, predict


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Two people, two rounds, made up."""
    folder = tmp_path_factory.mktemp("campaign")
    chosen = settings(who="2", rounds=2)
    Campaign(folder, chosen).run(schedule(chosen), Made(), False, lambda record: None)
    return read(folder)


def test_measured_durations_are_those_of_the_rounds_and_read_back(results: Results, tmp_path: Path) -> None:
    measured = calibrate.measure(results)
    file = tmp_path / "durations.csv"
    file.write_text(calibrate.to_csv(measured, "a test"))
    back = load_durations(file)
    assert np.allclose(back, measured.seconds, atol=1e-3)
    robot = back[0, 0]  # the made-up robot: look 0.48 s, pick 3 s, inspect 4.4 s, bin 2.4 s
    assert robot[Action.PICK] == pytest.approx(3.0, rel=0.08)
    assert robot[Action.INSPECT] == pytest.approx(4.4, rel=0.08)
    assert robot[Action.PLACE_IN_BIN] == pytest.approx(2.4, rel=0.08)
    assert back[1, 0, Action.INSPECT] == pytest.approx(2.0, rel=0.08)
    assert measured.recovery == pytest.approx(24.0, abs=0.2)
    assert back[1, 0, Action.SLOW_DOWN] == pytest.approx(3.0, abs=0.2)
    assert "Not measured, scaled: robot collaborative detect_pick" in file.read_text()


def test_the_task_predicts_a_round_whose_answer_is_known(tmp_path: Path) -> None:
    """A robot alone in effect: the person's actions last for ever, so that the robot sorts all."""
    seconds = load_durations()
    seconds[0] = 1.0
    seconds[1] = 500.0
    measured = calibrate.Measured(seconds, np.ones_like(seconds), 25.0, 0.0, 1)
    file = tmp_path / "durations.csv"
    file.write_text(calibrate.to_csv(measured, "a test"))
    rules = replace(preset("cell"), durations=str(file), p_blemished=1.0, p_visible=1.0, misread_actions=0.0)
    who = settings(who="1", rounds=2).contenders[1]
    times, by_human = predict.sort_times(rules, who, predict._bank(rules, "none"), 4, episodes=20)
    # the person holds the second onion; the robot needs 3 s for each of three: detect, pick, bin
    assert (by_human <= 1).all()
    assert np.median(times) == pytest.approx(1500.0, rel=0.1)
    alone, _ = predict.sort_times(rules, who, predict._bank(rules, "none"), 1, episodes=20)
    assert np.median(alone) == pytest.approx(3.0, abs=0.2)


def test_a_campaign_without_rests_says_what_to_do(tmp_path: Path) -> None:
    chosen = settings(who="1", rounds=2)
    Campaign(tmp_path, chosen).run(schedule(chosen), Made(), False, lambda record: None)
    found = read(tmp_path)
    for record in found.records:
        record["durations"]["rests"] = []
    with pytest.raises(ConfigError, match="nobody rested"):
        calibrate.measure(found)
    with pytest.raises(ConfigError, match="no finished round"):
        calibrate.measure(replace(found, records=[]))


def test_the_whole_chain_writes_policies_that_the_robot_can_load(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cell.decision.policy import load

    monkeypatch.setattr(calibrate, "METHODS", ("dec-airl",))  # the other takes the same way
    said: list[str] = []
    found = calibrate.calibrate(results, tmp_path, seed=1, iterations=1, say=said.append, episodes=20)
    assert {row["policy"] for row in found["rows"]} == {"tb", "dec"}
    for method in calibrate.METHODS:
        assert load(str(tmp_path / method / "robot.csv")).actions
    assert (tmp_path / calibrate.PREDICTIONS).is_file() and len(said) == 1 + len(calibrate.METHODS)
