"""Time-optimal timing of a joint path under joint speed, joint acceleration and tool speed.

The path parameter is s; x = (ds/dt)^2 at the grid's nodes, and u = d2s/dt2 is constant in each
segment, so x[i+1] = x[i] + 2 (s[i+1] - s[i]) u[i]. TOPP-RA (toppra, seidel, Interpolation)
finds the profile; this module keeps its own arrays, because the running plan's grid is what
later retiming works on.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from cell.config import CellConfig
from cell.errors import PlanError
from cell.frames import Array
from cell.limits import QD_MAX, tcp_jacobian
from cell.motion.paths import JointPath

_SEGMENTS = 200
_EPS = 1e-9


@dataclass(frozen=True)
class TimedPath:
    """A joint path with its timing, from rest to rest.

    Attributes:
        path: the geometry. s: nodes, shape (N + 1,). x: (ds/dt)^2 at the nodes, shape (N + 1,).
        t: times of the nodes [s], shape (N + 1,).
    """

    path: JointPath
    s: Array
    x: Array
    t: Array

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        return float(self.t[-1])

    def sample(self, times: Array) -> tuple[Array, Array]:
        """q [rad] and qd [rad/s], shape (M, 6), at times (M,) [s] from the start."""
        times = np.clip(np.asarray(times, dtype=float), 0.0, self.t[-1])
        i = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.s) - 2)
        root = np.sqrt(self.x)
        u = (self.x[i + 1] - self.x[i]) / (2 * (self.s[i + 1] - self.s[i]))
        tau = times - self.t[i]
        s = np.clip(self.s[i] + root[i] * tau + 0.5 * u * tau**2, self.s[0], self.s[-1])
        sdot = np.maximum(root[i] + u * tau, 0.0)
        return self.path(s), self.path(s, 1) * sdot[:, None]

    def to_points(self, period: float) -> tuple[Array, Array, Array]:
        """Times (M,) [s], q (M, 6) [rad], qd (M, 6) [rad/s] for the wire, at most `period` apart."""
        count = max(2, int(np.ceil(self.duration / period - 1e-9)) + 1)
        times = np.linspace(0.0, self.duration, count)
        q, qd = self.sample(times)
        qd[0] = qd[-1] = 0.0
        return times, q, qd


def time_path(path: JointPath, speed_cap: float, config: CellConfig) -> TimedPath:
    """Fastest rest-to-rest timing within the configured margins of the limits.

    Args:
        path: the geometry.
        speed_cap: TCP speed cap [m/s]; the plan keeps `motion.speed_margin` of it.

    Raises:
        PlanError: no timing exists (a numerical failure; a path from rest to rest has one).
    """
    motion, arm = config.motion, config.arm
    grid = np.linspace(0.0, path.length, _SEGMENTS + 1)
    bound = _bound(path, grid, motion.speed_margin * speed_cap, arm.velocity_scale, config.gripper.length)
    limit = motion.acceleration_margin * arm.max_acceleration
    x = _profile(path, grid, bound, limit)
    steps = np.diff(grid)
    speed = np.sqrt(x)
    dt = 2 * steps / np.maximum(speed[:-1] + speed[1:], _EPS)
    t = np.concatenate([[0.0], np.cumsum(dt)])
    return TimedPath(path, grid, x, t)


def _bound(path: JointPath, grid: Array, tcp_speed: float, scale: float, length: float) -> Array:
    """Largest x at each node by joint speeds and tool speed, shape (N + 1,)."""
    q, dq = path(grid), path(grid, 1)
    joints = (scale * QD_MAX / np.maximum(np.abs(dq), _EPS)).min(axis=1) ** 2
    dp = np.einsum("nij,nj->ni", tcp_jacobian(q, length), dq)
    tool = (tcp_speed / np.maximum(np.linalg.norm(dp, axis=1), _EPS)) ** 2
    out: Array = np.clip(np.minimum(joints, tool), 1e-9, 1e4)
    return out


def _profile(path: JointPath, grid: Array, bound: Array, acceleration: float) -> Array:
    """The fastest x(s) from rest to rest, by TOPP-RA."""
    ta = _toppra()
    limits = ta.constraint.JointAccelerationConstraint(
        np.tile([[-acceleration, acceleration]], (6, 1)),
        discretization_scheme=ta.constraint.DiscretizationType.Interpolation,
    )
    instance = ta.algorithm.TOPPRA(
        [_bound_constraint_class()(bound), limits],
        _toppra_path_class()(path),
        gridpoints=grid,
        solver_wrapper="seidel",
    )
    _, speed, _ = instance.compute_parameterization(0.0, 0.0)
    if speed is None or not np.isfinite(speed).all():
        raise PlanError("no timing found for a path")
    x: Array = np.minimum(np.asarray(speed, dtype=float) ** 2, bound)
    x[0] = x[-1] = 0.0
    return x


@cache
def _toppra() -> Any:
    """The toppra module, imported when first needed: it takes seconds."""
    import toppra
    import toppra.algorithm
    import toppra.constraint

    logging.getLogger("toppra").setLevel(logging.ERROR)
    toppra.setup_logging("ERROR")
    return toppra


@cache
def _bound_constraint_class() -> Any:
    ta = _toppra()

    class Bound(ta.constraint.LinearConstraint):  # type: ignore[misc, name-defined]
        """x between 0 and a bound per node, as toppra wants it."""

        def __init__(self, bound: Array) -> None:
            super().__init__()
            self.discretization_type = ta.constraint.DiscretizationType.Collocation
            self.dof = 6
            self._bound = bound

        def compute_constraint_params(
            self, path: object, gridpoints: Array, *args: object
        ) -> tuple[Any, ...]:
            del path, gridpoints, args
            xbound = np.stack([np.zeros_like(self._bound), self._bound], axis=1)
            return None, None, None, None, None, None, xbound

    return Bound


@cache
def _toppra_path_class() -> Any:
    ta = _toppra()

    class Path(ta.interpolator.AbstractGeometricPath):  # type: ignore[misc, name-defined]
        """A `JointPath` as toppra wants it."""

        def __init__(self, path: JointPath) -> None:
            self._path = path

        def __call__(self, s: Any, order: int = 0) -> Array:
            out: Array = self._path(np.asarray(s, dtype=float), order)
            return out

        @property
        def dof(self) -> int:
            return 6

        @property
        def path_interval(self) -> Array:
            return np.array([0.0, self._path.length])

        @property
        def waypoints(self) -> None:
            return None

    return Path
