"""Analytic kinematics of the arm with its gripper, and the choice among the IK branches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from ur_analytic_ik import ur3e

from cell.config import CellConfig
from cell.errors import PlanError
from cell.frames import Array, inverse, pose
from cell.limits import DH_A, Q_MAX, fk_flange, link_frames, tcp_jacobian

X_BW = np.diag([-1.0, -1.0, 1.0, 1.0])
"""The world in the controller's base frame: a half turn about z (its own inverse)."""

_MARGIN = 0.10
"""Kept from the joint limits [rad]."""
_TURNS = 2 * np.pi * np.arange(-2.0, 3.0)[:, None]
_WEIGHTS = np.array([2.0, 2.0, 1.5, 1.0, 1.0, 0.5])
"""How much a radian of each joint counts when branches are compared: big joints swing more arm."""


class Kinematics:
    """Forward and inverse kinematics between joints q (6,) [rad] and the TCP pose X_WT (4, 4).

    IK solutions come in families: shoulder to the left or right of the tool, elbow up or down,
    wrist turned one way or the other. The family of `arm.home` is preferred everywhere, so that
    the arm does not turn itself over between two neighbouring poses.
    """

    def __init__(self, config: CellConfig) -> None:
        self._length = config.gripper.length
        self._X_ET = pose(p=(0.0, 0.0, self._length))
        self._X_TE = inverse(self._X_ET)
        self._home_family = _families(np.array([config.arm.home]))

    def X_WT(self, q: Array) -> Array:
        """Pose of the TCP, shape (4, 4)."""
        return fk_flange(q) @ self._X_ET

    def jacobian(self, q: Array) -> Array:
        """Geometric Jacobian (6, 6) at the TCP: rows 0-2 [m/rad], rows 3-5 [rad/rad], in W."""
        axes = np.vstack([[0.0, 0.0, 1.0], link_frames(q)[0, :5, :3, 2]])
        return np.vstack([tcp_jacobian(q, self._length)[0], axes.T])

    def ik(self, X_WT: Array, q_near: Array) -> list[Array]:
        """Every solution within the limits, each joint turned as near to `q_near` as they allow.

        Solutions of the home family come first, then those that need the least weighted travel
        from `q_near`. Empty when the pose is out of reach.
        """
        X_BE = np.ascontiguousarray(X_BW @ X_WT @ self._X_TE)
        raw = np.array(ur3e.inverse_kinematics(X_BE), dtype=float).reshape(-1, 6)
        q = _unwrap(raw, q_near)
        foreign = (_families(q) != self._home_family).any(axis=1)
        order = np.lexsort((np.abs(q - q_near) @ _WEIGHTS, foreign))
        return list(q[order])

    def ik_near(self, X_WT: Array, q_near: Array) -> Array:
        """The best solution of `ik`.

        Raises:
            PlanError: naming the pose, when it is out of reach.
        """
        found = self.ik(X_WT, q_near)
        if not found:
            x, y, z = X_WT[:3, 3]
            raise PlanError(f"the tool pose at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of the UR3e's reach")
        return found[0]

    def at_home_in(self, q: Array) -> bool:
        """Whether q is of the same family as `arm.home`."""
        return bool((_families(q[None]) == self._home_family).all())


def family(q: Array) -> tuple[bool, bool, bool]:
    """Which of the eight IK families q (6,) [rad] belongs to: shoulder, elbow, wrist."""
    shoulder, elbow, wrist = _families(q[None])[0]
    return bool(shoulder), bool(elbow), bool(wrist)


def _families(q: Array) -> NDArray[np.bool_]:
    """`family` of each of q (K, 6), shape (K, 3)."""
    # Horizontal distance of the wrist before the shoulder's axis, along the plane of the arm.
    ahead = DH_A[1] * np.cos(q[:, 1]) + DH_A[2] * np.cos(q[:, 1] + q[:, 2])
    return np.stack([ahead > 0, np.sin(q[:, 2]) > 0, np.sin(q[:, 4]) > 0], axis=1)


def _unwrap(q: Array, q_near: Array) -> Array:
    """Whole turns added so that each of q (K, 6) is nearest to q_near inside the limits.

    Solutions for which no number of turns is inside the limits are left out.
    """
    options = q[:, None] + _TURNS
    travel = np.where(np.abs(options) <= Q_MAX - _MARGIN, np.abs(options - q_near), np.inf)
    best = travel.argmin(axis=1)[:, None]
    possible = np.isfinite(np.take_along_axis(travel, best, axis=1)).all(axis=(1, 2))
    out: Array = np.take_along_axis(options, best, axis=1)[possible, 0]
    return out
