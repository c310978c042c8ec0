"""Timed joint paths: when the arm is where, and what of that goes on the wire."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cell.config import CellConfig
from cell.frames import Array
from cell.limits import QD_MAX
from cell.motion.paths import JointPath
from cell.motion.profile import fastest, speed_bound
from cell.motion.ssm import protective_separation

_SEGMENTS, _SEGMENTS_PER_PIECE = 200, 10
"""Segments of a grid: at least so many, and so many per piece of the path's spline."""


@dataclass(frozen=True)
class TimedPath:
    """A joint path, or a part of one, with its timing; it always ends at rest.

    The grid is kept because a change of speed in mid-motion is planned on the running grid
    (see `cell.motion.retiming`).

    Attributes:
        path: the geometry.
        s: nodes along the path, shape (N + 1,), rising.
        x: (ds/dt)^2 at the nodes, shape (N + 1,) [1/s^2]; the last is 0.
    """

    path: JointPath
    s: Array
    x: Array

    @cached_property
    def t(self) -> Array:
        """Times of the nodes from the start [s], shape (N + 1,)."""
        root = np.sqrt(self.x)
        dt = 2 * np.diff(self.s) / np.maximum(root[:-1] + root[1:], 1e-9)
        return np.concatenate([[0.0], np.cumsum(dt)])

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        return float(self.t[-1])

    def state(self, times: Array) -> tuple[Array, Array, Array]:
        """s, ds/dt and d2s/dt2, shape (M,), at times (M,) [s] from the start."""
        t = self.t
        at = np.clip(np.asarray(times, dtype=float), 0.0, t[-1])
        i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
        u = np.diff(self.x)[i] / (2 * np.diff(self.s)[i])
        root = np.sqrt(self.x)[i]
        tau = at - t[i]
        s = np.clip(self.s[i] + root * tau + 0.5 * u * tau**2, self.s[i], self.s[i + 1])
        return s, np.maximum(root + u * tau, 0.0), u

    def sample(self, times: Array) -> tuple[Array, Array, Array]:
        """q [rad], qd [rad/s], qdd [rad/s^2], each (M, 6), at times (M,) [s] from the start."""
        s, sdot, u = self.state(np.atleast_1d(times))
        d1 = self.path(s, 1)
        qdd = d1 * u[:, None] + self.path(s, 2) * sdot[:, None] ** 2
        return self.path(s), d1 * sdot[:, None], qdd

    def to_points(self, period: float) -> tuple[Array, Array, Array]:
        """Times (M,) [s], q (M, 6) [rad], qd (M, 6) [rad/s] for the wire.

        Points are whole periods apart, so that an executor with this period meets them exactly;
        the last one is the first whole period at which the arm is at rest.
        """
        count = max(1, int(np.ceil(self.duration / period - 1e-9)))
        times: Array = period * np.arange(count + 1, dtype=np.float64)
        q, qd, _ = self.sample(times)
        qd[-1] = 0.0
        return times, q, qd


def time_path(path: JointPath, speed_cap: float, config: CellConfig) -> TimedPath:
    """Fastest rest-to-rest timing within the configured margins of the limits.

    Args:
        path: the geometry.
        speed_cap: TCP speed cap [m/s]; the plan keeps `motion.speed_margin` of it.

    Raises:
        PlanError: no timing exists (a numerical failure; a path from rest to rest has one).
    """
    count = max(_SEGMENTS, _SEGMENTS_PER_PIECE * path.pieces)
    grid = np.linspace(0.0, path.length, count + 1)
    return TimedPath(path, grid, profile(path, grid, speed_cap, config, x0=0.0))


def longest_braking(speed_cap: float, config: CellConfig) -> float:
    """Within which time every joint must be able to come to rest under a TCP speed cap [s].

    What a joint does for the tool may grow while it is braked, so that the tool is slow for good only
    when the joints are. Above the collaborative speed the cap says how far away a person is (S_p, ISO/TS
    15066, 5.5.4); who walks from there needs a while to come so near that industrial mode ends.
    """
    motion, separation = config.motion, config.separation
    if speed_cap <= motion.collaborative_speed:
        return motion.longest_braking  # a stop may follow, but no lower cap
    walk = (protective_separation(speed_cap, separation) - separation.permit) / separation.human_speed
    return motion.late_braking + max(0.0, walk)


def profile(path: JointPath, grid: Array, speed_cap: float, config: CellConfig, *, x0: float) -> Array:
    """x at the nodes of `grid` (N + 1,) for the fastest motion from x0 to rest; see `fastest`."""
    motion, arm = config.motion, config.arm
    limit = motion.acceleration_margin * arm.max_acceleration
    qd_max = np.minimum(arm.velocity_scale * QD_MAX, limit * longest_braking(speed_cap, config))
    bound = speed_bound(path, grid, motion.speed_margin * speed_cap, qd_max, config.gripper.length)
    return fastest(path, grid, bound, limit, arm.max_acceleration, x0)
