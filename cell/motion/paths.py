"""Geometric joint paths: smooth curves q(s) through waypoints, without any timing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from cell.frames import Array


class JointPath:
    """A twice continuously differentiable curve q(s), s in [0, length].

    Two waypoints give a straight line in joint space; more give a natural cubic spline whose
    parameter is the accumulated joint distance, which keeps it from overshooting.

    Args:
        waypoints: at least two sets of joint angles, shape (M, 6) [rad]; repeated ones are
            dropped. Raises ValueError for other shapes.

    Attributes:
        length: end of the parameter, the joint-space length [rad] (at least 1e-6).
        pieces: number of the spline's pieces.
    """

    def __init__(self, waypoints: Sequence[Array] | Array) -> None:
        q = np.asarray(waypoints, dtype=float)
        if q.ndim != 2 or q.shape[1] != 6 or len(q) < 2:
            raise ValueError(f"a path needs at least two waypoints of 6 joints, got shape {q.shape}")
        kept = [0]
        for i in range(1, len(q) - 1):
            if np.linalg.norm(q[i] - q[kept[-1]]) > 1e-6 and np.linalg.norm(q[i] - q[-1]) > 1e-6:
                kept.append(i)
        q = q[[*kept, len(q) - 1]]
        steps = np.maximum(np.linalg.norm(np.diff(q, axis=0), axis=1), 1e-6)
        s = np.concatenate([[0.0], np.cumsum(steps)])
        self.length, self.pieces = float(s[-1]), len(steps)
        self._spline = CubicSpline(s, q, bc_type="natural")

    def __call__(self, s: Array | float, order: int = 0) -> Array:
        """The `order`-th derivative by s at s; shape (..., 6)."""
        out: Array = self._spline(s, order)
        return out

    @property
    def start(self) -> Array:
        """First joint angles (6,) [rad]."""
        return self(0.0)

    @property
    def end(self) -> Array:
        """Last joint angles (6,) [rad]."""
        return self(self.length)

    def samples(self, step: float) -> Array:
        """Joint angles (M, 6) [rad] along the path, at most `step` rad apart, ends included."""
        return self(np.linspace(0.0, self.length, max(2, int(np.ceil(self.length / step)) + 1)))
