"""The executor: following, seams, braking on the path, latching, and the controller's own slider."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from cell.config import load
from cell.errors import RefusedError
from cell.frames import Array
from cell.limits import Limits, hermite
from cell.wire.types import Trajectory
from hil.executor import Executor

CONFIG = load()
LIMITS = Limits.from_config(CONFIG)
PERIOD = CONFIG.arm.control_period
HOME = np.array(CONFIG.arm.home)
AT_REST = np.zeros(6)

seeds = st.integers(0, 2**32 - 1)
shares = st.floats(0.0, 1.0)


def smooth(seed: int, *, spacing: float = PERIOD, number: int = 1, share: float = 0.95) -> Trajectory:
    """A random smooth motion from home, rest to rest, as fast as `share` of the limits permits."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 8))
    knots = HOME + rng.uniform(-0.5, 0.5, (n, 6))
    knots[0] = HOME
    spline = CubicSpline(np.linspace(0.0, 1.0, n), knots, bc_type="clamped")
    fine = np.linspace(0.0, 1.0, 2001)
    qd, qdd = np.abs(spline(fine, 1)), np.abs(spline(fine, 2))
    slowest = max(
        float((qd / LIMITS.qd_max).max()),
        float(np.sqrt((qdd / LIMITS.qdd_max).max())),
        float(qd.max()) / 0.9,  # keeps the tool below 1 m/s
    )
    duration = slowest / share
    steps = max(2, round(duration / spacing))
    duration = steps * spacing
    times = np.linspace(0.0, duration, steps + 1)
    qd = spline(times / duration, 1) / duration
    qd[0] = qd[-1] = 0.0
    return Trajectory(number, "test", 0.0, 10.0, times, spline(times / duration), qd)


class Run:
    """An executor driven tick by tick; keeps the set-points it gave."""

    def __init__(self) -> None:
        self.executor = Executor(LIMITS, PERIOD, HOME)
        self.q, self.qd, self.progress = [HOME.copy()], [np.zeros(6)], [0.0]

    @property
    def now(self) -> float:
        return (len(self.q) - 1) * PERIOD

    def accept(self, trajectory: Trajectory) -> None:
        self.executor.accept(trajectory, self.now, self.executor.q)

    def tick(self, ticks: int = 1, scaling: float = 1.0) -> None:
        for _ in range(ticks):
            q, qd = self.executor.tick(self.now, scaling)
            self.q.append(q.copy())
            self.qd.append(qd.copy())
            self.progress.append(self.executor.progress)

    def finish(self, limit: float = 30.0) -> None:
        while self.executor.moving:
            self.tick()
            assert self.now < limit, "does not come to an end"

    def worst(self) -> tuple[float, float, float]:
        """Largest shares of the limits: speed, change of commanded speed, change of position's slope."""
        q, qd = np.array(self.q), np.array(self.qd)
        speed = np.abs(np.diff(q, axis=0)) / PERIOD / LIMITS.qd_max
        change = np.abs(np.diff(qd, axis=0)) / PERIOD / LIMITS.qdd_max
        slope = np.abs(np.diff(q, 2, axis=0)) / PERIOD**2 / LIMITS.qdd_max
        return float(speed.max()), float(change.max()), float(slope.max())


def refusal(run: Run, trajectory: Trajectory, q: Array | None = None) -> RefusedError:
    with pytest.raises(RefusedError) as caught:
        run.executor.accept(trajectory, run.now, run.executor.q if q is None else q)
    return caught.value


# -- following ------------------------------------------------------------------------------------


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_follows_the_points_tick_by_tick_and_holds_the_last(seed: int) -> None:
    order, run = smooth(seed), Run()
    run.accept(order)
    assert run.executor.moving and run.executor.trajectory_id == 1
    run.finish()
    assert len(run.q) == len(order.times)
    np.testing.assert_allclose(run.q, order.q, atol=1e-9)
    np.testing.assert_allclose(run.qd, order.qd, atol=1e-6)
    run.tick(3)
    assert (run.executor.q == order.q[-1]).all() and not run.executor.qd.any()
    assert run.executor.progress == 1.0 and not run.executor.stopped


def test_points_between_ticks_are_interpolated() -> None:
    order, run = smooth(3, spacing=0.05, share=0.7), Run()
    run.accept(order)
    run.finish()
    at = np.arange(len(run.q)) * PERIOD
    expected, _, _ = hermite(order.times, order.q, order.qd, at)
    np.testing.assert_allclose(run.q, expected, atol=1e-9)


def test_does_nothing_without_a_trajectory() -> None:
    run = Run()
    run.tick(50)
    assert (np.array(run.q) == HOME).all() and not run.executor.moving


# -- what is refused ----------------------------------------------------------------------------------


def test_expired_future_and_repeated_commands_are_refused() -> None:
    run, order = Run(), smooth(1)
    run.tick(10)
    late = refusal(run, replace(order, expires=0.05))
    assert late.code == "stale" and late.reason == "it expired 0.030 s ago"
    assert refusal(run, replace(order, expires=float("nan"))).code == "not_finite"
    assert refusal(run, replace(order, start=float("nan"))).code == "not_finite"
    run.accept(replace(order, id=7))
    run.finish()
    back = replace(order, q=np.tile(run.executor.q, (len(order.times), 1)), qd=0 * order.qd)
    assert refusal(run, replace(back, id=7)).reason == "id 7 is not above the last one, 7"
    run.executor.forget_ids()
    run.accept(replace(back, id=1))


def test_a_start_away_from_the_arm_is_refused() -> None:
    order = smooth(2)
    away = refusal(Run(), replace(order, q=order.q + 0.03))
    assert away.code == "seam" and "0.030 rad away from the arm's set-point" in away.reason
    pushed = refusal(Run(), order, q=HOME + np.array([0, 0.5, 0, 0, 0, 0]))
    assert pushed.code == "seam" and "0.500 rad away from the arm's measured position" in pushed.reason
    assert refusal(Run(), order, q=np.full(6, np.nan)).code == "seam"
    flying = remainder(order, 0.3, 0.0, 1)
    flying = replace(flying, q=flying.q - flying.q[0] + HOME)
    assert "must start at rest" in refusal(Run(), flying).reason


def test_a_second_motion_while_moving_needs_a_seam() -> None:
    run, order = Run(), smooth(4)
    run.accept(order)
    run.tick(5)
    assert refusal(run, replace(order, id=2)).reason == "the arm is moving; give the start time of a seam"
    past = refusal(run, replace(order, id=2, start=run.now - PERIOD))
    assert past.code == "stale" and "in the past" in past.reason
    assert refusal(run, replace(order, id=2, start=-1.0)).code == "stale"
    wrong = refusal(run, replace(order, id=2, start=run.now + 0.2))
    assert wrong.code == "seam" and "off the running trajectory" in wrong.reason
    assert refusal(Run(), replace(order, start=0.5)).code == "seam"


def test_a_refused_command_changes_nothing() -> None:
    order, run, other = smooth(5), Run(), Run()
    for r in (run, other):
        r.accept(order)
        r.tick(20)
    refusal(run, replace(order, id=9))
    refusal(run, replace(order, id=9, start=run.now + 0.1))
    run.finish()
    other.finish()
    assert np.array_equal(run.q, other.q)
    assert run.executor.trajectory_id == 1


# -- seams ------------------------------------------------------------------------------------------------


def remainder(order: Trajectory, at: float, start: float, number: int, stretch: float = 1.0) -> Trajectory:
    """The rest of a trajectory from path time `at`, slowed towards its end when `stretch` > 1."""
    left = float(order.times[-1]) - at
    times = np.linspace(0.0, left, max(3, round(left / PERIOD) + 1))
    q, qd, _ = hermite(order.times, order.q, order.qd, at + times)
    qd[-1] = 0.0
    if stretch > 1.0:  # the path clock slows down smoothly from 1 to 1 / stretch
        s = times / left
        rate = 1 - (1 - 1 / stretch) * s * s * (3 - 2 * s)
        times = np.concatenate([[0.0], np.cumsum(np.diff(times) * 2 / (rate[1:] + rate[:-1]))])
        qd = qd * rate[:, None]
    return Trajectory(number, "test", start, 10.0, times, q, qd)


@given(seeds, shares, st.integers(0, 40), st.sampled_from([1.0, 1.5, 3.0]))
@settings(max_examples=40, deadline=None)
def test_a_seam_has_no_jump(seed: int, share: float, ahead: int, stretch: float) -> None:
    order, run = smooth(seed), Run()
    run.accept(order)
    run.tick(int(share * 0.6 * (len(order.times) - 2)))
    start = run.now + ahead * PERIOD + 0.003  # not on a tick
    if start > order.times[-1] - 2 * PERIOD:
        return
    run.accept(remainder(order, start, start, 2, stretch))
    while run.now < start:
        assert run.executor.trajectory_id == 1
        run.tick()
    assert run.executor.trajectory_id == 2
    run.finish()
    assert max(run.worst()) < 1.02
    np.testing.assert_allclose(run.q[-1], order.q[-1], atol=1e-9)


def test_a_seam_is_met_on_the_path_when_the_controller_slows_down() -> None:
    order, run = smooth(11), Run()
    run.accept(order)
    run.tick(20)
    start = run.now + 0.2
    run.accept(remainder(order, start, start, 2))
    run.tick(50, scaling=0.5)
    assert run.executor.trajectory_id == 2
    run.finish()
    assert max(run.worst()) < 1.03
    assert "slowed" in refusal_while_slowed()


def refusal_while_slowed() -> str:
    order, run = smooth(11), Run()
    run.accept(order)
    run.tick(20, scaling=0.5)
    return refusal(run, remainder(order, run.now + 0.1, run.now + 0.1, 2)).reason


def test_a_stop_drops_the_replacement() -> None:
    order, run = smooth(6), Run()
    run.accept(order)
    run.tick(10)
    run.accept(remainder(order, run.now + 0.05, run.now + 0.05, 2))
    run.executor.stop("enough")
    run.finish()
    assert run.executor.stopped and run.executor.trajectory_id == 1
    assert run.executor.stop_reason == "enough"


# -- stopping -----------------------------------------------------------------------------------------------


@given(seeds, shares, st.sampled_from([PERIOD, 0.03, 0.1]))
@settings(max_examples=60, deadline=None)
def test_a_stop_brakes_on_the_path_within_the_limits(seed: int, share: float, spacing: float) -> None:
    order = smooth(seed, spacing=spacing, share=0.95 if spacing == PERIOD else 0.8)
    run = Run()
    run.accept(order)
    run.tick(int(share * order.times[-1] / PERIOD))
    began = len(run.q)
    run.executor.stop("test")
    run.finish()
    # On the path: every set-point is the original at the path time that the progress says.
    tau = np.array(run.progress) * order.times[-1]
    np.testing.assert_allclose(run.q, hermite(order.times, order.q, order.qd, tau)[0], atol=1e-9)
    assert (np.diff(tau) >= 0).all()
    assert max(run.worst()) < 1.005
    # At rest, for good, in about the time that full braking of the fastest joint takes.
    assert run.executor.stopped and not run.executor.qd.any()
    assert (len(run.q) - began) * PERIOD < 0.8
    run.tick(20)
    assert (np.array(run.q[-20:]) == run.q[-21]).all()


def bang_bang(travel: float, share: float) -> Trajectory:
    """As fast as `share` of the acceleration limit permits: full acceleration, then full braking."""
    a = share * LIMITS.qdd_max[0]
    half = float(np.sqrt(travel / a))
    steps = int(np.ceil(2 * half / PERIOD))
    times = np.arange(steps + 1) * PERIOD
    early = np.minimum(times, half)
    late = np.clip(times - half, 0.0, half)
    qd = a * (early - late)
    distance = 0.5 * a * early**2 + a * half * late - 0.5 * a * late**2
    weights = np.array([1.0, -0.7, 0.5, 0.9, -1.0, 0.3])
    qd[-1] = 0.0
    return Trajectory(1, "test", 0.0, 10.0, times, HOME + distance[:, None] * weights, qd[:, None] * weights)


@given(st.floats(0.02, 0.3), shares)
@settings(max_examples=40, deadline=None)
def test_a_stop_near_a_switch_from_accelerating_to_braking(travel: float, share: float) -> None:
    order, run = bang_bang(travel, 0.95), Run()
    run.accept(order)
    run.tick(int(share * len(order.times)))
    run.executor.stop("test")
    run.finish()
    assert max(run.worst()) < 1.005
    tau = np.array(run.progress) * order.times[-1]
    np.testing.assert_allclose(run.q, hermite(order.times, order.q, order.qd, tau)[0], atol=1e-9)


def test_a_stop_while_the_controller_pauses_the_arm() -> None:
    order, run = smooth(8), Run()
    run.accept(order)
    run.tick(20)
    run.tick(100, scaling=0.0)
    assert run.executor.moving and (run.q[-1] == run.q[-2]).all()
    run.executor.stop("test")
    run.tick()
    assert run.executor.stopped and not run.executor.moving


def test_a_stop_latches_and_keeps_its_first_reason() -> None:
    run, order = Run(), smooth(9)
    run.accept(order)
    run.tick(20)
    run.executor.stop("first")
    run.executor.stop("second")
    assert not run.executor.stopped and run.executor.stop_reason == "first"
    braking = refusal(run, replace(order, id=2))
    assert braking.code == "stopped" and braking.reason == "first; send resume first"
    with pytest.raises(RefusedError, match="still braking"):
        run.executor.resume(run.executor.q, AT_REST)
    run.finish()
    assert refusal(run, replace(order, id=2)).code == "stopped"
    assert run.executor.stopped


def test_resume_starts_no_motion_and_begins_at_the_measured_joints() -> None:
    run, order = Run(), smooth(10)
    run.accept(order)
    run.tick(20)
    run.executor.stop("test")
    run.finish()
    moved = run.executor.q + 0.3  # somebody pushed the arm
    with pytest.raises(RefusedError, match=r"joints still move at 0\.200 rad/s"):
        run.executor.resume(moved, np.full(6, 0.2))
    run.executor.resume(moved, AT_REST)
    assert not run.executor.stopped and run.executor.stop_reason == ""
    run.tick(50)
    assert (np.array(run.q[-50:]) == moved).all() and not run.executor.moving
    old = refusal(run, replace(order, id=2, q=order.q - order.q[0] + run.q[20]), q=moved)
    assert old.code == "seam"
    run.executor.accept(replace(order, id=2, q=order.q - order.q[0] + moved), run.now, moved)


def test_a_stop_at_rest_latches_too_and_resume_without_one_does_nothing() -> None:
    run = Run()
    run.executor.resume(HOME + 1.0, AT_REST)
    assert (run.executor.q == HOME).all()
    run.executor.stop("quiet")
    assert run.executor.stopped and refusal(run, smooth(1)).code == "stopped"


# -- the controller's slider --------------------------------------------------------------------------------


@given(seeds, st.lists(st.tuples(st.integers(1, 40), shares), min_size=1, max_size=6))
@settings(max_examples=40, deadline=None)
def test_speed_scaling_keeps_path_and_limits(seed: int, pieces: list[tuple[int, float]]) -> None:
    order, run = smooth(seed), Run()
    run.accept(order)
    for ticks, scaling in pieces:
        run.tick(ticks, scaling)
    run.finish()
    tau = np.array(run.progress) * order.times[-1]
    np.testing.assert_allclose(run.q, hermite(order.times, order.q, order.qd, tau)[0], atol=1e-9)
    assert max(run.worst()) < 1.02
    assert (run.executor.q == order.q[-1]).all()


def test_half_speed_takes_twice_as_long() -> None:
    order, run = smooth(12), Run()
    run.accept(order)
    run.tick(2, 0.5)
    while run.executor.moving:
        run.tick(1, 0.5)
    assert run.now == pytest.approx(2 * order.times[-1], rel=0.02)


@pytest.mark.parametrize("scaling", [float("nan"), -1.0, 0.0])
def test_a_senseless_scaling_stands_still(scaling: float) -> None:
    order, run = smooth(12), Run()
    run.accept(order)
    run.tick(300, scaling)
    assert run.executor.moving and np.isfinite(run.q).all() and (run.q[-1] == run.q[-2]).all()
