"""What the camera should see of the board: the one equation of the calibration, and its derivatives.

    uv = project(K, X_CW X_WT(q) X_TB p_B)

Unknown are the camera's pose X_WC, how the board sits in the gripper X_TB, and fx, fy, cx, cy; the
arm's joints give X_WT. Small changes of these 16 numbers are a vector x: pose of the camera (shift [m],
turn [rad], in its own frame), pose of the board (the same), focal lengths and centre (shares of fx).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cell.frames import Array, Pinhole, inverse, pose, rotation

SIZE = 16
CAMERA, BOARD, INTRINSICS = slice(0, 6), slice(6, 12), slice(12, 16)
"""Parts of x."""
PRIOR = np.array([0.05] * 3 + [0.05] * 3 + [0.02] * 3 + [0.10] * 3 + [0.02, 0.02, 0.02, 0.02])
"""How far from what is configured each may be, as a standard deviation."""
_STEP = 1e-6


@dataclass(frozen=True)
class Guess:
    """One set of values.

    Attributes:
        X_WC, X_TB: poses of the camera in the world and of the board in the TCP frame, shape (4, 4).
        pinhole: the camera's intrinsics.
    """

    X_WC: Array
    X_TB: Array
    pinhole: Pinhole

    def moved(self, x: Array) -> Guess:
        """Changed by x, shape (16,)."""
        p, d = self.pinhole, x[INTRINSICS] * self.pinhole.fx
        return Guess(
            self.X_WC @ _small(x[CAMERA]),
            self.X_TB @ _small(x[BOARD]),
            replace(p, fx=p.fx + d[0], fy=p.fy + d[1], cx=p.cx + d[2], cy=p.cy + d[3]),
        )

    def corners(self, X_WT: Array, points_B: Array) -> Array:
        """Pixels (V, N, 2) of points (N, 3) [m] of the board at tool poses (V, 4, 4)."""
        X_CB = inverse(self.X_WC) @ X_WT @ self.X_TB
        p_C = points_B @ X_CB[:, :3, :3].transpose(0, 2, 1) + X_CB[:, None, :3, 3]
        return self.pinhole.project(p_C)

    def jacobian(self, X_WT: Array, points_B: Array) -> Array:
        """d corners / dx by central differences, shape (V, N, 2, 16)."""
        columns = []
        for step in np.eye(SIZE) * _STEP:
            ahead, behind = (self.moved(s * step).corners(X_WT, points_B) for s in (1.0, -1.0))
            columns.append((ahead - behind) / (2 * _STEP))
        return np.stack(columns, axis=-1)


def _small(v: Array) -> Array:
    """Pose (4, 4) from a shift and a turn, (6,)."""
    return pose(rotation(v[3:]), v[:3])
