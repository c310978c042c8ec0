"""Motions cycle by cycle: limits, continuity, targets, lag, stops, and what cannot be done."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.errors import BackendError
from cell.frames import Array
from hil.emulator.interfaces import PERIOD, ZERO6, Measured
from hil.emulator.kinematics import error
from hil.emulator.models import UR3E
from hil.emulator.motion.compliant import ForceTask
from hil.emulator.motion.path import Leg
from hil.emulator.motion.profile import Corner, Stretch, TimeLaw
from hil.emulator.motion.servo import ACCELERATION
from hil.emulator.mover import Mover
from hil.emulator.poses import IDENTITY, frame_of
from tests.emulator.fake_robot import HOME, FakeRobot

TCP = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
seeds = st.integers(0, 2**32 - 1)


def robot(tcp: Array = TCP) -> FakeRobot:
    out = FakeRobot(tcp=tcp)
    out.mover.use(out.tcp)
    return out


def shifted(r: FakeRobot, *change: float) -> Array:
    return np.array(r.mover.pose()) + np.array([*change, *[0.0] * (6 - len(change))])


def off(r: FakeRobot, pose: Array) -> float:
    """Of the set-point's tool from a pose: the larger of [m] and [rad]."""
    return max(abs(v) for v in error(frame_of(pose.tolist()), frame_of(r.mover.pose())))


def tool_path(r: FakeRobot) -> Array:
    return np.array([r.mover.kinematics.pose(q.tolist(), TCP.tolist()) for q in r.q])


# -- moves -------------------------------------------------------------------------------------------


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_movej_keeps_speed_and_acceleration_and_ends_on_its_target(seed: int) -> None:
    rng = np.random.default_rng(seed)
    r, target = robot(), HOME + rng.uniform(-1.0, 1.0, 6)
    v, a = float(rng.uniform(0.1, 6.0)), float(rng.uniform(0.2, 20.0))
    r.mover.movej(target, v, a)
    took = r.rest(60.0)
    assert np.array_equal(r.mover.q, target) and not r.mover.qd.any() and not r.mover.trouble
    assert r.acceleration() <= a * (1 + 1e-6) and r.speed() <= 1.0
    assert r.slip() <= a * PERIOD**2
    way = np.abs(target - HOME)
    fastest = min(v, float((UR3E.qd_max * way.max() / way).min()))
    expected = way.max() / fastest + fastest / a
    if way.max() < fastest**2 / a:
        expected = 2 * np.sqrt(way.max() / a)
    assert took == pytest.approx(expected, abs=2 * PERIOD)
    assert np.abs(np.array(r.qd)).max() <= v * (1 + 1e-9)


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_movel_is_straight_at_its_speed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    r = robot()
    target = shifted(r, *rng.uniform(-0.08, 0.08, 3), *rng.uniform(-0.3, 0.3, 3))
    v, a = float(rng.uniform(0.05, 0.4)), float(rng.uniform(0.3, 3.0))
    r.mover.movel(target, v, a)
    r.rest()
    assert not r.mover.trouble
    assert off(r, target) < 1e-9
    p = tool_path(r)[:, :3]
    line = (target[:3] - p[0]) / np.linalg.norm(target[:3] - p[0])
    along = (p - p[0]) @ line
    assert np.linalg.norm(p - p[0] - along[:, None] * line, axis=1).max() < 1e-7
    speed = np.diff(along) / PERIOD
    assert speed.max() <= v * (1 + 1e-6) and np.abs(np.diff(speed)).max() / PERIOD <= a * (1 + 1e-3)
    assert r.slip() < 1e-5


def test_a_straight_move_is_slower_where_a_joint_is_at_its_limit() -> None:
    """PolyScope's manual: a program's speed is adjusted so that no joint passes its limit."""
    r = robot()
    target = shifted(r, 0.3)
    r.mover.movel(target, 2.0, 15.0)
    r.rest()
    assert not r.mover.trouble and off(r, target) < 1e-9
    shares = np.abs(np.array(r.qd)) / UR3E.qd_max
    limited = shares.max(axis=1) > 0.999
    assert shares.max() <= 1.0 and limited.sum() > 20
    p = tool_path(r)[:, :3]
    assert np.ptp(p[:, 1:], axis=0).max() < 1e-6
    assert np.abs(np.diff(p[:, 0], n=2)).max() / PERIOD**2 <= 15.0 * (1 + 1e-2)  # no jerk of the tool


def test_a_move_of_given_duration_takes_it() -> None:
    r = robot()
    r.mover.movej(HOME + 0.5, 1.05, 1.4, t=2.0)
    assert r.rest() == pytest.approx(2.0, abs=2 * PERIOD)
    r.mover.movej(HOME, 1.05, 1.4, t=0.5)  # shorter than 1.4 rad/s^2 permit
    assert r.rest() == pytest.approx(0.5, abs=2 * PERIOD)


def test_movec_follows_its_circle() -> None:
    r = robot()
    start = np.array(r.mover.pose())
    via, end = shifted(r, 0.05, 0.05), shifted(r, 0.1, 0.0)
    r.mover.movec(via, end, 0.1, 1.0)
    r.rest()
    away = np.linalg.norm(tool_path(r)[:, :3] - start[:3] - np.array([0.05, 0.0, 0.0]), axis=1)
    assert np.abs(away - 0.05).max() < 1e-6 and off(r, end) < 1e-9


def test_the_slider_slows_a_move_and_a_pause_holds_it_on_its_path() -> None:
    plain, slow = robot(), robot()
    for r in (plain, slow):
        r.mover.movej(HOME + 0.4, 1.0, 2.0)
    took = plain.rest()
    slow.speed_scaling = 0.5
    assert slow.rest() == pytest.approx(2 * took, abs=4 * PERIOD)
    assert slow.acceleration() <= 2.0
    r = robot()
    r.mover.movej(HOME + 0.4, 1.0, 2.0)
    r.tick(150)
    for scaling in (*np.linspace(1, 0, 100), *[0.0] * 50, *np.linspace(0, 1, 100)):
        r.speed_scaling = scaling
        r.tick()
    assert r.mover.moving
    r.rest()
    assert np.array_equal(r.mover.q, HOME + 0.4)


# -- paths -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("linear", [False, True])
@given(seed=seeds)
@settings(max_examples=8, deadline=None)
def test_paths_round_their_corners_within_the_blend(linear: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    r = robot()
    a, blend = 1.5, float(rng.uniform(0.005, 0.03))
    points = [
        shifted(r, *rng.uniform(-0.06, 0.06, 3)) if linear else HOME + rng.uniform(-0.3, 0.3, 6)
        for _ in range(4)
    ]
    r.mover.path([Leg(tuple(p), linear, 0.3, a, blend=blend) for p in points])
    stops, legs = 0, set()
    while r.mover.moving:
        r.tick()
        legs.add(r.mover.leg)
        stops += not r.mover.qd.any()
    assert legs == {0, 1, 2, 3} and stops <= 2 and not r.mover.trouble
    corners = points if linear else [r.mover.kinematics.pose(p.tolist(), TCP.tolist()) for p in points]
    p = tool_path(r)[:, :3]
    for corner in corners[:-1]:
        assert np.linalg.norm(p - corner[:3], axis=1).min() < blend
    assert np.abs(p[-1] - corners[-1][:3]).max() < 1e-9
    if linear:
        v = np.diff(p, axis=0) / PERIOD
        assert np.linalg.norm(np.diff(v, axis=0), axis=1).max() / PERIOD <= a * 1.01
    else:
        assert r.acceleration() <= a * (1 + 1e-6)
    assert r.slip() < 1e-5


def test_without_a_blend_and_between_kinds_a_path_stops() -> None:
    r = robot()
    q = HOME + np.array([0.2, 0, 0, 0, 0, 0])
    p = r.mover.kinematics.pose(q.tolist(), TCP.tolist())
    legs = [
        Leg(tuple(q), False, 1.0, 3.0, blend=0.02),
        Leg((p[0], p[1], p[2] + 0.05, *p[3:]), True, 0.3, 2.0),
        Leg(tuple(HOME), False, 1.0, 3.0),
    ]
    r.mover.path(legs)
    r.rest()
    still = [i for i, qd in enumerate(r.qd) if not qd.any()]
    assert len(still) >= 4 and np.abs(r.mover.q - HOME).max() < 1e-9


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_a_time_law_keeps_every_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    speeds = [float(v) for v in rng.uniform(0.1, 2.0, n)]
    stretches = [Stretch(float(rng.uniform(0.001, 1.0)), v, float(rng.uniform(0.5, 5.0))) for v in speeds]
    corners = [
        Corner(float(rng.uniform(0.01, 0.2)), float(rng.uniform(0.05, 1.0)) * min(speeds[k : k + 2]))
        if rng.random() < 0.7
        else Corner(0.0, 0.0)
        for k in range(n - 1)
    ]
    law = TimeLaw(stretches, corners)
    total = sum(s.length for s in stretches) + sum(c.length for c in corners)
    assert law.length == pytest.approx(total)
    t = np.arange(0.0, law.duration, 1e-3)
    s, v = np.array([law.at(x) for x in t]).T
    assert (np.diff(s) > -1e-12).all() and v.max() <= max(speeds) + 1e-9
    assert np.abs(np.diff(v)).max() <= 1e-3 * max(x.acceleration for x in stretches) + 1e-9
    assert np.allclose(np.diff(s), 0.5e-3 * (v[1:] + v[:-1]), atol=2e-6)


# -- servoj ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("lookahead", "gain"), [(0.03, 300.0), (0.03, 2000.0), (0.1, 500.0), (0.2, 100.0)])
def test_servoj_follows_a_ramp_late_by_lookahead_and_gain(lookahead: float, gain: float) -> None:
    r, speed = robot(), np.array([1.0, -0.5, 0.3, 0.0, 0.2, -1.0])
    for i in range(800):
        target = HOME + speed * min(i * PERIOD, 1.2)
        r.mover.servoj(target, PERIOD, lookahead, gain)
        r.tick()
        if i == 550:
            lag = float(np.median((target - r.mover.q)[speed != 0] / speed[speed != 0]))
            steady = np.abs(np.diff(r.qd[-100:], axis=0)).max()
    # From the cycle of the command to the set-point of the same cycle: the cycle itself comes on top.
    assert lag == pytest.approx(lookahead + 1 / gain - PERIOD, abs=1.1 * PERIOD)
    assert steady < (1e-6 if lookahead < 0.2 else 1e-2)
    assert r.acceleration() <= ACCELERATION * 1.001 and r.slip() < ACCELERATION * PERIOD**2


def test_servoj_brakes_when_nothing_comes_and_takes_over_from_a_move() -> None:
    r = robot()
    r.mover.movej(HOME + 1.0, 1.0, 3.0)
    r.tick(250)
    before = r.mover.q.copy()
    for i in range(200):
        r.mover.servoj(before + 0.0333 + (i + 1) * PERIOD, PERIOD, 0.03, 300.0)
        r.tick()
    assert np.abs(np.diff(r.qd[245:260], axis=0)).max() / PERIOD < 10.0
    last = len(r.qd)
    r.rest()
    assert (len(r.qd) - last) * PERIOD < 0.15 and r.acceleration() <= ACCELERATION * 1.001


def test_a_far_servoj_target_is_approached_within_limits_without_overshoot() -> None:
    r, target = robot(), HOME + np.array([1.0, 0, 0, 0, 0, -2.0])
    for _ in range(700):
        r.mover.servoj(target, PERIOD, 0.03, 300.0)
        r.tick()
    assert np.abs(r.mover.q - target).max() < 1e-6 and r.speed() <= 1 + 1e-9
    assert r.acceleration() <= ACCELERATION * 1.001
    assert np.array(r.q)[:, 0].max() <= target[0] + 1e-6


# -- speeds and stops --------------------------------------------------------------------------------


def test_speedj_and_speedl_end_after_their_time() -> None:
    r = robot()
    r.mover.speedj([0.5, 0, 0, 0.2, 0, 0], 1.0, 0.6)
    assert r.rest() == pytest.approx(0.6 + 0.5, abs=3 * PERIOD)
    assert r.acceleration() <= 1.0 + 1e-9 and np.abs(r.qd).max() == pytest.approx(0.5)
    r = robot()
    r.mover.speedl([0.1, 0, 0.05, 0, 0, 0], 0.5, 0.6)
    r.tick(250)
    twist = np.diff(tool_path(r)[-2:, :3], axis=0)[0] / PERIOD
    assert np.allclose(twist, [0.1, 0.0, 0.05], atol=5e-4)
    r.rest(2.0)


STARTS: dict[str, Callable[[Mover, Array], None]] = {
    "movej": lambda m, x: m.movej(HOME + x, 2.0, 8.0),
    "movel": lambda m, x: m.movel(np.array(m.pose()) + np.array([*0.1 * x[:3], 0, 0, 0]), 0.3, 2.0),
    "path": lambda m, x: m.path(
        [Leg(tuple(HOME + x), False, 1, 4, blend=0.03), Leg(tuple(HOME), False, 1, 4)]
    ),
    "speedj": lambda m, x: m.speedj(x, 5.0),
    "speedl": lambda m, x: m.speedl([*0.2 * x[:3], 0, 0, 0], 1.0),
    "servoj": lambda m, x: m.servoj(HOME + 0.05 * x, 0.4, 0.05, 300.0),
}
ENDS: dict[str, Callable[[Mover], None]] = {
    "stopj": lambda m: m.stopj(5.0),
    "stopl": lambda m: m.stopl(2.0),
    "halt": lambda m: m.halt(),
    "movej": lambda m: m.movej(HOME, 1.0, 3.0),
    "movel": lambda m: m.movel(m.kinematics.pose(HOME, TCP), 0.1, 1.0),
    "servoj": lambda m: m.servoj(m.q, 1.0, 0.05, 300.0),
    "speedj": lambda m: m.speedj([0.0] * 6, 6.0, 0.5),
}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("start", STARTS)
@given(seed=seeds)
@settings(max_examples=3, deadline=None)
def test_whatever_interrupts_what_nothing_jumps(start: str, end: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    r = robot()
    STARTS[start](r.mover, rng.uniform(-0.5, 0.5, 6))
    r.tick(int(rng.integers(1, 200)))
    assert not r.mover.trouble
    before = r.acceleration()
    r.q, r.qd = r.q[-1:], r.qd[-1:]
    ENDS[end](r.mover)
    r.tick()
    r.rest()
    assert not r.mover.qd.any() and not r.mover.trouble
    if end == "stopj" and start in ("speedj", "servoj"):
        assert r.acceleration() <= 5.001
    assert r.acceleration() <= max(40.0, ACCELERATION * 1.001 if "servoj" in (start, end) else before)
    assert r.slip() <= ACCELERATION * PERIOD**2
    if end.startswith("move"):
        assert np.abs(r.mover.q - HOME).max() < 1e-6


def test_halt_brakes_a_move_on_its_path() -> None:
    r = robot()
    p0, target = np.array(r.mover.pose()), shifted(r, 0.1, 0.05, 0.03)
    r.mover.movel(target, 0.5, 3.0)
    r.tick(70)
    r.mover.halt()
    assert r.rest() < 0.1
    p = tool_path(r)[:, :3] - p0[:3]
    line = (target - p0)[:3] / np.linalg.norm((target - p0)[:3])
    assert np.linalg.norm(p - (p @ line)[:, None] * line, axis=1).max() < 1e-6
    assert np.linalg.norm(p[-1]) < np.linalg.norm((target - p0)[:3])


def test_stops_have_the_deceleration_they_were_given() -> None:
    r = robot()
    r.mover.speedj([1.0, 0, 0, 0, 0, 0.5], 40.0)
    r.tick(100)
    r.mover.stopj(2.0)
    assert r.rest() == pytest.approx(0.5, abs=2 * PERIOD)
    r = robot()
    r.mover.movel(shifted(r, 0.15), 0.2, 2.0)
    r.tick(150)
    r.mover.stopl(0.5)
    assert r.rest() == pytest.approx(0.4, abs=3 * PERIOD)


# -- what cannot be done -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (lambda m: m.movej([7.0, 0, 0, 0, 0, 0], 1.0, 1.0), "limit is 6.283 rad"),
        (lambda m: m.movel([1.0, 1.0, 1.0, 0, 0, 0], 0.1, 1.0), "out of reach"),
        (lambda m: m.movej(HOME + 0.1, 0.0, 1.0), "speed and an acceleration above 0"),
        (lambda m: m.speedj([4.0, 0, 0, 0, 0, 0], 40.0), "limit is 3.14 rad/s"),
        (lambda m: m.speedl([-0.4, 0, 0, 0, 0, 0], 1.0), "rad/s|singularity"),
        (lambda m: m.servol([1.0, 1.0, 1.0, 0, 0, 0], PERIOD, 0.03, 300.0), "out of reach"),
        (lambda m: m.servoj(HOME, PERIOD, 0.5, 300.0), "lookahead_time 0.03..0.2 s"),
    ],
)
def test_trouble_says_why_and_the_arm_brakes(command: Callable[[Mover], None], says: str) -> None:
    r = robot()
    command(r.mover)
    r.until(lambda: bool(r.mover.trouble), 5.0)
    assert re.search(says, r.mover.trouble)
    r.rest(1.0)
    assert r.speed() <= 1.001 and r.acceleration() <= 40.001
    r.mover.reset(r.mover.q)
    assert not r.mover.trouble
    r.mover.movej(HOME, 1.0, 2.0)
    r.rest()
    assert np.array_equal(r.mover.q, HOME)


def test_a_joint_is_stopped_before_its_limit() -> None:
    r = robot()
    r.mover.speedj([0, 0, 0, 0, 0, 6.0], 40.0)
    r.until(lambda: bool(r.mover.trouble), 5.0)
    r.rest(1.0)
    assert "joint 6 would pass its limit" in r.mover.trouble
    assert 2 * np.pi - 0.2 < r.mover.q[5] <= 2 * np.pi


@pytest.mark.parametrize("bad", [[np.nan] * 6, [np.inf] * 6, [0.0] * 5])
def test_numbers_that_are_none_are_refused(bad: list[float]) -> None:
    r = robot()
    for command in (
        lambda: r.mover.movej(bad, 1.0, 1.0),
        lambda: r.mover.servoj(bad, PERIOD, 0.03, 300.0),
        lambda: r.mover.speedj(bad, 1.0),
        lambda: r.mover.speedj([0.1] * 6, float("nan")),
        lambda: r.mover.stopj(0.0),
    ):
        with pytest.raises(BackendError, match="number"):
            command()
    assert r.mover.ik([np.nan] * 6) is None


# -- forces ----------------------------------------------------------------------------------------------


def test_force_mode_presses_against_a_wall_with_the_force() -> None:
    r = robot()
    z0 = r.mover.pose()[2]
    wall, stiffness = z0 - 0.01, 5000.0

    def wrench() -> Array:
        depth = max(0.0, wall - r.mover.pose()[2])
        return np.array([0, 0, stiffness * depth, 0, 0, 0])

    r.wrench = wrench
    down = ForceTask(IDENTITY, (False, False, True, False, False, False), (0, 0, -12.0, 0, 0, 0), (0.05,) * 6)
    r.mover.force_mode(down)
    p0 = np.array(r.mover.pose())
    r.tick(1500)
    assert r.measured.wrench[2] == pytest.approx(12.0, abs=0.2)
    assert np.abs((np.array(r.mover.pose()) - p0)[[0, 1, 3, 4, 5]]).max() < 1e-5
    speed = (
        np.abs(np.diff([r.mover.kinematics.pose(q.tolist(), TCP.tolist())[2] for q in r.q])).max() / PERIOD
    )
    assert speed <= 0.0501 and r.acceleration() < 40.0
    r.mover.end_force_mode()
    r.rest(1.0)


def test_a_move_in_force_mode_goes_on_along_the_other_axes() -> None:
    r = robot()
    task = ForceTask(IDENTITY, (False, False, True, False, False, False), (0.0,) * 6, (0.05,) * 6)
    r.mover.force_mode(task)
    start = np.array(r.mover.pose())
    r.mover.movel(shifted(r, 0.05, 0.02, 0.04), 0.1, 1.0)
    r.until(lambda: not r.mover.busy)
    moved = np.array(r.mover.pose()) - start
    assert moved[:2] == pytest.approx([0.05, 0.02], abs=1e-3) and abs(moved[2]) < 1e-3
    r.mover.end_force_mode()
    r.rest(1.0)


def test_freedrive_follows_the_hand_along_free_axes_only() -> None:
    r = robot()
    r.mover.freedrive([True, False, True, False, False, False])
    r.wrench = lambda: np.array([15.0, 15.0, 1.0, 0.0, 0.0, 0.5])
    start = np.array(r.mover.pose())
    r.tick(250)
    moved = np.array(r.mover.pose()) - start
    assert 0.02 < moved[0] < 0.1 and np.abs(moved[1:]).max() < 1e-3
    r.mover.stopj(4.0)
    r.rest(1.0)


def test_tool_contact_counts_back_to_its_beginning() -> None:
    r = robot()
    assert r.mover.memory.contact([0, 0, -1]) == 0
    r.wrench = lambda: np.array([0.0, 0.0, 1.0 * max(0, len(r.q) - 20), 0.0, 0.0, 0.0])
    r.tick(31)
    found = r.mover.memory.contact([0, 0, -1])
    assert found == pytest.approx(8, abs=2)
    assert r.mover.memory.contact([0, 0, 1]) == 0 and r.mover.memory.contact([0.0] * 6) == found
    r.mover.memory.zero()
    assert r.mover.memory.contact([0, 0, -1]) == 0


# -- splines -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("quintic", [False, True])
def test_splines_pass_their_points_in_time(quintic: bool) -> None:
    r, bend = robot(), np.zeros(6) if quintic else None
    r.mover.spline(HOME + 0.1, np.full(6, 0.3), bend, 0.5, False)
    r.tick(240)
    r.mover.spline(HOME + 0.3, np.zeros(6), bend, 0.8, True)
    r.rest(3.0)
    assert (len(r.q) - 1) * PERIOD == pytest.approx(1.3, abs=2 * PERIOD)
    assert np.abs(r.q[250] - HOME - 0.1).max() < 1e-3 and np.array_equal(r.mover.q, HOME + 0.3)
    assert r.slip() < 1e-5


def test_a_spline_that_ends_in_motion_is_slowed_down_to_its_end() -> None:
    r = robot()
    r.mover.spline(HOME + 0.5, np.full(6, 2.0), None, 0.6, True)
    r.rest(10.0)
    assert np.abs(r.mover.q - HOME - 0.5).max() < 1e-4 and np.array(r.q)[:, 0].max() <= HOME[0] + 0.5 + 1e-9


# -- cost ----------------------------------------------------------------------------------------------------


def test_a_cycle_is_cheap() -> None:
    for start in STARTS.values():
        r = robot()
        start(r.mover, np.full(6, 0.3))
        costs = []
        for _ in range(100):
            begin = time.perf_counter()
            r.mover.tick(1.0, Measured(r.mover.q, r.mover.qd, ZERO6, ZERO6))
            costs.append(time.perf_counter() - begin)
        assert sorted(costs)[10] < 0.2e-3  # a busy machine slows most cycles down, not all
