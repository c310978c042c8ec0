"""Makes a real camera's images those of the ideal camera that the configuration describes.

Perception and planning know the ideal pinhole only. Distortion, other focal lengths and another
principal point are taken out by resampling once per picture; depth is a distance along the optical
axis, which resampling leaves as it is.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.config import CellConfig
from cell.errors import BackendError
from cell.frames import Array, Pinhole
from cell.settings import CameraConfig

_COVERAGE = 0.9
"""Share of the ideal image that the device must see."""
_ITERATIONS = 20


class Rectifier:
    """Resamples RGB-D pictures of one device.

    Args:
        camera: the ideal camera. device: intrinsics of the device's colour image.
        distortion: k1, k2, p1, p2, k3 of Brown and Conrady's model; None or zeros: none.
        inverse: these coefficients lead from distorted to ideal coordinates, not the other way.

    Raises:
        BackendError: the device does not see what the configuration promises.
    """

    def __init__(
        self,
        name: str,
        camera: CameraConfig,
        device: Pinhole,
        distortion: tuple[float, ...] | None = None,
        *,
        inverse: bool = False,
    ) -> None:
        self.pinhole = Pinhole.from_hfov(camera.width, camera.height, camera.hfov)
        self._near, self._far = camera.min_depth, camera.max_depth
        ideal = self.pinhole
        u, v = np.meshgrid(np.arange(ideal.width, dtype=float), np.arange(ideal.height, dtype=float))
        x, y = (u - ideal.cx) / ideal.fx, (v - ideal.cy) / ideal.fy
        if distortion is not None and any(distortion):
            x, y = _undo(x, y, distortion) if inverse else brown_conrady(x, y, distortion)
        self._u = (x * device.fx + device.cx).astype(np.float32)
        self._v = (y * device.fy + device.cy).astype(np.float32)
        inside = (self._u > -0.5) & (self._u < device.width - 0.5)
        inside &= (self._v > -0.5) & (self._v < device.height - 0.5)
        if inside.mean() < _COVERAGE:
            seen = 2 * np.arctan(device.width / 2 / device.fx)
            raise BackendError(
                f"camera {name} sees only {inside.mean() * 100:.0f} % of the configured image; its own field "
                f"of view is {seen:.2f} rad: set cameras.{name}.hfov to about that, or less"
            )

    def picture(
        self, rgb: NDArray[np.uint8], depth: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Both images as the ideal camera would see them.

        Args:
            rgb: shape (H, W, 3). depth: shape (H, W) [m], registered to it; 0 where there is none.
        """
        colour = cv2.remap(rgb, self._u, self._v, cv2.INTER_LINEAR)
        distance = cv2.remap(depth, self._u, self._v, cv2.INTER_NEAREST)
        fine = np.isfinite(distance) & (distance >= self._near) & (distance <= self._far)
        return np.asarray(colour, np.uint8), np.where(fine, distance, np.float32(0.0)).astype(np.float32)


def check_size(name: str, config: CellConfig, width: int, height: int) -> None:
    """Raise `BackendError` unless pictures are of the configured size."""
    camera = config.cameras[name]
    if (width, height) != (camera.width, camera.height):
        raise BackendError(
            f"camera {name}: pictures of {width} x {height} pixels, configured are {camera.width} x "
            f"{camera.height}"
        )


def brown_conrady(x: Array, y: Array, k: tuple[float, ...]) -> tuple[Array, Array]:
    """Distorted image coordinates (at focal length 1) of ideal ones."""
    k1, k2, p1, p2, k3 = k
    r2 = x * x + y * y
    f = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * f + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * f + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
    )


def _undo(x: Array, y: Array, k: tuple[float, ...]) -> tuple[Array, Array]:
    """The coordinates that `brown_conrady` turns into (x, y)."""
    a, b = x.copy(), y.copy()
    for _ in range(_ITERATIONS):
        fx, fy = brown_conrady(a, b, k)
        a, b = a - (fx - x), b - (fy - y)
    return a, b
