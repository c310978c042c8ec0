"""Rigid transforms and the pinhole camera, in one notation.

`X_AB` is the pose of frame B in frame A: a 4x4 matrix with `p_A = X_AB @ p_B`.
`R_AB` is its rotation, `p_AP` the position [m] of point P in A. Frames used everywhere:

    W   world; equals ROS `base_link` of the arm (z up, x towards the belt)
    B   UR controller "base" (the frame of RTDE poses): W turned by pi about z
    E   flange, `tool0` (z out of the flange)
    T   tool centre point between the finger pads (z out of the gripper)
    C   camera, optical convention (x right, y down, z into the scene)
    O   onion
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rot_x(a: float) -> Array:
    """Rotation by `a` [rad] about x, shape (3, 3)."""
    c, s = np.cos(a), np.sin(a)
    return np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])


def rot_y(a: float) -> Array:
    """Rotation by `a` [rad] about y, shape (3, 3)."""
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, 0, s], [0, 1.0, 0], [-s, 0, c]])


def rot_z(a: float) -> Array:
    """Rotation by `a` [rad] about z, shape (3, 3)."""
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def rotation(v: object) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,) [rad] (Rodrigues)."""
    vector = np.asarray(v, dtype=float)
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    out: Array = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    return out


def angle_of(R: Array) -> float:
    """Angle of a rotation (3, 3) [rad], 0..pi."""
    sine = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(np.linalg.norm(sine), (np.trace(R) - 1) / 2))


def pose(R: Array | None = None, p: object = (0.0, 0.0, 0.0)) -> Array:
    """Pose from rotation (3, 3) and position (3,) [m], shape (4, 4)."""
    X = np.eye(4)
    if R is not None:
        X[:3, :3] = R
    X[:3, 3] = np.asarray(p, dtype=float)
    return X


def inverse(X_AB: Array) -> Array:
    """X_BA of a rigid X_AB, shape (4, 4)."""
    R_BA = X_AB[:3, :3].T
    return pose(R_BA, -R_BA @ X_AB[:3, 3])


def look_at(p_WC: object, p_WTarget: object) -> Array:
    """X_WC of a camera at `p_WC` whose optical axis passes through `p_WTarget` [m].

    The image's up direction is world z. Raises ValueError when looking straight up or down.
    """
    p = np.asarray(p_WC, dtype=float)
    z = np.asarray(p_WTarget, dtype=float) - p
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    if np.linalg.norm(x) < 1e-6:
        raise ValueError("look_at: the optical axis is vertical; move the target sideways")
    x /= np.linalg.norm(x)
    return pose(np.column_stack([x, np.cross(z, x), z]), p)


def quaternion(R: Array) -> Array:
    """Rotation matrix -> unit quaternion (x, y, z, w), w >= 0 (Shepperd's method)."""
    m = np.array(
        [
            1 + R[0, 0] - R[1, 1] - R[2, 2],
            1 - R[0, 0] + R[1, 1] - R[2, 2],
            1 - R[0, 0] - R[1, 1] + R[2, 2],
            1 + R[0, 0] + R[1, 1] + R[2, 2],
        ]
    )
    i = int(np.argmax(m))
    q = {
        0: [m[0], R[1, 0] + R[0, 1], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]],
        1: [R[1, 0] + R[0, 1], m[1], R[2, 1] + R[1, 2], R[0, 2] - R[2, 0]],
        2: [R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], m[2], R[1, 0] - R[0, 1]],
        3: [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], m[3]],
    }[i]
    out: Array = np.array(q) / np.linalg.norm(q)
    return out if out[3] >= 0 else np.negative(out)


def from_quaternion(q: object) -> Array:
    """Unit quaternion (x, y, z, w) -> rotation matrix (3, 3)."""
    x, y, z, w = np.asarray(q, dtype=float)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of an ideal camera; pixel (0, 0) is the CENTRE of the top-left pixel.

    Attributes:
        width, height: image size [px].
        fx, fy: focal lengths [px]. cx, cy: principal point [px].
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def from_hfov(cls, width: int, height: int, hfov: float) -> Pinhole:
        """Square pixels, centred, from the horizontal field of view [rad]."""
        f = width / 2 / np.tan(hfov / 2)
        return cls(width, height, f, f, (width - 1) / 2, (height - 1) / 2)

    def project(self, p_C: Array) -> Array:
        """Points (..., 3) [m] in the camera frame -> pixels (..., 2) [px] (u right, v down)."""
        p = np.asarray(p_C, dtype=float)
        return np.stack(
            [p[..., 0] / p[..., 2] * self.fx + self.cx, p[..., 1] / p[..., 2] * self.fy + self.cy],
            axis=-1,
        )

    def back_project(self, uv: object, z: object) -> Array:
        """Pixels (..., 2) [px] and depths (...) [m] along the optical axis -> points (..., 3) [m]."""
        uv_, z_ = np.asarray(uv, dtype=float), np.asarray(z, dtype=float)
        return np.stack(
            [(uv_[..., 0] - self.cx) / self.fx * z_, (uv_[..., 1] - self.cy) / self.fy * z_, z_],
            axis=-1,
        )
