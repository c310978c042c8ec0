"""Analytic kinematics of the arm with its gripper, and the choice among the IK branches."""

from __future__ import annotations

import numpy as np
from ur_analytic_ik import ur3e

from cell.config import CellConfig
from cell.errors import PlanError
from cell.frames import Array, inverse, pose
from cell.limits import Q_MAX, fk_flange

X_BW = np.diag([-1.0, -1.0, 1.0, 1.0])
"""The world in the controller's base frame: a half turn about z (its own inverse)."""

_MARGIN = 0.10
"""Kept from the joint limits [rad]."""
_WEIGHTS = np.array([2.0, 2.0, 1.5, 1.0, 1.0, 0.5])
"""How much a radian of each joint counts when branches are compared."""


class Kinematics:
    """Forward and inverse kinematics from joints q (6,) [rad] to the TCP pose X_WT."""

    def __init__(self, config: CellConfig) -> None:
        self._X_ET = pose(p=(0.0, 0.0, config.gripper.length))
        self._X_TE = inverse(self._X_ET)
        self._home = np.array(config.arm.home)

    def X_WT(self, q: Array) -> Array:
        """Pose of the TCP, shape (4, 4)."""
        return fk_flange(q) @ self._X_ET

    def ik(self, X_WT: Array, q_near: Array) -> list[Array]:
        """Every solution within the limits, each joint turned as near to `q_near` as they allow.

        Solutions in the arm's working family (elbow and wrist bent as at home) come first, then
        those that need the least travel from `q_near`.
        """
        X_BE = np.ascontiguousarray(X_BW @ X_WT @ self._X_TE)
        found = []
        for raw in ur3e.inverse_kinematics(X_BE):
            q = _unwrap(np.asarray(raw, dtype=float), q_near)
            if q is not None:
                found.append(q)
        return sorted(found, key=lambda q: (not self._working(q), float(_WEIGHTS @ np.abs(q - q_near))))

    def ik_near(self, X_WT: Array, q_near: Array) -> Array:
        """The best solution; raises `PlanError` naming the pose when there is none."""
        found = self.ik(X_WT, q_near)
        if not found:
            x, y, z = X_WT[:3, 3]
            raise PlanError(f"the tool pose at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of the UR3e's reach")
        return found[0]

    def _working(self, q: Array) -> bool:
        return bool(np.sign(q[2]) == np.sign(self._home[2]) and np.sin(q[4]) * np.sin(self._home[4]) > 0)


def _unwrap(q: Array, q_near: Array) -> Array | None:
    """Add whole turns so that q is nearest to q_near inside the limits; None if impossible."""
    out = np.empty(6)
    limit = Q_MAX - _MARGIN
    for i in range(6):
        options = q[i] + 2 * np.pi * np.arange(-2, 3)
        options = options[np.abs(options) <= limit[i]]
        if not len(options):
            return None
        out[i] = options[np.argmin(np.abs(options - q_near[i]))]
    return out
