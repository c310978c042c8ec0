"""The ChArUco board: where its corners are, and where they are in a picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.cameras import board_pose, board_size
from cell.frames import Array
from cell.settings import BoardConfig

_ENLARGED = 2
"""Markers of a distant board are small; they are looked for in a picture enlarged so many times."""
_WINDOW = 0.22
"""Half the side of the window in which a corner is refined, as a share of a square."""
_BALL = 0.03
"""Spacing of the spheres that stand for the plate [m]."""
_LEAST_WINDOW, _LARGEST_WINDOW = 2, 8
"""[px]"""


@dataclass(frozen=True)
class Corners:
    """Corners of the pattern in one picture.

    Attributes:
        ids: which, shape (K,). uv: where, shape (K, 2) [px].
        edge: typical width of the pattern's edges, from dark to bright [px]; large when blurred.
    """

    ids: NDArray[np.intp]
    uv: Array
    edge: float


class Board:
    """Geometry and detection of one board.

    Attributes:
        points_B: the pattern's inner corners, shape (N, 3) [m]; B lies in the pattern's middle, x along
            the rows, y down the columns, z into the board.
        outline_B: corners of the plate, shape (4, 3) [m].
        X_TB: its pose in the TCP frame as it is meant to be held, shape (4, 4).
    """

    def __init__(self, config: BoardConfig) -> None:
        self.config = config
        columns, rows = config.columns, config.rows
        x, y = np.meshgrid(np.arange(1, columns) - columns / 2, np.arange(1, rows) - rows / 2)
        self.points_B: Array = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1) * config.square
        self.X_TB = board_pose(config)
        across, down = board_size(config)
        self.outline_B: Array = np.array([[i * across / 2, j * down / 2, 0.0] for i, j in _AROUND])

    def spheres(self) -> Array:
        """Spheres (S, 4) (centre, radius) [m] in the TCP frame that enclose the plate."""
        across, down = (self.outline_B[:, k].max() for k in (0, 1))
        x, y = (np.linspace(-e, e, 2 * int(e / _BALL) + 1) for e in (across, down))
        grid = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1).reshape(-1, 3)
        p_T = grid @ self.X_TB[:3, :3].T + self.X_TB[:3, 3]
        return np.column_stack([p_T, np.full(len(p_T), 0.75 * _BALL)])

    @cached_property
    def pattern(self) -> Any:
        """OpenCV's own description."""
        c = self.config
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{c.dictionary}"))
        return cv2.aruco.CharucoBoard((c.columns, c.rows), c.square, c.square * c.marker, dictionary)

    @cached_property
    def _detector(self) -> Any:
        return cv2.aruco.CharucoDetector(self.pattern)

    def picture(self, square: int) -> NDArray[np.uint8]:
        """The pattern without its margin, `square` pixels per square, shape (H, W)."""
        size = self.config.columns * square, self.config.rows * square
        return np.asarray(self.pattern.generateImage(size, marginSize=0, borderBits=1), np.uint8)

    def find(self, rgb: NDArray[np.uint8]) -> Corners:
        """Corners of the pattern in a picture (H, W, 3); none when it is not seen."""
        grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)
        k = _ENLARGED
        large = cv2.resize(grey, None, fx=k, fy=k, interpolation=cv2.INTER_CUBIC)
        uv, ids, _, _ = self._detector.detectBoard(large)
        if ids is None or not len(ids):
            return Corners(np.zeros(0, np.intp), np.zeros((0, 2)), 0.0)
        ids = np.asarray(ids, np.intp).ravel()
        rough = (np.asarray(uv, float).reshape(-1, 2) + 0.5) / k - 0.5
        square = self._square(ids, rough)
        window = int(np.clip(_WINDOW * square, _LEAST_WINDOW, _LARGEST_WINDOW))
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
        start = rough.astype(np.float32).reshape(-1, 1, 2)
        fine = cv2.cornerSubPix(grey, start, (window, window), (-1, -1), stop)
        found = np.asarray(fine, float).reshape(-1, 2)
        kept = np.linalg.norm(found - rough, axis=1) < window
        return Corners(ids[kept], found[kept], _edge(grey, found[kept], window))

    def _square(self, ids: NDArray[np.intp], uv: Array) -> float:
        """Side of a square in the picture, roughly [px]."""
        if len(ids) < 2:
            return 2.0 * _LARGEST_WINDOW
        apart = np.linalg.norm(self.points_B[ids][:, None] - self.points_B[ids], axis=2)
        near = np.isclose(apart, self.config.square, rtol=0.01)
        if not near.any():
            return 2.0 * _LARGEST_WINDOW
        return float(np.min(np.linalg.norm(uv[:, None] - uv, axis=2)[near]))


_AROUND = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _edge(grey: NDArray[np.uint8], uv: Array, window: int) -> float:
    """Width of edges at the corners [px]: contrast over the steepest slope; the median of all."""
    widths = []
    size = 2 * window + 3
    for u, v in uv:
        patch = cv2.getRectSubPix(grey, (size, size), (float(u), float(v))).astype(np.float32)
        low, high = np.percentile(patch, (5, 95))
        dx = cv2.Sobel(patch, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
        dy = cv2.Sobel(patch, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
        slope = np.percentile(np.hypot(dx, dy), 95)
        widths.append(float(high - low) / max(float(slope), 1e-3))
    return float(np.median(widths)) if widths else 0.0
