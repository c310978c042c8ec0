"""Inverse kinematics: every solution is one, the nearest branch is taken, limits are kept."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cell.config import load
from cell.errors import PlanError
from cell.frames import pose, rot_x
from cell.limits import DH_D, Q_MAX, link_frames
from cell.motion.kinematics import Kinematics, family

CONFIG = load()
KINEMATICS = Kinematics(CONFIG)
HOME = np.array(CONFIG.arm.home)
JOINTS = arrays(np.float64, 6, elements=st.floats(-2.9, 2.9))


@given(JOINTS)
def test_solutions_reach_the_pose_within_the_limits(q: np.ndarray) -> None:
    X_WT = KINEMATICS.X_WT(q)
    for s in KINEMATICS.ik(X_WT, HOME):
        assert np.allclose(KINEMATICS.X_WT(s), X_WT, atol=1e-6)
        assert (np.abs(s) <= Q_MAX - 0.1 + 1e-9).all()


@given(JOINTS)
def test_a_pose_made_from_joints_is_solved_by_these_joints(q: np.ndarray) -> None:
    # Near a singularity (wrist aligned, arm stretched) joints are not determined by the pose.
    if min(abs(np.sin(q[4])), abs(np.sin(q[2]))) < 0.05:
        return
    found = KINEMATICS.ik(KINEMATICS.X_WT(q), q)
    ahead = link_frames(q)[0, 4, :2, 3]
    if np.hypot(*ahead) < DH_D[3] + 0.01:
        return
    assert min(np.abs(s - q).max() for s in found) < 1e-5


@given(JOINTS, st.integers(0, 5), st.sampled_from([-1, 1]))
def test_each_joint_takes_the_nearer_turn(q: np.ndarray, joint: int, turn: int) -> None:
    near = q.copy()
    near[joint] += 2 * np.pi * turn
    for s in KINEMATICS.ik(KINEMATICS.X_WT(q), near):
        for j in range(6):
            for other in (s[j] - 2 * np.pi, s[j] + 2 * np.pi):
                if abs(other) <= Q_MAX[j] - 0.1:
                    assert abs(s[j] - near[j]) <= abs(other - near[j]) + 1e-9


@given(JOINTS)
def test_jacobian_is_the_derivative_of_the_pose(q: np.ndarray) -> None:
    J, X, step = KINEMATICS.jacobian(q), KINEMATICS.X_WT(q), 1e-6
    for j in range(6):
        d = np.zeros(6)
        d[j] = step
        Y = KINEMATICS.X_WT(q + d)
        W = (Y[:3, :3] @ X[:3, :3].T - np.eye(3)) / step
        assert np.allclose((Y[:3, 3] - X[:3, 3]) / step, J[:3, j], atol=1e-5)
        assert np.allclose([W[2, 1], W[0, 2], W[1, 0]], J[3:, j], atol=1e-5)


def test_home_family_covers_the_pick_window() -> None:
    b = CONFIG.belt
    for x in np.linspace(*b.pick_x, 4):
        for y in np.linspace(*b.pick_y, 7):
            q = KINEMATICS.ik_near(pose(rot_x(np.pi), (x, y, b.top_z + 0.035)), HOME)
            assert family(q) == family(HOME)


def test_unreachable_poses_are_named() -> None:
    with pytest.raises(PlanError, match=r"\(0\.900, 0\.000, 0\.100\) m is out of the UR3e's reach"):
        KINEMATICS.ik_near(pose(rot_x(np.pi), (0.9, 0.0, 0.1)), HOME)
