"""Limits: forward kinematics against published poses, interpolation, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from ur_analytic_ik import ur3e

from cell.clock import perf_s
from cell.config import load
from cell.errors import RefusedError
from cell.frames import Array, rot_z
from cell.limits import (
    QD_MAX,
    Limits,
    RefusalCode,
    check_trajectory,
    fk_flange,
    hermite,
    needed_acceleration,
    tcp_jacobian,
    tcp_positions,
)
from cell.wire.types import Trajectory

CONFIG = load()
LIMITS = Limits.from_config(CONFIG)
HOME = np.array(CONFIG.arm.home)
JOINTS = arrays(np.float64, 6, elements=st.floats(-3.0, 3.0))

# Computed from Universal Robots' published DH table, in the controller's base frame:
# joint angles [rad], position [m], axis-angle [rad].
PUBLISHED = [
    (
        [-1.54, -1.83, -2.28, -0.59, 1.60, 0.023],
        [-0.119995, -0.273535, 0.120594],
        [-0.012413, 3.111990, -0.018048],
    ),
    ([0.3, -1.2, 1.1, -1.4, -1.5, 0.7], [-0.321443, -0.243430, 0.302456], [2.546676, 1.683626, 0.073301]),
    ([0.0] * 6, [-0.456750, -0.223150, 0.066500], [1.570796, 0.0, 0.0]),
]  # fmt: skip


def rotation(v: Array) -> Array:
    angle = float(np.linalg.norm(v))
    x, y, z = np.asarray(v) / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)


def move(q0: Array, q1: Array, duration: float, points: int = 200) -> Trajectory:
    """A smooth rest-to-rest motion (quintic), times in equal steps."""
    t = np.linspace(0, duration, points)
    s = t / duration
    f, df = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / duration
    return Trajectory(1, "test", 0.0, 1.0, t, q0 + f[:, None] * (q1 - q0), df[:, None] * (q1 - q0))


def changed(trajectory: Trajectory, **parts: Array) -> Trajectory:
    return Trajectory(**{**{k: getattr(trajectory, k) for k in trajectory.__dataclass_fields__}, **parts})


def refusal(trajectory: Trajectory) -> str:
    with pytest.raises(RefusedError) as error:
        check_trajectory(trajectory, LIMITS)
    assert error.value.reason and "\n" not in error.value.reason
    return error.value.code


GOOD = move(HOME, HOME + np.array([0.4, 0.2, -0.3, 0.2, 0.1, 0.5]), 1.6)


@pytest.mark.parametrize(("q", "p", "v"), PUBLISHED)
def test_forward_kinematics_gives_the_published_poses(q: list[float], p: list[float], v: list[float]) -> None:
    X_WE = fk_flange(np.array(q))
    # World and controller base differ by half a turn about z.
    assert np.allclose(rot_z(np.pi) @ X_WE[:3, 3], p, atol=2e-6)
    assert np.allclose(rot_z(np.pi) @ X_WE[:3, :3], rotation(np.array(v)), atol=2e-6)


@given(JOINTS)
def test_forward_kinematics_equals_an_independent_package(q: Array) -> None:
    X_BE = np.asarray(ur3e.forward_kinematics(*q))
    X_WE = fk_flange(q)
    assert np.allclose(rot_z(np.pi) @ X_WE[:3, :3], X_BE[:3, :3], atol=1e-9)
    assert np.allclose(rot_z(np.pi) @ X_WE[:3, 3], X_BE[:3, 3], atol=1e-9)


@given(JOINTS)
def test_jacobian_is_the_derivative_of_the_tool_position(q: Array) -> None:
    J = tcp_jacobian(q, 0.163)[0]
    step = 1e-6
    for j in range(6):
        d = np.zeros(6)
        d[j] = step
        a, b = tcp_positions(np.stack([q - d, q + d]), 0.163)
        assert np.allclose((b - a) / (2 * step), J[:, j], atol=1e-7)


def test_hermite_passes_through_points_and_reproduces_cubics() -> None:
    t = np.array([0.0, 0.4, 1.0])
    q = np.outer(1 - 2 * t + 3 * t**2 - t**3, np.arange(1.0, 7.0))
    qd = np.outer(-2 + 6 * t - 3 * t**2, np.arange(1.0, 7.0))
    at = np.linspace(0, 1, 23)
    got, got_d, got_dd = hermite(t, q, qd, at)
    scale = np.arange(1.0, 7.0)
    assert np.allclose(got, np.outer(1 - 2 * at + 3 * at**2 - at**3, scale))
    assert np.allclose(got_d, np.outer(-2 + 6 * at - 3 * at**2, scale))
    assert np.allclose(got_dd, np.outer(6 - 6 * at, scale))
    for i, ti in enumerate(at):
        one = hermite(t, q, qd, float(ti))
        assert one[0].shape == (6,)
        assert all(np.allclose(a, b[i]) for a, b in zip(one, (got, got_d, got_dd), strict=True))


def test_hermite_holds_beyond_the_ends() -> None:
    t, q, qd = GOOD.times, GOOD.q, GOOD.qd
    for time, end in ((-1.0, 0), (99.0, -1)):
        held = hermite(t, q, qd, time)
        assert np.allclose(held[0], q[end]) and not held[1].any() and not held[2].any()


def test_a_good_trajectory_passes_quickly() -> None:
    trajectory = move(HOME, HOME + 0.3, 4.0, points=500)
    best = np.inf
    for _ in range(5):
        start = perf_s()
        check_trajectory(trajectory, LIMITS)
        best = min(best, perf_s() - start)
    assert best < 0.02


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["times", "q", "qd"])
def test_numbers_must_be_finite(field: str, bad: float) -> None:
    values = getattr(GOOD, field).copy()
    values.flat[-1] = bad
    assert refusal(changed(GOOD, **{field: values})) == RefusalCode.NOT_FINITE


def test_shapes_and_times_are_checked() -> None:
    assert refusal(changed(GOOD, q=GOOD.q[:, :5])) == RefusalCode.SHAPE
    assert refusal(changed(GOOD, qd=GOOD.qd[:-1])) == RefusalCode.SHAPE
    assert refusal(changed(GOOD, times=GOOD.times + 0.1)) == RefusalCode.SHAPE
    assert refusal(changed(GOOD, times=GOOD.times[::-1])) == RefusalCode.SHAPE
    twice = GOOD.times.copy()
    twice[5] = twice[4]
    assert refusal(changed(GOOD, times=twice)) == RefusalCode.SHAPE
    assert refusal(changed(GOOD, times=GOOD.times[:1], q=GOOD.q[:1], qd=GOOD.qd[:1])) == RefusalCode.SHAPE
    assert refusal(move(HOME, HOME + 0.1, 1e6, points=3)) == RefusalCode.RANGE


def test_it_must_end_at_rest() -> None:
    assert (
        refusal(changed(GOOD, times=GOOD.times[:90], q=GOOD.q[:90], qd=GOOD.qd[:90]))
        == RefusalCode.NOT_AT_REST
    )


def test_joint_angles_are_limited() -> None:
    start = np.array([0.0, -1.5, 2.9, 0.0, 0.0, 0.0])
    assert refusal(move(start, start + np.array([0, 0, 0.4, 0, 0, 0]), 3.0)) == RefusalCode.JOINT_LIMIT


def test_joint_speeds_are_limited() -> None:
    folded = np.array([0.0, -1.5, 0.0, 0.0, 0.0, -5.0])
    assert refusal(move(folded, folded + np.array([0, 0, 0, 0, 0, 9.0]), 2.4)) == RefusalCode.VELOCITY_LIMIT


def test_accelerations_are_limited_and_jumps_show() -> None:
    assert refusal(move(HOME, HOME + np.array([0, 0, 0, 0, 0, 1.0]), 0.6)) == RefusalCode.ACCELERATION_LIMIT
    jump = GOOD.q.copy()
    jump[100:] += [0, 0, 0.002, 0, 0, 0]
    assert refusal(changed(GOOD, q=jump)) == RefusalCode.ACCELERATION_LIMIT


def test_tool_speed_is_limited() -> None:
    stretched = np.array([0.0, -0.3, 0.0, 0.0, 0.0, 0.0])
    assert refusal(move(stretched, stretched + np.array([2.4, 0, 0, 0, 0, 0]), 2.2)) == RefusalCode.TCP_SPEED


def test_limits_hold_between_sparse_points_too() -> None:
    # Two points at rest: the cubic between them peaks at 1.5 times the mean speed.
    far = HOME + np.array([0, 0, 0, 0, 0, 4.5])
    sparse = Trajectory(1, "t", 0.0, 1.0, np.array([0.0, 1.0]), np.stack([HOME, far]), np.zeros((2, 6)))
    assert refusal(sparse) == RefusalCode.ACCELERATION_LIMIT
    slow = changed(sparse, times=np.array([0.0, 1.9]))
    assert (needed_acceleration(slow.times, slow.q, slow.qd, short=0.02) < 8.0).all()
    check_trajectory(slow, LIMITS)


@given(st.floats(0.0, 1.0), st.floats(0.5, 8.0), st.floats(-2.0, 2.0), st.floats(0.001, 0.02))
def test_short_segments_of_any_motion_within_the_limit_pass(
    split: float, a: float, v: float, h: float
) -> None:
    """Full acceleration and then full braking, switched anywhere in a segment, needs exactly that limit."""
    t1 = split * h
    v1 = v + a * t1 - a * (h - t1)
    dq = v * t1 + 0.5 * a * t1**2 + (v + a * t1) * (h - t1) - 0.5 * a * (h - t1) ** 2
    q, qd = np.zeros((2, 6)), np.zeros((2, 6))
    q[1], qd[0], qd[1] = dq, v, v1
    needed = needed_acceleration(np.array([0.0, h]), q, qd, short=0.02)
    assert needed.max() == pytest.approx(a, rel=1e-6, abs=1e-6)


def test_limits_are_the_published_ones() -> None:
    assert np.allclose(np.degrees(QD_MAX), [180, 180, 180, 360, 360, 360])
    assert np.allclose(np.degrees(LIMITS.q_max), [360, 360, 180, 360, 360, 360])
