"""Kinematics of the emulated arms: published poses, the analytic solver, finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import ur_analytic_ik
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.emulator.kinematics import Kinematics, error
from hil.emulator.models import UR3E, UR5E
from hil.emulator.poses import (
    compose,
    frame_of,
    from_rotvec,
    invert,
    multiply,
    pose_of,
    pose_trans,
    quaternion,
    rotvec,
    slerp,
)

ARMS = {"ur3e": Kinematics(UR3E), "ur5e": Kinematics(UR5E)}
K = ARMS["ur3e"]
TCP = [0.1, 0.02, 0.2, 0.3, -0.4, 0.5]
joints = st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6)
rotvecs = st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3)


@pytest.mark.parametrize(
    ("q", "pose"),
    [
        ([-1.54, -1.83, -2.28, -0.59, 1.60, 0.023],
         [-0.119995, -0.273535, 0.120594, -0.012413, 3.111990, -0.018048]),
        ([0.3, -1.2, 1.1, -1.4, -1.5, 0.7],
         [-0.321443, -0.243430, 0.302456, 2.546676, 1.683626, 0.073301]),
        ([0.0] * 6, [-0.456750, -0.223150, 0.066500, 1.570796, 0.0, 0.0]),
    ],
)  # fmt: skip
def test_poses_of_the_published_parameters(q: list[float], pose: list[float]) -> None:
    assert np.allclose(K.pose(q, [0.0] * 6), pose, atol=1.1e-6)


@pytest.mark.parametrize("name", ARMS)
def test_forward_kinematics_is_that_of_the_analytic_solver(name: str) -> None:
    solver = getattr(ur_analytic_ik, name)
    rng = np.random.default_rng(1)
    for q in rng.uniform(-3, 3, (100, 6)):
        p, *axes = ARMS[name].flange(q.tolist())
        X = solver.forward_kinematics(*q)
        assert np.allclose(p, X[:3, 3], atol=1e-12) and np.allclose(np.array(axes).T, X[:3, :3], atol=1e-12)


@given(joints)
@settings(max_examples=60, deadline=None)
def test_the_jacobian_is_the_derivative(q: list[float]) -> None:
    offset, h = frame_of(TCP), 1e-6
    _, J = K.jacobian(q, offset)
    for j in range(6):
        up, down = list(q), list(q)
        up[j] += h
        down[j] -= h
        column = np.array(error(K.tool(up, offset), K.tool(down, offset))) / (2 * h)
        assert np.allclose(column, J[:, j], atol=1e-7)


@pytest.mark.parametrize("name", ARMS)
def test_inverse_kinematics_finds_the_pose_near_the_seed(name: str) -> None:
    arm = ARMS[name]
    rng = np.random.default_rng(2)
    for q in rng.uniform(-3, 3, (200, 6)):
        q[2] = np.copysign(max(abs(q[2]), 0.2), q[2])
        q[4] = np.copysign(max(abs(q[4]), 0.2), q[4])
        pose = arm.pose(q.tolist(), TCP)
        found = arm.ik(pose, TCP, (q + rng.uniform(-0.02, 0.02, 6)).tolist())
        assert found is not None
        assert np.allclose(pose_error(arm.pose(found, TCP), pose), 0.0, atol=1e-6)
        assert np.abs(found - q).max() < 0.05


def test_inverse_kinematics_keeps_turns_and_limits() -> None:
    q = [0.3, -1.2, 1.1, -1.4, -1.5, 0.7 - 2 * np.pi]
    assert np.allclose(K.ik(K.pose(q, TCP), TCP, q), q, atol=1e-7)
    far = [0.3, -1.2, 1.1, -1.4, -1.5, 7.0]
    found = K.ik(K.pose(far, TCP), TCP, far)
    assert found is not None and K.within(found) and found[5] == pytest.approx(7.0 - 2 * np.pi)


def test_inverse_kinematics_in_a_singularity_and_out_of_reach() -> None:
    stretched = [0.0] * 6
    found = K.ik(K.pose(stretched, [0.0] * 6), [0.0] * 6, [0.02] * 6)
    assert found is not None and np.allclose(
        K.pose(found, [0.0] * 6), K.pose(stretched, [0.0] * 6), atol=1e-6
    )
    assert K.ik([2.0, 0.0, 0.3, 0.0, 0.0, 0.0], [0.0] * 6, [0.0] * 6) is None
    assert K.ik([0.0, 0.0, 0.2, 0.0, 0.0, 0.0], [0.0] * 6, [0.0] * 6) is None


@given(rotvecs, rotvecs)
@settings(max_examples=100, deadline=None)
def test_rotations_agree_with_matrices(a: list[float], b: list[float]) -> None:
    x, y = frame_of([0.1, 0.2, 0.3, *a]), frame_of([-0.3, 0.1, 0.2, *b])
    product = quaternion(compose(x, y))
    other = multiply(from_rotvec(a), from_rotvec(b))
    assert min(np.abs(np.subtract(product, other)).max(), np.abs(np.add(product, other)).max()) < 1e-9
    assert np.allclose(np.array(compose(x, invert(x))[0]), 0.0, atol=1e-12)
    back = pose_of(x)
    assert np.allclose(pose_error(back, [0.1, 0.2, 0.3, *a]), 0.0, atol=1e-9)


def test_pose_trans_and_slerp() -> None:
    turned = pose_trans([1.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2], [0.5, 0.0, 0.0, 0.0, 0.0, np.pi / 2])
    assert np.allclose(turned, [1.0, 0.5, 0.0, 0.0, 0.0, np.pi], atol=1e-12)
    half = slerp(from_rotvec([0.0, 0.0, 0.0]), from_rotvec([0.0, 1.0, 0.0]), 0.5)
    assert np.allclose(rotvec(half), [0.0, 0.5, 0.0], atol=1e-12)


def pose_error(a: list[float], b: list[float]) -> list[float]:
    return error(frame_of(a), frame_of(b))
