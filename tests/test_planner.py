"""Planner: every transfer of the sorting task works, keeps clear, and passes the node's check."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from cell.config import CellConfig, load
from cell.errors import PlanError
from cell.frames import Array
from cell.limits import Limits, check_trajectory, tcp_positions
from cell.motion.collision import CollisionModel
from cell.motion.planner import Planner, drop_place
from cell.motion.timing import TimedPath
from cell.motion.views import InspectionViews
from cell.wire.types import Trajectory

CONFIG = load()
LIMITS = Limits.from_config(CONFIG)
SLOW = CONFIG.motion.collaborative_speed
HOME = np.array(CONFIG.arm.home)
HELD = CONFIG.onions.diameter[1] / 2


@cache
def planner() -> Planner:
    return Planner(CONFIG)


def hover(x: float, y: float, yaw: float) -> Array:
    """Arm pose above an onion on the belt."""
    z = CONFIG.belt.top_z + HELD
    X_WT = planner().hover(planner().grasp_pose(np.array([x, y, z]), yaw))
    return planner().kinematics.ik_near(X_WT, HOME)


@cache
def window() -> tuple[Array, ...]:
    b = CONFIG.belt
    places = [(x, y) for x in np.linspace(*b.pick_x, 3) for y in np.linspace(*b.pick_y, 5)]
    return tuple(hover(x, y, 0.7 * (i % 5 - 2)) for i, (x, y) in enumerate(places))


@cache
def stations() -> dict[str, Array]:
    drop = planner().drop_pose(HOME)
    views = {f"view {i}": v.q for i, v in enumerate(InspectionViews(CONFIG).views)}
    return {"home": HOME, "bin": planner().kinematics.ik_near(drop, HOME), **views}


def check(timed: TimedPath, q_from: Array, q_to: Array, held: float) -> None:
    times, q, qd = timed.to_points(CONFIG.arm.control_period)
    check_trajectory(Trajectory(1, "test", 0.0, 1.0, times, q, qd), LIMITS)
    assert np.allclose(q[0], q_from, atol=1e-9) and np.allclose(q[-1], q_to, atol=1e-9)
    least = min(CONFIG.motion.clearance, *planner().collision.clearance(q[[0, -1]], held_radius=held))
    assert (planner().collision.clearance(q[::4], held_radius=held) > least - 0.002).all()


@pytest.mark.parametrize("station", ["home", "bin", "view 0", "view 1", "view 2", "view 3"])
def test_every_transfer_between_window_and_stations_works(station: str) -> None:
    there = stations()[station]
    for i, q in enumerate(window()):
        # Every place is left with an onion and reached without one, or the other way round.
        held, back = (HELD, 0.0) if i % 2 else (0.0, HELD)
        check(planner().plan_joints(q, there, SLOW, held_radius=held), q, there, held)
        check(planner().plan_joints(there, q, SLOW, held_radius=back), there, q, back)


def test_every_transfer_between_stations_works() -> None:
    for a in stations().values():
        for b in stations().values():
            check(planner().plan_joints(a, b, SLOW, held_radius=HELD), a, b, HELD)


def test_transfers_within_the_window_work() -> None:
    rng = np.random.default_rng(5)
    for _ in range(40):
        i, j = rng.integers(0, len(window()), 2)
        check(
            planner().plan_joints(window()[i], window()[j], SLOW, held_radius=HELD),
            window()[i],
            window()[j],
            HELD,
        )


def test_industrial_speed_is_faster_and_within_limits() -> None:
    for q in window()[::4]:
        slow = planner().plan_joints(HOME, q, SLOW)
        fast = planner().plan_joints(HOME, q, CONFIG.motion.industrial_speed)
        check(fast, HOME, q, 0.0)
        assert fast.duration < 0.7 * slow.duration


@pytest.mark.parametrize("diameter", CONFIG.onions.diameter)
def test_descents_and_ascents_are_straight(diameter: float) -> None:
    for q in window():
        X_WT = planner().kinematics.X_WT(q)
        X_WT[2, 3] = CONFIG.belt.top_z + diameter / 2
        down = planner().plan_to_pose(q, X_WT, SLOW, straight=True)
        _, points, _ = down.to_points(CONFIG.arm.control_period)
        p = tcp_positions(points, CONFIG.gripper.length)
        assert np.abs(p[:, :2] - X_WT[:2, 3]).max() < 2e-4
        up = planner().plan_to_pose(
            points[-1], planner().hover(X_WT), SLOW, straight=True, held_radius=diameter / 2
        )
        assert up.duration < 0.8


def test_an_approach_does_not_stop_and_comes_straight_down() -> None:
    for start in (HOME, stations()["view 3"]):
        for q in window()[::2]:
            X_WT = planner().kinematics.X_WT(q)
            X_WT[2, 3] = CONFIG.belt.top_z + HELD
            whole = planner().plan_approach(start, X_WT, SLOW, held_radius=HELD)
            times, points, qd = whole.to_points(CONFIG.arm.control_period)
            check_trajectory(Trajectory(1, "test", 0.0, 1.0, times, points, qd), LIMITS)
            p = tcp_positions(points, CONFIG.gripper.length)
            low = p[:, 2] < X_WT[2, 3] + CONFIG.motion.hover - 0.05
            assert np.abs(p[low, :2] - X_WT[:2, 3]).max() < 2e-3
            assert np.abs(p[-1] - X_WT[:3, 3]).max() < 1e-6
            transfer = planner().plan_to_pose(start, planner().hover(X_WT), SLOW, held_radius=HELD)
            down = planner().plan_to_pose(transfer.path.end, X_WT, SLOW, straight=True, held_radius=HELD)
            assert whole.duration < transfer.duration + down.duration


def test_the_same_request_gives_the_same_motion() -> None:
    other = Planner(CONFIG)
    for q in window()[::5]:
        a, b = planner().plan_joints(HOME, q, SLOW), other.plan_joints(HOME, q, SLOW)
        assert np.array_equal(a.path.samples(0.1), b.path.samples(0.1)) and np.array_equal(a.x, b.x)


def test_a_straight_motion_into_the_belt_is_refused() -> None:
    X_WT = planner().kinematics.X_WT(window()[7])
    X_WT[2, 3] = CONFIG.belt.top_z + 0.005
    with pytest.raises(PlanError, match="finger and belt"):
        planner().plan_to_pose(window()[7], X_WT, SLOW, straight=True)


def test_a_pose_in_the_belt_names_what_is_in_the_way() -> None:
    X_WT = planner().kinematics.X_WT(window()[7])
    X_WT[2, 3] = CONFIG.belt.top_z - 0.02
    with pytest.raises(PlanError, match="belt"):
        planner().plan_to_pose(HOME, X_WT, SLOW)


def test_a_pose_out_of_reach_is_named() -> None:
    X_WT = planner().grasp_pose(np.array([0.8, 0.0, -0.1]), 0.0)
    with pytest.raises(PlanError, match=r"0\.800.*out of the UR3e's reach"):
        planner().plan_to_pose(HOME, X_WT, SLOW)


def test_the_nearer_of_two_equal_grasps_is_taken() -> None:
    for yaw in np.linspace(-1.5, 1.5, 7):
        X_WT = planner().grasp_pose(np.array([0.33, 0.1, -0.02]), float(yaw))
        near = planner().nearer_turn(X_WT, HOME)
        assert np.allclose(np.abs(X_WT[:3, :3].T @ near[:3, :3]), np.eye(3), atol=1e-9)
        q = planner().kinematics.ik_near(near, HOME)
        assert abs(q[5] - HOME[5]) < np.pi


def test_a_wall_in_the_way_is_gone_round() -> None:
    """A bin with a high rim between home and the window: no direct way, so a detour is found."""
    high = replace(CONFIG, bin=replace(CONFIG.bin, center=(0.0, 0.31, -0.02), size=(0.26, 0.24, 0.28)))
    walled = Planner(replace(high, arm=replace(high.arm, home=HOME)))
    inside = walled.kinematics.ik_near(walled.grasp_pose(np.array([0.0, 0.31, 0.0]), 0.0), HOME)
    q = window()[7]
    timed = walled.plan_joints(inside, q, SLOW)
    assert (walled.collision.clearance(timed.path.samples(0.03)) >= 0).all()


def camera_moved(config: CellConfig, position: tuple[float, float, float]) -> CellConfig:
    camera = replace(config.cameras["belt"], position=position)
    return replace(config, cameras={"belt": camera})


def test_collision_model_sees_posts_walls_belt_and_itself() -> None:
    model = CollisionModel(CONFIG)
    assert model.clearance(HOME)[0] > 0.02
    p_WT = planner().kinematics.X_WT(HOME)[:3, 3]
    x, y, z = (float(v) for v in p_WT)
    assert CollisionModel(camera_moved(CONFIG, (x, y + 0.01, z + 0.02))).nearest(HOME)[0] < 0
    assert "camera post" in CollisionModel(camera_moved(CONFIG, (x - 0.06, y, 0.9))).nearest(HOME)[1]
    folded = HOME.copy()
    folded[2] = -3.1
    assert model.clearance(folded)[0] < 0
    assert "upper arm" in model.nearest(folded)[1]
    assert model.clearance(HOME, held_radius=0.2)[0] < model.clearance(HOME, held_radius=0.04)[0]


def test_every_onion_of_a_batch_is_let_go_elsewhere_over_the_bin() -> None:
    places = np.array([drop_place(CONFIG.bin, k) for k in range(15)])
    apart = np.linalg.norm(places[:, None, :2] - places[None, :, :2], axis=2) + np.eye(15)
    assert apart.min() > 0.01
    assert np.allclose(places[0, :2], CONFIG.bin.center[:2])
    assert np.abs(places[:, :2] - CONFIG.bin.center[:2]).max() <= CONFIG.bin.drop_spread
    for k in range(0, 15, 3):
        X_WT = planner().drop_pose(HOME, k)
        assert np.allclose(X_WT[:3, 3], places[k])
        timed = planner().plan_to_pose(HOME, X_WT, 0.25, held_radius=0.04)
        check(timed, HOME, timed.to_points(CONFIG.arm.control_period)[1][-1], 0.04)


def test_fingertips_may_come_near_the_belt_but_not_into_it() -> None:
    model = CollisionModel(CONFIG)
    clear = {}
    for gap in (0.010, 0.003, -0.001):
        # Fingertips reach 11 mm beyond the tool centre point.
        X_WT = planner().grasp_pose(np.array([0.33, 0.0, CONFIG.belt.top_z + 0.011 + gap]), 0.0)
        q = planner().kinematics.ik_near(X_WT, HOME)
        clear[gap] = model.clearance(q, touching=True)[0], model.clearance(q)[0]
    assert clear[0.003][0] >= CONFIG.motion.clearance > clear[0.003][1] > 0
    assert clear[0.010][1] >= CONFIG.motion.clearance
    assert clear[-0.001][0] < CONFIG.motion.clearance
