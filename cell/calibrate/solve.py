"""From views of the board to camera, board and intrinsics.

A closed form starts it: robot-world / hand-eye calibration by the Kronecker product (M. Shah, "Solving
the Robot-World/Hand-Eye Calibration Problem Using the Kronecker Product", J. Mechanisms Robotics 5(3),
2013) over the board's poses by `cv2.solvePnP`. Bundle adjustment ends it: the sum over all corners of
all views is least, with Huber's loss and weak priors from the configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.calibrate.board import Board, Corners
from cell.calibrate.model import CAMERA, INTRINSICS, PRIOR, SIZE, Guess
from cell.errors import CalibrationError
from cell.frames import Array, Pinhole, inverse, pose, rotation

CORNER_NOISE = 0.1
"""Standard deviation of a found corner [px]: weighs corners against priors; residuals say what it was."""
_HUBER = 4.0
"""Corners so many standard deviations off weigh less than in least squares."""


@dataclass(frozen=True)
class View:
    """One picture of the board.

    Attributes:
        q: joint angles (6,) [rad]. X_WT: pose of the TCP there (4, 4). corners: what was found.
        speed: largest joint speed round the exposure [rad/s]. drift: change of any joint meanwhile [rad].
    """

    q: Array
    X_WT: Array
    corners: Corners
    speed: float = 0.0
    drift: float = 0.0


@dataclass(frozen=True)
class Solution:
    """What the views say.

    Attributes:
        guess: the values. residual: root mean square distance of the corners from it [px].
        worst: the same of the worst view [px]. sd_position [m], sd_rotation [rad]: of the camera's pose.
        sd_focal, sd_centre: of fx, fy as a share, of cx, cy [px]. views, corners: how many.
    """

    guess: Guess
    residual: float
    worst: float
    sd_position: float
    sd_rotation: float
    sd_focal: float
    sd_centre: float
    views: int
    corners: int


def solve(views: Sequence[View], board: Board, configured: Guess) -> Solution:
    """The most likely values.

    Args:
        views: of a set that `cell.calibrate.check` accepts.
        configured: intrinsics to start from, and the centre of the weak priors.

    Raises:
        CalibrationError: the equations have no finite solution.
    """
    from scipy.optimize import least_squares

    X_WT = np.array([v.X_WT for v in views])
    seen = np.zeros((len(views), len(board.points_B)), dtype=bool)
    uv = np.zeros((*seen.shape, 2))
    for i, view in enumerate(views):
        seen[i, view.corners.ids] = True
        uv[i, view.corners.ids] = view.corners.uv

    def errors(x: Array) -> Array:
        found = configured.moved(x).corners(X_WT, board.points_B)
        return np.concatenate([((found - uv)[seen] / CORNER_NOISE).ravel(), x / PRIOR])

    start = _as_change(configured, closed_form(views, board, configured.pinhole))
    # the closed form trusts every board's pose alike; where the configured values fit better, they start
    best = min((start, np.zeros(SIZE)), key=lambda x: float(np.abs(errors(x)).sum()))
    result = least_squares(errors, best, loss="huber", f_scale=_HUBER, x_scale=PRIOR, max_nfev=200)
    if not np.isfinite(result.x).all():
        raise CalibrationError("the views contradict each other: no camera pose explains them")
    guess = configured.moved(result.x)
    off = np.linalg.norm(guess.corners(X_WT, board.points_B) - uv, axis=2)
    by_view = np.sqrt(np.array([np.mean(row[mask] ** 2) for row, mask in zip(off, seen, strict=True)]))
    residual = float(np.sqrt(np.mean(off[seen] ** 2)))
    sd = _deviations(guess, X_WT, board.points_B, seen, max(residual / np.sqrt(2), 1e-3))
    return Solution(
        guess=guess,
        residual=residual,
        worst=float(by_view.max()),
        sd_position=float(np.linalg.norm(sd[CAMERA][:3])),
        sd_rotation=float(np.linalg.norm(sd[CAMERA][3:])),
        sd_focal=float(sd[INTRINSICS][:2].max()),
        sd_centre=float(sd[INTRINSICS][2:].max() * guess.pinhole.fx),
        views=len(views),
        corners=int(seen.sum()),
    )


def closed_form(views: Sequence[View], board: Board, pinhole: Pinhole) -> tuple[Array, Array]:
    """X_WC and X_TB, shape (4, 4), from the board's poses in single pictures."""
    A = np.array([_board_pose(v.corners, board, pinhole) for v in views])  # X_CB
    B = np.array([v.X_WT for v in views])
    # X_CB X_BT = X_CW X_WT, first for the rotations: R_A R_X = R_Z R_B
    K = sum(np.kron(b[:3, :3], a[:3, :3]) for a, b in zip(A, B, strict=True))
    u, _, vt = np.linalg.svd(np.asarray(K))
    R_X, R_Z = _rotation_from(vt[0]), _rotation_from(u[:, 0])
    # then for the positions: R_A p_X - p_Z = R_Z p_B - p_A, linear in both
    rows = np.concatenate([np.hstack([a[:3, :3], -np.eye(3)]) for a in A])
    right = np.concatenate([R_Z @ b[:3, 3] - a[:3, 3] for a, b in zip(A, B, strict=True)])
    p = np.linalg.lstsq(rows, right, rcond=None)[0]
    X_BT, X_CW = pose(R_X, p[:3]), pose(R_Z, p[3:])
    return inverse(X_CW), inverse(X_BT)


def _rotation_from(vector: Array) -> Array:
    """The rotation nearest to a multiple of a 9-vector, column by column."""
    M = vector.reshape(3, 3, order="F")
    M = M * np.sign(np.linalg.det(M))
    u, _, vt = np.linalg.svd(M)
    out: Array = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return out


def _board_pose(corners: Corners, board: Board, pinhole: Pinhole) -> Array:
    """X_CB, shape (4, 4), from one picture."""
    K = np.array([[pinhole.fx, 0, pinhole.cx], [0, pinhole.fy, pinhole.cy], [0, 0, 1.0]])
    fine, rvec, tvec = cv2.solvePnP(board.points_B[corners.ids], corners.uv, K, None, flags=cv2.SOLVEPNP_IPPE)
    if not fine:
        raise CalibrationError(
            "the board's corners in one view have no pose; check 'board' in the configuration"
        )
    return pose(rotation(np.ravel(rvec)), np.ravel(tvec))


def _as_change(configured: Guess, poses: tuple[Array, Array]) -> Array:
    """x that leads from the configured poses to these."""
    x = np.zeros(SIZE)
    for part, before, after in ((0, configured.X_WC, poses[0]), (6, configured.X_TB, poses[1])):
        X = inverse(before) @ after
        x[part : part + 3] = X[:3, 3]
        x[part + 3 : part + 6] = np.ravel(cv2.Rodrigues(X[:3, :3])[0])
    return x


def _deviations(guess: Guess, X_WT: Array, points_B: Array, seen: NDArray[np.bool_], noise: float) -> Array:
    """Standard deviations (16,) of x, for corners with `noise` [px]."""
    J = guess.jacobian(X_WT, points_B)[seen].reshape(-1, SIZE)
    information = J.T @ J / noise**2 + np.diag(PRIOR**-2)
    out: Array = np.sqrt(np.diag(np.linalg.inv(information)))
    return out
