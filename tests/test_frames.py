"""Axioms of the one notation for poses, and of the pinhole camera."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from cell.frames import (
    Array,
    Pinhole,
    from_quaternion,
    inverse,
    look_at,
    pose,
    quaternion,
    rot_x,
    rot_y,
    rot_z,
)

angle = st.floats(-7.0, 7.0)
vector = arrays(float, 3, elements=st.floats(-5.0, 5.0))
rotation = st.tuples(angle, angle, angle).map(lambda a: rot_z(a[0]) @ rot_y(a[1]) @ rot_x(a[2]))
poses = st.tuples(rotation, vector).map(lambda a: pose(*a))
# Near-half-turns are where conversions to quaternions go wrong.
half_turn = st.tuples(vector, st.floats(-1e-7, 1e-7)).filter(lambda a: np.linalg.norm(a[0]) > 0.1)
half_turns = half_turn.map(
    lambda a: Rotation.from_rotvec(a[0] / np.linalg.norm(a[0]) * (np.pi + a[1])).as_matrix()
)


def is_rotation(R: Array) -> bool:
    return np.allclose(R @ R.T, np.eye(3), atol=1e-12) and bool(np.isclose(np.linalg.det(R), 1.0))


@given(poses, poses, vector)
def test_inverse_and_composition(X_AB: Array, X_BC: Array, p_C: Array) -> None:
    np.testing.assert_allclose(inverse(X_AB) @ X_AB, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(inverse(inverse(X_AB)), X_AB, atol=1e-12)
    np.testing.assert_allclose(inverse(X_AB @ X_BC), inverse(X_BC) @ inverse(X_AB), atol=1e-11)
    p = np.append(p_C, 1.0)
    np.testing.assert_allclose((X_AB @ X_BC) @ p, X_AB @ (X_BC @ p), atol=1e-11)
    assert is_rotation((X_AB @ X_BC)[:3, :3])


@given(angle)
def test_elementary_rotations_agree_with_scipy(a: float) -> None:
    for axis, R in (("x", rot_x(a)), ("y", rot_y(a)), ("z", rot_z(a))):
        np.testing.assert_allclose(R, Rotation.from_euler(axis, a).as_matrix(), atol=1e-12)


@given(rotation | half_turns)
def test_quaternions_round_trip_and_agree_with_scipy(R: Array) -> None:
    q = quaternion(R)
    assert abs(np.linalg.norm(q) - 1.0) < 1e-12 and q[3] >= 0.0
    np.testing.assert_allclose(from_quaternion(q), R, atol=1e-9)
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), R, atol=1e-9)


@given(vector, vector)
def test_look_at_points_the_axis_at_the_target_with_the_image_upright(p: Array, target: Array) -> None:
    if np.linalg.norm((target - p)[:2]) < 1e-3:
        return
    X_WC = look_at(p, target)
    assert is_rotation(X_WC[:3, :3])
    p_CTarget = inverse(X_WC) @ np.append(target, 1.0)
    np.testing.assert_allclose(p_CTarget[:2], 0.0, atol=1e-9)
    assert p_CTarget[2] > 0.0
    assert abs(X_WC[2, 0]) < 1e-9 and X_WC[2, 1] < 0.0  # image x is level, image y points down


def test_look_at_refuses_a_vertical_view() -> None:
    with pytest.raises(ValueError, match="vertical"):
        look_at((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


@given(st.integers(16, 2000), st.integers(16, 2000), st.floats(0.2, 2.5), vector)
def test_projection_and_back_projection_undo_each_other(w: int, h: int, hfov: float, p: Array) -> None:
    camera = Pinhole.from_hfov(w, h, hfov)
    p_C = np.array([p[0], p[1], abs(p[2]) + 0.1])
    np.testing.assert_allclose(camera.back_project(camera.project(p_C), p_C[2]), p_C, atol=1e-9)


@given(st.integers(16, 2000), st.floats(0.2, 2.5))
def test_the_field_of_view_spans_the_image_from_edge_to_edge(width: int, hfov: float) -> None:
    """Pixel centres are whole numbers, so the edges lie half a pixel outside."""
    camera = Pinhole.from_hfov(width, 480, hfov)
    left = camera.project(np.array([-np.tan(hfov / 2), 0.0, 1.0]))
    right = camera.project(np.array([np.tan(hfov / 2), 0.0, 1.0]))
    np.testing.assert_allclose([left[0], right[0]], [-0.5, width - 0.5], atol=1e-6)
    np.testing.assert_allclose(left[1], (480 - 1) / 2)


def test_projection_works_on_stacks() -> None:
    camera = Pinhole.from_hfov(640, 480, 1.0)
    p_C = np.random.default_rng(1).uniform(0.5, 2.0, (4, 5, 3))
    assert camera.project(p_C).shape == (4, 5, 2)
    np.testing.assert_allclose(camera.back_project(camera.project(p_C), p_C[..., 2]), p_C)
