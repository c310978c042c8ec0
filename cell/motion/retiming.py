"""Changing the speed of a running motion, stopping it on its path, and going on from there.

All of it works on the running plan's own grid. The plan keeps the joint acceleration limits at
exactly these nodes, where the allowed (u, x) form a convex set that contains rest; so braking
from the plan's own x, and any slower profile, is possible from every node on. The change itself
begins inside a segment: nearly always the joints allow that, and the x at the next node comes out
no larger than planned. Where they do not, the segment under way is finished as planned first.
"""

from __future__ import annotations

import numpy as np

from cell.config import CellConfig
from cell.errors import PlanError
from cell.frames import Array
from cell.motion.profile import braking
from cell.motion.timing import TimedPath, profile

_SAME = 1e-9
"""Nodes nearer than this are one."""
_LAST = 0.03
"""A motion that ends within this is left as it is [s]."""
_BRAKE_NODES, _APART = 20, 0.3
"""Nodes put into the way that braking takes, and how near they may come to others, in steps."""


def retime(timed: TimedPath, t: float, speed_cap: float, config: CellConfig) -> TimedPath:
    """The rest of a motion from time t on, under another TCP speed cap.

    Position and speed at t are those of `timed`. The new cap holds as soon as braking at the
    joint acceleration limit allows.

    Args:
        t: time since the start of `timed` [s]. speed_cap: new TCP speed cap [m/s].

    Raises:
        PlanError: the plan was made for higher acceleration limits than `config` has.
    """
    s, x = _rest(timed, t)
    if timed.duration - t < _LAST:
        return TimedPath(timed.path, s, x)
    try:
        fine = _refined(timed, s, float(x[0]), config)
        if len(fine) < 3:
            return TimedPath(timed.path, s, x)
        return TimedPath(timed.path, fine, profile(timed.path, fine, speed_cap, config, x0=float(x[0])))
    except PlanError:
        pass  # between two nodes the joints may not allow what they allow at them
    if len(s) < 4:  # fewer than two whole segments
        return TimedPath(timed.path, s, x)
    new = profile(timed.path, s[1:], speed_cap, config, x0=float(x[1]))
    return TimedPath(timed.path, s, np.concatenate([x[:1], new]))


def stop_on_path(timed: TimedPath, t: float, config: CellConfig) -> TimedPath:
    """The motion from time t [s] on that stops on the path as soon as the joints allow."""
    s, x = _rest(timed, t)
    limit = config.motion.acceleration_margin * config.arm.max_acceleration
    return TimedPath(timed.path, *braking(timed.path, s, limit, float(x[0])))


def resume(timed: TimedPath, s: float, speed_cap: float, config: CellConfig) -> TimedPath:
    """The rest of a motion from rest at path position s, where `stop_on_path` ended.

    Args:
        timed: the plan that was stopped. s: where the arm rests. speed_cap: TCP cap [m/s].
    """
    ahead = timed.s[timed.s > s + _SAME]
    grid = np.concatenate([[s], ahead])
    if len(grid) < 3:
        grid = np.linspace(s, max(float(timed.s[-1]), s + _SAME), 3)
    return TimedPath(timed.path, grid, profile(timed.path, grid, speed_cap, config, x0=0.0))


def _refined(timed: TimedPath, s: Array, x0: float, config: CellConfig) -> Array:
    """The nodes s (N + 1,) with more of them where the joints may have to brake now.

    A slow motion stops within a fraction of a segment; the change of speed needs nodes there.
    """
    limit = config.motion.acceleration_margin * config.arm.max_acceleration
    stop = float(braking(timed.path, s, limit, x0)[0][-1])
    more = np.linspace(s[0], min(stop + 0.2 * (stop - s[0]), float(s[-1])), _BRAKE_NODES + 1)[1:]
    far = np.abs(more[:, None] - s).min(axis=1) > _APART * (more[0] - s[0])
    out: Array = np.sort(np.concatenate([s, more[far & (more[0] - s[0] > _SAME)]]))
    return out


def _rest(timed: TimedPath, t: float) -> tuple[Array, Array]:
    """Nodes and x of what is left at time t: the present state, then the remaining nodes."""
    s_now, sdot, _ = (float(v[0]) for v in timed.state(np.array([t])))
    i = int(np.searchsorted(timed.s, s_now + _SAME, side="right"))
    i = min(max(i, 1), len(timed.s) - 1)
    return (
        np.concatenate([[s_now], timed.s[i:]]),
        np.concatenate([[sdot**2], timed.x[i:]]),
    )
