"""Where a configured camera is and how it draws: what is believed, and what a simulation makes true."""

from __future__ import annotations

import numpy as np

from cell.frames import Array, Pinhole, from_quaternion, look_at, pose, rot_x, rot_z, rotation
from cell.settings import BoardConfig, CameraConfig


def camera_pose(camera: CameraConfig) -> Array:
    """X_WC, shape (4, 4): as calibrated, else as position and target say."""
    if camera.calibration is None:
        return look_at(camera.position, camera.target)
    q = np.asarray(camera.calibration.quaternion)
    return pose(from_quaternion(q / np.linalg.norm(q)), camera.calibration.position)


def camera_pinhole(camera: CameraConfig) -> Pinhole:
    """Intrinsics of the pictures on the wire: as calibrated, else those of the ideal camera."""
    if camera.calibration is None:
        return Pinhole.from_hfov(camera.width, camera.height, camera.hfov)
    (fx, fy), (cx, cy) = camera.calibration.focal, camera.calibration.centre
    return Pinhole(camera.width, camera.height, fx, fy, cx, cy)


def true_pose(camera: CameraConfig) -> Array:
    """X_WC of a simulated camera, shape (4, 4): displaced where `simulated` says so."""
    if camera.simulated is None:
        return camera_pose(camera)
    X = look_at(camera.position, camera.target)
    return pose(X[:3, :3] @ rotation(camera.simulated.turn), X[:3, 3] + camera.simulated.shift)


def true_pinhole(camera: CameraConfig) -> Pinhole:
    """Intrinsics of a simulated camera."""
    if camera.simulated is None:
        return camera_pinhole(camera)
    p = Pinhole.from_hfov(camera.width, camera.height, camera.hfov)
    (kx, ky), (dx, dy) = camera.simulated.focal, camera.simulated.centre
    return Pinhole(p.width, p.height, kx * p.fx, ky * p.fy, p.cx + dx, p.cy + dy)


def board_pose(board: BoardConfig) -> Array:
    """X_TB of the calibration board as it is meant to be held, shape (4, 4).

    B lies in the middle of the pattern, x along its rows, y down its columns, z into the board.
    """
    return pose(rot_z(np.pi / 2) @ rot_x(-np.pi / 2), (0.0, 0.0, board.height))


def board_size(board: BoardConfig) -> tuple[float, float]:
    """Width and height of the board's plate [m]."""
    return (
        (board.columns + 2 * board.margin) * board.square,
        (board.rows + 2 * board.margin) * board.square,
    )
