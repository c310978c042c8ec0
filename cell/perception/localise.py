"""From a box in the image to an onion in the world: depth, pinhole, extrinsics, a sphere.

A box gives the onion's direction and its apparent size; the depth image gives the near side
of its surface. The centre is the sphere of the apparent radius that fits the surface best
(Gauss-Newton on point-to-sphere distances, Huber weights), so single bad depth readings,
edges and partly hidden onions do not pull it away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.frames import Array, Pinhole
from cell.wire.types import Box

_CENTRAL = 0.36
"""Share of the box's half-axes whose elliptic region is sure to lie on the onion, squared."""
_MIN_POINTS = 25
_MAX_POINTS = 600
_HUBER = 0.004
"""Residuals beyond this weigh less than in least squares [m]."""
_ITERATIONS = 8
_RADIUS_RANGE = (0.020, 0.055)
"""Radii outside are no onions [m]."""


@dataclass(frozen=True)
class Located:
    """An onion in the world.

    Attributes:
        p_WO: centre, shape (3,) [m]. radius: of the best sphere [m].
        residual: root mean square distance of the used depth points from the sphere [m].
    """

    p_WO: Array
    radius: float
    residual: float


def locate(box: Box, depth: NDArray[np.float32], pinhole: Pinhole, X_WC: Array) -> Located | None:
    """Centre and radius of the onion in `box`; None without enough valid depth.

    Args:
        box: detection, pixels.
        depth: registered depth image (H, W) [m], 0 where there is no reading.
        pinhole: intrinsics of both images.
        X_WC: pose of the camera in the world.
    """
    points_C, toward = _surface(box, depth, pinhole)
    if len(points_C) < _MIN_POINTS:
        return None
    near = float(np.median(np.linalg.norm(points_C, axis=1)))
    x0, y0, x1, y1 = box.box
    # The silhouette of a sphere subtends asin(r / d) on each side of its centre.
    middle = (x0 + x1) / 2, (y0 + y1) / 2
    across = _angle(pinhole, (x0, middle[1]), (x1, middle[1]))
    half_angle = 0.25 * (across + _angle(pinhole, (middle[0], y0), (middle[0], y1)))
    sine = min(float(np.sin(half_angle)), 0.3)
    radius = float(np.clip(near * sine / (1.0 - sine), *_RADIUS_RANGE))
    centre_C, residual = _fit(points_C, radius, toward * (near + radius))
    return Located(X_WC[:3, :3] @ centre_C + X_WC[:3, 3], radius, residual)


def _angle(pinhole: Pinhole, uv_a: tuple[float, float], uv_b: tuple[float, float]) -> float:
    """Angle between the rays through two pixels [rad]; a pixel spans less, the farther off the axis."""
    a, b = pinhole.back_project([uv_a, uv_b], [1.0, 1.0])
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _surface(box: Box, depth: NDArray[np.float32], pinhole: Pinhole) -> tuple[Array, Array]:
    """Valid depth points (N, 3) [m] in the middle of the box, and the unit vector to its centre."""
    height, width = depth.shape
    x0, y0, x1, y1 = box.box
    cx, cy, ax, ay = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2
    us = np.arange(max(0, int(cx - ax)), min(width, int(cx + ax) + 1))
    vs = np.arange(max(0, int(cy - ay)), min(height, int(cy + ay) + 1))
    u, v = np.meshgrid(us, vs)
    toward = pinhole.back_project(np.array([cx, cy]), np.array(1.0))
    toward = toward / np.linalg.norm(toward)
    if u.size == 0 or ax <= 0 or ay <= 0:
        return np.empty((0, 3)), toward
    z = depth[v, u].astype(float)
    inside = ((u - cx) / ax) ** 2 + ((v - cy) / ay) ** 2 <= _CENTRAL
    keep = inside & (z > 0)
    if not keep.any():
        return np.empty((0, 3)), toward
    # What hides the onion is nearer, what shows beside it farther: keep the main layer.
    keep &= np.abs(z - np.median(z[keep])) < 0.03
    uv = np.stack([u[keep], v[keep]], axis=-1)
    step = max(1, len(uv) // _MAX_POINTS)
    points: Array = pinhole.back_project(uv, z[keep])[::step]
    return points, toward


def _fit(points: Array, radius: float, start: Array) -> tuple[Array, float]:
    """Centre (3,) of the sphere of known radius nearest to the points, and its rms residual [m]."""
    centre = start.copy()
    residual = np.zeros(len(points))
    # The direction of the box's centre is known to about a pixel; the weak prior keeps the fit
    # from sliding along a small cap.
    prior = 0.02 * len(points)
    for _ in range(_ITERATIONS):
        offset = points - centre
        distance = np.linalg.norm(offset, axis=1)
        residual = distance - radius
        normal = -offset / distance[:, None]
        weight = np.minimum(1.0, _HUBER / np.maximum(np.abs(residual), 1e-9))
        across = np.eye(3) - np.outer(start, start) / float(start @ start)
        A = (normal * weight[:, None]).T @ normal + prior * across
        b = -(normal * weight[:, None]).T @ residual + prior * across @ (start - centre)
        step = np.linalg.solve(A, b)
        centre = centre + step
        if np.linalg.norm(step) < 1e-6:
            break
    return centre, float(np.sqrt(np.mean(residual**2)))
