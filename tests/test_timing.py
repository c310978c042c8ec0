"""Timing: limits hold on what is sent, plans change speed in flight, stop, and go on."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from cell.config import load
from cell.frames import Array
from cell.limits import QD_MAX, Limits, check_trajectory, hermite, tcp_jacobian
from cell.motion.paths import JointPath
from cell.motion.retiming import resume, retime, stop_on_path
from cell.motion.timing import TimedPath, time_path
from cell.wire.types import Trajectory

CONFIG = load()
LIMITS = Limits.from_config(CONFIG)
PERIOD = CONFIG.arm.control_period
SLOW, FAST = CONFIG.motion.collaborative_speed, CONFIG.motion.industrial_speed
A_MAX = CONFIG.arm.max_acceleration
SWITCHES = (0.2, 0.4, 0.5, 0.7)


@cache
def paths() -> tuple[JointPath, ...]:
    """Forty random curves through seven poses round home, inside the joint limits."""
    rng = np.random.default_rng(7)
    home = np.array([-0.5, -1.6, -1.4, -1.2, 1.2, 0.0])
    found: list[JointPath] = []
    while len(found) < 40:
        path = JointPath(home + rng.normal(0, 0.5, (7, 6)))
        if (np.abs(path.samples(0.05)) < LIMITS.q_max).all():
            found.append(path)
    return tuple(found)


@cache
def fast_plans() -> tuple[TimedPath, ...]:
    return tuple(time_path(path, FAST, CONFIG) for path in paths())


def switches() -> Iterator[tuple[TimedPath, float]]:
    for timed in fast_plans():
        for share in SWITCHES:
            yield timed, share * timed.duration


def fine(timed: TimedPath) -> tuple[Array, Array, Array, Array]:
    t = np.arange(0.0, timed.duration, 0.001)
    return (t, *timed.sample(t))


def tool_speed(q: Array, qd: Array) -> Array:
    return np.linalg.norm(np.einsum("nij,nj->ni", tcp_jacobian(q, LIMITS.gripper_length), qd), axis=1)


def sent(timed: TimedPath) -> Trajectory:
    return Trajectory(1, "test", 0.0, 1.0, *timed.to_points(PERIOD))


@pytest.mark.parametrize("cap", [SLOW, FAST])
def test_plans_keep_every_limit_between_their_nodes_too(cap: float) -> None:
    for path in paths():
        timed = time_path(path, cap, CONFIG)
        _, q, qd, qdd = fine(timed)
        assert (np.abs(qd) <= QD_MAX).all()
        assert np.abs(qdd).max() <= A_MAX
        assert tool_speed(q, qd).max() <= 1.02 * cap
        assert np.allclose(q[0], path.start) and not qd[0].any()


@pytest.mark.parametrize("cap", [SLOW, FAST])
def test_what_is_sent_passes_the_check_of_the_node(cap: float) -> None:
    for path in paths():
        trajectory = sent(time_path(path, cap, CONFIG))
        check_trajectory(trajectory, LIMITS)
        assert np.allclose(np.diff(trajectory.times), PERIOD)
        assert np.allclose(trajectory.q[-1], path.end) and not trajectory.qd[-1].any()


def test_what_is_sent_follows_the_path() -> None:
    for timed in fast_plans()[:10]:
        t, q, _, _ = fine(timed)
        got, _, _ = hermite(*timed.to_points(PERIOD), t)
        assert np.abs(got - q).max() < 2e-4


def test_a_straight_joint_move_is_as_fast_as_the_limits_allow() -> None:
    """Closed form: a bang-bang move of one joint by d takes 2 sqrt(d / a)."""
    q = np.array(CONFIG.arm.home)
    d = 0.8
    timed = time_path(JointPath([q, q + np.array([0, 0, 0, 0, 0, d])]), FAST, CONFIG)
    best = 2 * np.sqrt(d / (CONFIG.motion.acceleration_margin * A_MAX))
    assert timed.duration == pytest.approx(best, rel=0.01)


def test_a_tool_bound_move_is_as_fast_as_the_cap_allows() -> None:
    """Most of a long slow sweep runs at exactly the planned tool speed."""
    q = np.array([0.0, -0.6, -0.3, -1.0, 1.57, 0.0])
    timed = time_path(JointPath([q, q + np.array([1.6, 0, 0, 0, 0, 0])]), SLOW, CONFIG)
    _, q_, qd, _ = fine(timed)
    speed = tool_speed(q_, qd)
    assert np.median(speed) == pytest.approx(CONFIG.motion.speed_margin * SLOW, rel=1e-3)


def test_no_motion_is_a_short_rest() -> None:
    q = np.array(CONFIG.arm.home)
    trajectory = sent(time_path(JointPath([q, q]), SLOW, CONFIG))
    check_trajectory(trajectory, LIMITS)
    assert np.allclose(trajectory.q, q)


def test_slowing_down_in_flight_always_works() -> None:
    """160 cases: from the industrial to the collaborative cap at 20, 40, 50 and 70 % of the time."""
    late = []
    for timed, t in switches():
        rest = retime(timed, t, SLOW, CONFIG)
        _, q, qd, qdd = fine(rest)
        before = timed.sample(np.array([t]))
        assert np.allclose(q[0], before[0][0], atol=1e-12) and np.allclose(qd[0], before[1][0], atol=1e-9)
        assert np.abs(qdd).max() <= A_MAX
        assert (np.abs(qd) <= QD_MAX).all()
        over = np.flatnonzero(tool_speed(q, qd) > 1.02 * SLOW)
        late.append(0.001 * (over[-1] + 1) if len(over) else 0.0)
        assert np.allclose(rest.sample(np.array([rest.duration]))[0][0], timed.path.end, atol=1e-9)
    assert np.median(late) < 0.25 and max(late) < 0.8


def test_speeding_up_in_flight_always_works() -> None:
    for path in paths():
        timed = time_path(path, SLOW, CONFIG)
        for share in SWITCHES:
            t = share * timed.duration
            rest = retime(timed, t, FAST, CONFIG)
            assert rest.duration < timed.duration - t
            _, q, qd, qdd = fine(rest)
            assert np.abs(qdd).max() <= A_MAX and tool_speed(q, qd).max() <= 1.02 * FAST


def test_eight_changes_of_mind_in_a_row() -> None:
    rng = np.random.default_rng(11)
    for timed in fast_plans()[:12]:
        caps = [FAST, SLOW] * 4
        for cap in rng.permutation(caps):
            t = float(rng.uniform(0.02, 0.25)) * timed.duration
            before = timed.sample(np.array([t]))
            timed = retime(timed, t, float(cap), CONFIG)
            after = timed.sample(np.array([0.0]))
            assert np.allclose(before[0], after[0], atol=1e-12) and np.allclose(
                before[1], after[1], atol=1e-9
            )
            assert np.abs(timed.sample(np.linspace(0, timed.duration, 500))[2]).max() <= A_MAX


def test_a_retimed_rest_passes_the_check_of_the_node() -> None:
    for timed, t in list(switches())[::7]:
        tick = PERIOD * np.ceil(t / PERIOD)
        check_trajectory(sent(retime(timed, float(tick), SLOW, CONFIG)), LIMITS)


def test_stop_on_the_path_and_go_on() -> None:
    for timed, t in switches():
        stop = stop_on_path(timed, t, CONFIG)
        _, q, qd, qdd = fine(stop)
        assert np.allclose(qd[0], timed.sample(np.array([t]))[1][0], atol=1e-9)
        assert stop.duration < 0.8 and np.abs(qdd).max() <= A_MAX
        s_end = float(stop.s[-1])
        assert np.allclose(stop.sample(np.array([stop.duration]))[0][0], timed.path(s_end))
        on_path = timed.path(np.linspace(stop.s[0], s_end, 400))
        assert max(np.abs(on_path - p).max(axis=1).min() for p in q[::25]) < 0.02
        check_trajectory(sent(stop), LIMITS)
        on = resume(timed, s_end, SLOW, CONFIG)
        assert np.abs(on.sample(np.linspace(0, on.duration, 500))[2]).max() <= A_MAX
        assert np.allclose(on.sample(np.array([on.duration]))[0][0], timed.path.end, atol=1e-9)


def test_near_the_end_the_plan_is_kept() -> None:
    timed = fast_plans()[0]
    t = timed.duration - 0.02
    rest = retime(timed, t, SLOW, CONFIG)
    assert rest.duration == pytest.approx(timed.duration - t, abs=1e-9)
    assert retime(timed, timed.duration, SLOW, CONFIG).duration < 1e-6
