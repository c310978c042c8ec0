"""The light's view: an orthographic box around everything that casts a shadow."""

from __future__ import annotations

import numpy as np

from cell.frames import Array

_STEP = 0.25
"""The box grows in these steps, so that shadows do not crawl while things move [m]."""


def shadow_from_world(to_light: Array, centers: Array, radii: Array) -> Array:
    """World -> shadow map coordinates 0..1 (x, y: the map; z: away from the light), shape (4, 4).

    Args:
        to_light: unit vector towards the light, shape (3,).
        centers, radii: bounding spheres of the casters, shape (N, 3), (N,) [m].
    """
    helper = np.array([1.0, 0.0, 0.0]) if abs(to_light[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = np.cross(helper, to_light)
    x /= np.linalg.norm(x)
    R_LW = np.stack([x, np.cross(to_light, x), -to_light])
    if not len(radii):
        centers, radii = np.zeros((1, 3)), np.ones(1)
    p = centers @ R_LW.T
    low, high = (p - radii[:, None]).min(axis=0), (p + radii[:, None]).max(axis=0)
    side = np.ceil((high - low) / _STEP + 1.0) * _STEP
    low = np.floor(low / _STEP) * _STEP
    out = np.eye(4)
    out[:3, :3] = R_LW / side[:, None]
    out[:3, 3] = -low / side
    return out
