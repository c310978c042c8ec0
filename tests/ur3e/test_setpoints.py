"""Between the node's set-points: on the path, past the newest one, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.limits import Q_MAX, QD_MAX, hermite
from hil.ur3e.setpoints import PLAY_DELAY, SetPoints
from tests.test_executor import PERIOD, smooth

START = (0.0,) * 6
joint = st.floats(-3.0, 3.0)


def points() -> SetPoints:
    return SetPoints(tuple(Q_MAX.tolist()), tuple(QD_MAX.tolist()))  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_trajectory_is_followed_between_its_set_points(seed: int) -> None:
    order = smooth(seed)
    p = points()
    begin = tuple(order.q[0].tolist())
    worst, t0 = 0.0, 50.0
    for k in range(1, round(order.times[-1] / PERIOD)):
        q, qd, _ = hermite(order.times, order.q, order.qd, k * PERIOD)
        assert p.push(t0 + k * PERIOD, tuple(q.tolist()), tuple(qd.tolist()), begin) == ""
        for part in range(4):  # the node is half a period late
            t = (k - 0.5) * PERIOD + part * 0.002
            want = hermite(order.times, order.q, order.qd, max(t - PLAY_DELAY, PERIOD))[0]
            worst = max(worst, float(np.abs(np.array(p.at(t0 + t)) - want).max()))
    assert worst < 5e-4


def test_past_the_newest_the_arm_goes_on_at_its_speed() -> None:
    p = points()
    p.push(1.0, START, (0.5,) * 6, START)
    p.push(1.008, (0.004,) * 6, (0.5,) * 6, START)
    assert p.at(1.008 + PLAY_DELAY + 0.010) == pytest.approx((0.009,) * 6)
    assert p.at(0.9) == START


@given(st.tuples(*[joint] * 6))
def test_a_first_set_point_must_lie_where_the_arm_is(q: tuple[float, ...]) -> None:
    problem = points().push(1.0, q, START, START)  # type: ignore[arg-type]
    assert bool(problem) == (max(map(abs, q)) > 0.02)


@pytest.mark.parametrize(
    ("t", "q", "qd", "words"),
    [
        (1.008, (0.0, 0.0, 0.5, 0.0, 0.0, 0.0), START, "joint 3 is told to jump by 0.500 rad in 8 ms"),
        (1.008, (0.0, 0.0, 3.3, 0.0, 0.0, 0.0), START, "joint 3 is told to go to 3.300 rad"),
        (1.008, START, (0.0, 4.0, 0.0, 0.0, 0.0, 0.0), "joint 2 is told to move at 4.00 rad/s"),
        (1.008, (float("nan"),) * 6, START, "not finite"),
        (float("inf"), START, START, "not finite"),
    ],
)
def test_what_no_node_means_is_refused(
    t: float, q: tuple[float, ...], qd: tuple[float, ...], words: str
) -> None:
    p = points()
    assert p.push(1.0, START, START, START) == ""
    assert words in p.push(t, q, qd, START)  # type: ignore[arg-type]


def test_all_zeros_far_from_the_arm_are_refused() -> None:
    home = (-0.95, -1.71, -2.34, -0.66, 1.57, -0.90)
    p = points()
    assert p.push(1.0, home, START, home) == ""
    assert "jump" in p.push(1.008, START, START, home)


def test_a_repeated_set_point_changes_nothing_and_none_is_an_error() -> None:
    p = points()
    with pytest.raises(ValueError, match="no set-point"):
        p.at(1.0)
    p.push(1.0, START, START, START)
    assert p.push(1.0, (0.5,) * 6, START, START) == ""
    assert p.at(2.0) == START
