"""The speed profile along a joint path: braking and greedy driving inside the controllable set.

The path parameter is s, x = (ds/dt)^2 at the grid's nodes, and u = d2s/dt2 is constant in each
segment, so x[i+1] = x[i] + 2 (s[i+1] - s[i]) u[i]. The backward pass of TOPP-RA (Pham & Pham,
"A new approach to time-optimal path parameterization based on reachability analysis", 2018;
package toppra, solver seidel, interpolation scheme) gives at each node the largest x from which
rest at the end can be reached within the limits. The forward pass here is its greedy one, and
also starts above that set, as it must when the speed limit drops in mid-motion: it then brakes
as hard as the joints allow until it is inside.
"""

from __future__ import annotations

import logging
from functools import cache
from typing import Any

import numpy as np

from cell.errors import PlanError
from cell.frames import Array
from cell.limits import tcp_jacobian
from cell.motion.paths import JointPath

_EPS = 1e-9
_CREEP = 1e-8
"""Least x before the end: the profile must not stall between its ends."""


class Rows:
    """What joint acceleration limits allow for u, given x, in each of a grid's N segments.

    Per joint there are two rows |c u + b x| <= a: at the start of the segment with (c, b) =
    (q', q''), and at its end with (q' + 2 d q'', q'') of the next node, d the segment's length.

    Args:
        path: the geometry. grid: nodes, shape (N + 1,). acceleration: joint limit [rad/s^2].
    """

    def __init__(self, path: JointPath, grid: Array, acceleration: float) -> None:
        d1, d2 = path(grid, 1), path(grid, 2)
        step = np.diff(grid)[:, None]
        c = np.concatenate([d1[:-1], d1[1:] + 2 * step * d2[1:]], axis=1)
        b = np.concatenate([d2[:-1], d2[1:]], axis=1)
        used = np.abs(c) > _EPS
        safe = np.where(used, c, 1.0)
        self._middle = np.where(used, -b / safe, 0.0)
        self._half = np.where(used, acceleration / np.abs(safe), np.inf)

    def u(self, i: int, x: float) -> tuple[float, float]:
        """Least and largest u in segment i entered with x; least > largest when there is none."""
        middle = self._middle[i] * x
        return float((middle - self._half[i]).max()), float((middle + self._half[i]).min())


def speed_bound(
    path: JointPath, grid: Array, tcp_speed: float, qd_max: Array, gripper_length: float
) -> Array:
    """Largest x at each node by joint speeds and tool speed, shape (N + 1,).

    The limits are looked at half way between the nodes, too, where a wrist that turns about the tool
    can make the tool's share of the motion pass through zero: a node takes the least of its own and
    its neighbours' half-way values.

    Args:
        tcp_speed: [m/s]. qd_max: joint speeds, shape (6,) [rad/s].
    """
    fine = np.empty(2 * len(grid) - 1)
    fine[::2], fine[1::2] = grid, 0.5 * (grid[:-1] + grid[1:])
    at = _bound(path, fine, tcp_speed, qd_max, gripper_length)
    out = at[::2].copy()
    out[:-1] = np.minimum(out[:-1], at[1::2])
    out[1:] = np.minimum(out[1:], at[1::2])
    return out


def _bound(path: JointPath, grid: Array, tcp_speed: float, qd_max: Array, gripper_length: float) -> Array:
    """Largest x at given places (M,); see `speed_bound`."""
    q, dq = path(grid), path(grid, 1)
    joints = (qd_max / np.maximum(np.abs(dq), _EPS)).min(axis=1) ** 2
    dp = np.einsum("nij,nj->ni", tcp_jacobian(q, gripper_length), dq)
    tool = (tcp_speed / np.maximum(np.linalg.norm(dp, axis=1), _EPS)) ** 2
    out: Array = np.clip(np.minimum(joints, tool), 1e-9, 1e6)
    return out


def fastest(
    path: JointPath, grid: Array, bound: Array, acceleration: float, full_acceleration: float, x0: float
) -> Array:
    """The fastest x from x0 at the first node to rest at the last, shape (N + 1,).

    Args:
        path: the geometry. grid: nodes, shape (N + 1,), N >= 2.
        bound: largest x per node, shape (N + 1,); exceeded only while braking from an x0 above it.
        acceleration: joint limit to plan with [rad/s^2].
        full_acceleration: true joint limit [rad/s^2], for states the planning limit cannot hold.

    Raises:
        PlanError: no profile exists (numerical trouble; from rest there always is one).
    """
    reach = _controllable(path, grid, bound, acceleration)
    rows = Rows(path, grid, acceleration)
    double = 2 * np.diff(grid)
    x = np.empty(len(grid))
    x[0] = x0
    last = len(grid) - 2
    for i in range(last + 1):
        low, high = rows.u(i, x[i])
        if low > high:
            low = high = _compromise(low, high, Rows(path, grid[i : i + 2], full_acceleration), x[i])
        u = low
        if x[i] <= reach[i] + 1e-12:
            u = max(low, min(high, (reach[i + 1] - x[i]) / double[i]))
        x[i + 1] = x[i] + double[i] * u
        if i < last and x[i + 1] < 1e-10:
            x[i + 1] = _CREEP
    if not np.isfinite(x).all() or x[-1] > 1e-6:
        raise PlanError("no timing found for a path")
    x[-1] = 0.0
    return x


def braking(path: JointPath, grid: Array, acceleration: float, x0: float) -> tuple[Array, Array]:
    """The hardest braking from x0 at the first node: nodes and x up to where x = 0."""
    rows = Rows(path, grid, acceleration)
    s, x = [float(grid[0])], [x0]
    for i in range(len(grid) - 1):
        if x[-1] <= 0.0:
            break
        u, _ = rows.u(i, x[-1])
        step = float(grid[i + 1] - grid[i])
        if u < 0.0 and x[-1] + 2 * step * u <= 0.0:
            s.append(s[-1] + x[-1] / (-2 * u))
            x.append(0.0)
        else:
            s.append(float(grid[i + 1]))
            x.append(x[-1] + 2 * step * u)
    x[-1] = 0.0
    return np.array(s), np.array(x)


def _compromise(low: float, high: float, full: Rows, x: float) -> float:
    """The u to take where the planning limit leaves none; `full` are the rows of the true limit."""
    middle = 0.5 * (low + high)
    if low - high <= 1e-6 * max(1.0, abs(low)):
        return middle  # rounding, at the tip of the allowed set
    low, high = full.u(0, x)
    if low > high + 1e-6 * max(1.0, abs(low)):
        raise PlanError("a motion is too fast for its path: the joints cannot brake in time")
    return max(low, min(high, middle))


def _controllable(path: JointPath, grid: Array, bound: Array, acceleration: float) -> Array:
    """Largest x per node from which rest at the last node can be reached, by TOPP-RA."""
    ta = _toppra()
    limits = ta.constraint.JointAccelerationConstraint(
        np.tile([[-acceleration, acceleration]], (6, 1)),
        discretization_scheme=ta.constraint.DiscretizationType.Interpolation,
    )
    instance = ta.algorithm.TOPPRA(
        [_bound_class()(bound), limits],
        _path_class()(path, grid),
        gridpoints=grid,
        solver_wrapper="seidel",
    )
    sets = instance.compute_controllable_sets(0.0, 0.0)
    if sets is None or not np.isfinite(sets).all():
        raise PlanError("no timing found for a path")
    out: Array = np.asarray(sets, dtype=float)[:, 1]
    return out


@cache
def _toppra() -> Any:
    """The toppra module, imported when first needed: it takes seconds."""
    import toppra
    import toppra.algorithm
    import toppra.constraint

    logging.getLogger("toppra").setLevel(logging.ERROR)
    return toppra


@cache
def _bound_class() -> Any:
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
def _path_class() -> Any:
    ta = _toppra()

    class Path(ta.interpolator.AbstractGeometricPath):  # type: ignore[misc, name-defined]
        """The part of a `JointPath` under a grid, as toppra wants it."""

        def __init__(self, path: JointPath, grid: Array) -> None:
            self._path, self._grid = path, grid

        def __call__(self, s: Any, order: int = 0) -> Array:
            out: Array = self._path(np.asarray(s, dtype=float), order)
            return out

        @property
        def dof(self) -> int:
            return 6

        @property
        def path_interval(self) -> Array:
            return np.array([self._grid[0], self._grid[-1]])

        @property
        def waypoints(self) -> None:
            return None

    return Path
