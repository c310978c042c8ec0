"""Where a configured camera is and how it draws: what is believed, and what a simulation makes true."""

from __future__ import annotations

import numpy as np

from cell.frames import Array, Pinhole, from_quaternion, look_at, pose, rotation
from cell.settings import CameraConfig


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
