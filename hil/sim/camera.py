"""Sensor model of a stereo RGB-D camera, and the camera that exposes and delivers frames.

The depth error of a stereo camera is the error of its disparity: sigma_z = z^2 s / (f B),
with s [px] the disparity's standard deviation, f the imagers' focal length and B the
baseline. Where only one imager sees a point, or sees it at a grazing angle, there is no depth.
"""

from __future__ import annotations

import zlib
from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.cameras import true_pinhole, true_pose
from cell.frames import Array, Pinhole
from cell.settings import CameraConfig
from cell.wire.types import Frame
from hil.sim.render.renderer import Image, Pending

NEAR, FAR = 0.05, 12.0
"""Nearest and farthest distance drawn for the colour image [m]."""

_RGB_NOISE = 2.0
"""Standard deviation of the colour image's noise [grey levels]."""
_RGB_BLUR = 0.55
"""Standard deviation of the lens's blur [px]."""
_GRAZING = (4.0, 12.0)
"""Tangent of the angle of incidence: below the first no holes, above the second only holes."""
_SHADOW_TOLERANCE = 0.5
"""Disparity by which a nearer surface must cover a point to hide it [px]."""
_HALF_SIZE_GAIN = 1.0 / (0.75**2 + 0.25**2)
"""Linear interpolation to twice the size averages noise with weights 3/4, 1/4 per axis."""

# Integer noise levels by random byte: a table look-up is ten times faster than drawing normals.
_QUANTILES = (np.arange(256) + 0.5) / 256.0


def _noise_table(sigma: float) -> NDArray[np.uint8]:
    """256 equally likely noise levels, offset by 128, as quantiles of a normal distribution."""
    from statistics import NormalDist

    normal = NormalDist(0.0, sigma)
    return np.array([round(128 + normal.inv_cdf(float(q))) for q in _QUANTILES], dtype=np.uint8)


_RGB_TABLE = _noise_table(_RGB_NOISE)


def sense(
    image: Image, config: CameraConfig, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """What a real camera would report instead of the ideal image.

    Args:
        image: ideal picture of the configured size.
        config: the camera.
        rng: source of all randomness.

    Returns:
        rgb (H, W, 3) uint8 and depth (H, W) float32 [m], 0 where there is no reading.
    """
    return _sense_rgb(image.rgb, rng), sense_depth(image.depth, config, rng)


def _sense_rgb(rgb: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    blurred = cv2.GaussianBlur(rgb, (3, 3), _RGB_BLUR)
    drawn = np.frombuffer(rng.bytes(rgb.size), dtype=np.uint8).reshape(rgb.shape)
    noisy = cv2.addWeighted(blurred, 1.0, cv2.LUT(drawn, _RGB_TABLE), 1.0, -128.0)
    return np.asarray(noisy, dtype=np.uint8)


def sense_depth(
    depth: NDArray[np.float32], config: CameraConfig, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Stereo noise, quantisation, range limits and holes; see `sense`."""
    f = Pinhole.from_hfov(config.width, config.height, config.hfov).fx
    z = depth.astype(np.float32, copy=True)
    z[(z < config.min_depth) | (z > config.max_depth)] = 0.0
    holes = _hidden_from_second_imager(z, np.float32(f * config.depth_baseline))
    holes |= _grazing(z, np.float32(f), rng)
    sigma = np.float32(config.disparity_noise / (config.depth_focal * config.depth_baseline))
    z += z * z * sigma * _smooth_normal(z.shape, rng)
    unit = np.float32(config.depth_unit)
    z = np.round(z / unit) * unit
    z[holes | (z < config.min_depth) | (z > config.max_depth)] = 0.0
    return z


def _smooth_normal(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float32]:
    """Standard normal noise (H, W) that is similar over two or three pixels, as stereo noise is."""
    height, width = shape
    half = rng.standard_normal(((height + 1) // 2 + 1, (width + 1) // 2 + 1), dtype=np.float32)
    full = cv2.resize(half, (2 * half.shape[1], 2 * half.shape[0]), interpolation=cv2.INTER_LINEAR)
    # The outermost row and column are not interpolated; leave them out.
    return np.asarray(full[1 : height + 1, 1 : width + 1] * np.float32(_HALF_SIZE_GAIN), dtype=np.float32)


def _hidden_from_second_imager(z: NDArray[np.float32], f_baseline: np.float32) -> NDArray[np.bool_]:
    """Points that the imager at +x cannot see, because something nearer lies to their right.

    The second imager sees column u at u - d with d = f B / z; a point is hidden when another
    to its right lands as far to the left, which makes a band of f B (1 / z_near - 1 / z_far)
    pixels left of every nearer object.
    """
    disparity = np.zeros_like(z)
    np.divide(f_baseline, z, out=disparity, where=z > 0.0)
    place = np.arange(z.shape[1], dtype=np.float32) - disparity
    place[z == 0.0] = np.inf
    leftmost = np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1]
    return np.asarray((leftmost < place - _SHADOW_TOLERANCE) | (z == 0.0))


def _grazing(z: NDArray[np.float32], f: np.float32, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Random holes where the surface is seen at a grazing angle or ends at an edge."""
    dx = cv2.Sobel(z, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    dy = cv2.Sobel(z, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    slope = cv2.magnitude(dx, dy) * f
    low, high = _GRAZING
    risk = (slope - np.float32(low) * z) > 0.0
    rows, columns = np.nonzero(risk)
    chance = (slope[rows, columns] / np.maximum(z[rows, columns], 1e-3) - low) / (high - low)
    holes = np.zeros(z.shape, dtype=bool)
    holes[rows, columns] = rng.random(len(rows)) < chance
    return holes


class Camera:
    """One camera of the cell: when it exposes, what it reports, and when that arrives.

    Args:
        name: as in the configuration.
        config: the camera.
        seed: with the name and the frame number, decides all noise, so that results do not
            depend on the order in which cameras are asked.

    Attributes:
        pinhole: intrinsics. X_WC: pose, shape (4, 4). near, far: drawing range [m].
        seq: number of frames exposed so far.
    """

    def __init__(self, name: str, config: CameraConfig, seed: int) -> None:
        self.name = name
        self.config = config
        self.pinhole = true_pinhole(config)
        self.X_WC: Array = true_pose(config)
        self.near, self.far = NEAR, max(FAR, config.max_depth)
        self.seq = 0
        self._seed = (seed, zlib.crc32(name.encode()))
        self._periods = -1
        self._waiting: deque[tuple[int, float, Pending]] = deque()
        self._ready: deque[Frame] = deque()

    def wants_exposure(self, now: float) -> bool:
        """True once per period of a free-running camera, at its first call in that period."""
        if self.config.rate <= 0.0:
            return False
        periods = int(np.floor(now * self.config.rate + 1e-6))
        if periods <= self._periods:
            return False
        self._periods = periods
        return True

    @property
    def busy(self) -> bool:
        """Frames were exposed that are not delivered yet."""
        return bool(self._waiting)

    def expose(self, now: float, picture: Pending) -> None:
        """Take a frame of the ideal `picture` at time `now` [s]; `due` delivers it later."""
        self.seq += 1
        self._waiting.append((self.seq, now, picture))

    def develop(self) -> bool:
        """Make one frame that is not due yet; False when there is none to make."""
        if not self._waiting:
            return False
        seq, t, picture = self._waiting.popleft()
        rng = np.random.default_rng([*self._seed, seq])
        self._ready.append(Frame(self.name, seq, t, *sense(picture.image(), self.config, rng)))
        return True

    def due(self, now: float) -> list[Frame]:
        """Frames whose latency has passed at `now` [s], oldest first; each is returned once."""
        exposed = now - self.config.latency + 1e-9
        while self._waiting and self._waiting[0][1] <= exposed:
            self.develop()
        out = []
        while self._ready and self._ready[0].t <= exposed:
            out.append(self._ready.popleft())
        return out
