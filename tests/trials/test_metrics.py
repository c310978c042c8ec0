"""Figures of a round from logs made by hand, in which every answer is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.config import load
from cell.trials import metrics
from cell.trials.durations import durations
from cell.trials.log import SIGNS, Log, read_log, segments
from cell.wire.types import ShownGesture
from cell.wire.vocabulary import Action, Mode

STEP = 0.04


def log(seconds: float, gestures: tuple[ShownGesture, ...] = (), **changes: Any) -> Log:
    """A round in which nothing happens, and then `changes`: (value, from, to) per column [s]."""
    n = round(seconds / STEP)
    columns = {
        name: np.zeros(n)
        for name in ("speed", "requested", "permitted", "belief", "robot", "human_seen", "sign_seen",
                     "robot_moving", "sorted", "own_type", "human", "sign", "fatigued")
    }  # fmt: skip
    columns["t"] = 1.0 + STEP * np.arange(n)
    columns |= {"cap": np.full(n, 0.25), "mode": np.full(n, float(Mode.COLLABORATIVE))}
    columns |= {"separation": np.full(n, 0.5), "true_separation": np.full(n, 0.5)}
    for name, spans in changes.items():
        for value, a, b in spans:
            columns[name][(columns["t"] >= a - 1e-6) & (columns["t"] < b - 1e-6)] = value
    return Log(columns, gestures)


def test_fluency_of_two_agents_that_take_turns() -> None:
    t = STEP * np.arange(1000)  # 40 s
    robot, human = (t < 10.0), (t >= 15.0) & (t < 25.0)
    robot = robot | (t >= 30.0)
    found = metrics.fluency(robot, human, t)
    assert found["robot_idle"] == pytest.approx(0.5) and found["human_idle"] == pytest.approx(0.75)
    assert found["concurrent"] == 0.0
    assert found["functional_delay_share"] == pytest.approx(10.0 / 40.0, abs=0.01)


def test_working_at_once_is_concurrent_and_a_pause_of_ones_own_is_no_functional_delay() -> None:
    t = STEP * np.arange(100)
    assert metrics.fluency(t >= 0, t < 2.0, t)["concurrent"] == pytest.approx(0.5)
    pause = (t < 1.0) | (t >= 2.0)
    assert metrics.fluency(pause, np.zeros(100, bool), t)["functional_delay_share"] == 0.0


def test_delays_count_from_the_sign_and_a_mode_that_ended_before_costs_none() -> None:
    signs = (ShownGesture("down", 5.0, 6.0), ShownGesture("up", 20.0, 21.5))
    made = log(
        30.0, signs,
        requested=[(1, 5.6, 20.4)], mode=[(Mode.INDUSTRIAL, 8.0, 18.0)],
        sign_seen=[(SIGNS["down"], 5.4, 6.0), (SIGNS["up"], 20.4, 21.0)],
    )  # fmt: skip
    found = metrics.delays(made)
    assert found["down_to_request_s"] == pytest.approx(0.6, abs=STEP)
    assert found["down_to_industrial_s"] == pytest.approx(3.0, abs=STEP)
    assert found["down_to_answer_s"] == pytest.approx(1.0)
    assert found["up_to_answer_s"] == pytest.approx(1.5) and found["up_to_slow_s"] == 0.0
    assert metrics.signs(made)["delay_s"] == pytest.approx([0.4, 0.4], abs=STEP)


def test_a_missed_a_swapped_and_a_false_sign_are_told_apart() -> None:
    signs = (ShownGesture("down", 5.0, -1.0), ShownGesture("up", 40.0, 41.0))
    made = log(60.0, signs, sign_seen=[(SIGNS["down"], 40.2, 40.5), (SIGNS["up"], 55.0, 55.5)])
    found = metrics.signs(made)
    assert (found["shown"], found["missed"], found["swapped"], found["false"]) == (2, 2, 1, 1)


def test_speed_over_a_cap_counts_only_after_the_braking() -> None:
    config = load()
    braking = log(5.0, cap=[(1.0, 0, 3.0)], speed=[(0.9, 0, 3.4)])
    assert metrics.over(braking, braking["cap"]) == 0
    late = log(5.0, cap=[(1.0, 0, 3.0)], speed=[(0.9, 0, 4.0)])
    assert 8 <= metrics.over(late, late["cap"]) <= 11
    near = log(5.0, cap=[(1.0, 0, 9)], speed=[(0.9, 2.0, 5.0)])
    assert metrics.figures(near, config)["over_permitted_ticks"] > 60


def test_where_the_time_of_a_rest_went() -> None:
    made = log(
        40.0, fatigued=[(1, 5.0, 30.0)], human=[(Action.SLOW_DOWN, 6.0, 8.0), (Action.SPEED_UP, 33.0, 35.0)],
        true_separation=[(1.6, 10.0, 32.0)], mode=[(Mode.INDUSTRIAL, 11.0, 32.0)], cap=[(0.9, 11.0, 32.0)],
    )  # fmt: skip
    found = metrics.breakdown(made, load())
    assert found["rests"] == 1 and found["fatigued_s"] == pytest.approx(25.0, abs=0.1)
    assert found["showing_s"] == pytest.approx(4.0, abs=0.1)
    assert found["away_not_industrial_s"] == pytest.approx(1.0, abs=0.1)
    assert found["cap_industrial_m_s"] == pytest.approx(0.9)


def test_a_round_without_a_person_says_so_and_fails_nothing() -> None:
    made = log(10.0)
    bare = Log(
        {k: v for k, v in made.columns.items() if k not in ("human", "sign", "fatigued", "true_separation")}
    )
    found = metrics.figures(bare, load())
    assert found["over_permitted_ticks"] is None and "fluency" not in found
    assert "human" not in durations(bare)


def test_time_of_failed_tries_belongs_to_the_actions_that_worked() -> None:
    robot = [
        (Action.DETECT, 1.0, 2.0), (Action.PICK, 2.0, 5.0),  # missed
        (Action.DETECT, 5.0, 6.0), (Action.PICK, 6.0, 9.0), (Action.INSPECT, 9.0, 13.0),
        (Action.PLACE_IN_BIN, 13.0, 15.0), (Action.DETECT, 15.0, 17.0),
    ]  # fmt: skip
    found = durations(log(16.0, robot=robot, sorted=[(1, 15.0, 20.0)]))
    table = found["robot"]["collaborative"]
    assert table["pick"] == pytest.approx([6.0, 1.0], abs=0.1)
    assert table["detect"] == pytest.approx([4.0, 2.0], abs=0.1)
    assert table["place_in_bin"] == pytest.approx([2.0, 1.0], abs=0.1)
    assert found["overhead"]["after"] == pytest.approx(2.0, abs=0.1)
    assert found["robot"]["industrial"] == {}


def test_a_rest_is_measured_from_tired_to_rested_and_its_signs_beside() -> None:
    human = [
        (Action.DETECT, 1.0, 2.0), (Action.PICK, 2.0, 3.0), (Action.INSPECT, 3.0, 5.0),
        (Action.PLACE_IN_BIN, 5.0, 6.0), (Action.NO_OP, 6.0, 7.0), (Action.SLOW_DOWN, 7.0, 9.0),
        (Action.NO_OP, 9.0, 28.0), (Action.SPEED_UP, 28.0, 30.0), (Action.DETECT, 30.0, 35.0),
    ]  # fmt: skip
    found = durations(log(34.0, human=human, fatigued=[(1, 6.0, 25.0)]))
    assert found["rests"] == [
        pytest.approx({"recovery": 19.0, "thumbs_down": 3.0, "thumbs_up": 5.0}, abs=0.1)
    ]
    assert found["human"]["detect"] == pytest.approx([1.0, 1.0], abs=0.05)  # the last was only looking out
    assert found["human"]["inspect"] == pytest.approx([2.0, 1.0], abs=0.05)


def test_a_person_who_looks_out_for_work_that_does_not_come_is_idle() -> None:
    human = [(Action.DETECT, 1.0, 3.0), (Action.PICK, 3.0, 5.0), (Action.DETECT, 5.0, 11.0)]
    made = log(10.0, human=human, robot_moving=[(1, 0, 99)])
    found = metrics.figures(made, load())
    assert found["fluency"]["human_idle"] == pytest.approx(0.6, abs=0.01)
    assert found["breakdown"]["waiting_s"] == pytest.approx(6.0, abs=0.1)


def test_segments_are_whole_and_in_order() -> None:
    assert segments(np.array([2.0, 2.0, 1.0, 2.0])) == [(2, 0, 2), (1, 2, 3), (2, 3, 4)]


def test_a_log_comes_back_from_its_file(tmp_path: Path) -> None:
    made = log(3.0, (ShownGesture("up", 1.5, -1.0),), speed=[(0.2, 2.0, 3.0)])
    (tmp_path / "x.npz").write_bytes(made.to_bytes())
    back = read_log(tmp_path / "x.npz")
    assert back.gestures == made.gestures
    assert all(np.allclose(back[k], made[k], atol=1e-5) for k in made.columns)


def test_a_log_keeps_the_times_of_a_wall_clock(tmp_path: Path) -> None:
    made = log(3.0)
    made.columns["t"] += 1.8e9
    (tmp_path / "x.npz").write_bytes(made.to_bytes())
    assert np.array_equal(read_log(tmp_path / "x.npz")["t"], made["t"])
