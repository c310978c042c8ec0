"""How a person's hands, trunk and feet move: smooth paths as functions of time, cheap to sample.

A path has the time law of minimum jerk (Flash and Hogan 1985): at rest at both ends, with the
bell-shaped speed of human reaching. A path that replaces another before its end is blended into.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cell.frames import Array
from hil.sim.person.stance import Arm, minimum_jerk

BLEND = 0.30
"""A new path takes over from an unfinished one in this time [s]."""
_TURNING = 3.0
"""Fastest mean turn of a hand [rad/s]."""
_LEAST = 0.35
"""Shortest reach [s]."""


class Path(Protocol):
    """An arm over time; it rests from `end` [s] on."""

    end: float

    def at(self, t: float) -> Arm: ...

    def point(self, t: float) -> Array:
        """The grip point alone, (3,) [m] in P."""
        ...


class Still:
    """An arm that stays as it is."""

    end = 0.0

    def __init__(self, arm: Arm) -> None:
        self._arm = arm

    def at(self, t: float) -> Arm:
        del t
        return self._arm

    def point(self, t: float) -> Array:
        return self.at(t).p


class Reach:
    """From one arm pose to another, the hand along a cubic Bezier curve.

    Args:
        start, goal: both ends, at rest.
        t0: when it starts [s]. duration: [s].
        rise, fall: how far above start and goal [m] the inner control points of the curve lie.
        window: shares of the time between which the fingers change their shape.
    """

    def __init__(
        self, start: Arm, goal: Arm, t0: float, duration: float, *, rise: float = 0.0, fall: float = 0.0,
        window: tuple[float, float] = (0.0, 1.0),
    ) -> None:  # fmt: skip
        self._start, self._goal, self._window = start, goal, window
        self._t0, self._duration, self.end = t0, duration, t0 + duration
        self._points = controls(start.p, goal.p, rise, fall)
        self._axis, self._angle = rotation(start.R, goal.R)

    def at(self, t: float) -> Arm:
        u = (t - self._t0) / self._duration
        if u >= 1.0:
            return self._goal
        s = minimum_jerk(u)
        a, b = self._window
        w = minimum_jerk((u - a) / (b - a))
        return Arm(
            bezier(self._points, s),
            turn(self._axis, s * self._angle) @ self._start.R,
            (1 - s) * self._start.swivel + s * self._goal.swivel,
            (1 - w) * self._start.fingers + w * self._goal.fingers,
        )

    def point(self, t: float) -> Array:
        return bezier(self._points, minimum_jerk((t - self._t0) / self._duration))


class Shaken:
    """An arm that is held up, with the slow irregular sway of a person who stands still.

    Args:
        arm: as it is meant. t0: [s]. rng: draws the sway. sway: [m]. sway_turn: [rad].
    """

    def __init__(self, arm: Arm, t0: float, rng: np.random.Generator, sway: float, sway_turn: float) -> None:
        self._arm, self._t0, self.end = arm, t0, t0
        self._amplitude = np.repeat([sway, sway_turn], 3)
        self._rate = 2 * np.pi * rng.uniform([0.3, 0.9, 2.0], [0.6, 1.6, 4.0], (6, 3))
        self._phase = rng.uniform(0.0, 2 * np.pi, (6, 3))

    def at(self, t: float) -> Arm:
        off = self._sway(t)
        angle = float(np.linalg.norm(off[3:]))
        R = self._arm.R if angle < 1e-9 else turn(off[3:] / angle, angle) @ self._arm.R
        return Arm(self._arm.p + off[:3], R, self._arm.swivel, self._arm.fingers)

    def point(self, t: float) -> Array:
        out: Array = self._arm.p + self._sway(t)[:3]
        return out

    def _sway(self, t: float) -> Array:
        dt = t - self._t0
        waves = (np.sin(self._rate * dt + self._phase) * (0.8, 0.5, 0.2)).sum(axis=1)
        out: Array = self._amplitude * waves * minimum_jerk(dt / 0.5)
        return out


class Turning:
    """A hand that turns what it holds to and fro before the eyes, and ends as it began.

    Args:
        axis: unit vector in P. swing: largest angle [rad].
    """

    def __init__(self, arm: Arm, t0: float, duration: float, axis: Array, swing: float) -> None:
        self._arm, self._t0, self._duration, self.end = arm, t0, duration, t0 + duration
        self._axis, self._swing = axis, swing

    def at(self, t: float) -> Arm:
        u = min(max((t - self._t0) / self._duration, 0.0), 1.0)
        angle = self._swing * float(np.sin(2 * np.pi * u)) * minimum_jerk(4 * u) * minimum_jerk(4 * (1 - u))
        return Arm(self._arm.p, turn(self._axis, angle) @ self._arm.R, self._arm.swivel, self._arm.fingers)

    def point(self, t: float) -> Array:
        del t
        return self._arm.p


class Blended:
    """From an unfinished path over to a new one within `BLEND`."""

    def __init__(self, old: Path, new: Path, t0: float) -> None:
        self._old, self._new, self._t0, self.end = old, new, t0, max(new.end, t0 + BLEND)

    def at(self, t: float) -> Arm:
        w, new = minimum_jerk((t - self._t0) / BLEND), self._new.at(t)
        if w >= 1.0:
            return new
        old = self._old.at(t)
        axis, angle = rotation(old.R, new.R)
        return Arm(
            (1 - w) * old.p + w * new.p,
            turn(axis, w * angle) @ old.R,
            (1 - w) * old.swivel + w * new.swivel,
            (1 - w) * old.fingers + w * new.fingers,
        )

    def point(self, t: float) -> Array:
        w = minimum_jerk((t - self._t0) / BLEND)
        new = self._new.point(t)
        return new if w >= 1.0 else (1 - w) * self._old.point(t) + w * new


class Drift:
    """Some numbers, e.g. the trunk's or the feet's place, from one value to another at rest.

    Args:
        start, goal: shape (K,). before: blends out, when the last drift was not over yet.
    """

    def __init__(
        self, start: Array, goal: Array, t0: float, duration: float, before: Drift | None = None
    ) -> None:
        self._start, self._step, self._t0 = start, goal - start, t0
        self._duration, self.end, self._before = max(duration, 1e-3), t0 + max(duration, 1e-3), before

    def at(self, t: float) -> Array:
        out: Array = self._start + minimum_jerk((t - self._t0) / self._duration) * self._step
        if self._before is not None and (w := minimum_jerk((t - self._t0) / BLEND)) < 1.0:
            out = (1 - w) * self._before.at(t) + w * out
        return out


def reach_time(start: Arm, goal: Arm, speed: float, rise: float = 0.0, fall: float = 0.0) -> float:
    """Duration [s] of a `Reach` at mean speed `speed` [m/s] and at a hand's turning speed."""
    points = controls(start.p, goal.p, rise, fall)
    curve = np.array([bezier(points, s) for s in np.linspace(0.0, 1.0, 9)])
    length = float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())
    return max(_LEAST, length / speed, rotation(start.R, goal.R)[1] / _TURNING)


def controls(start: Array, goal: Array, rise: float, fall: float) -> Array:
    """Control points (4, 3) of a curve that leaves and arrives vertically where rise or fall is given."""
    third, up = (goal - start) / 3.0, np.array([0.0, 0.0, 1.0])
    return np.array(
        [
            start,
            start + (rise * up if rise > 0.0 else third),
            goal + (fall * up if fall > 0.0 else -third),
            goal,
        ]
    )


def bezier(points: Array, s: float) -> Array:
    """Point (3,) of the cubic curve with control points (4, 3)."""
    r = 1.0 - s
    out: Array = np.array([r * r * r, 3 * r * r * s, 3 * r * s * s, s * s * s]) @ points
    return out


def turn(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit vector (Rodrigues)."""
    x, y, z = (float(v) for v in axis)
    c, s = float(np.cos(angle)), float(np.sin(angle))
    k = 1.0 - c
    return np.array(
        [
            [c + x * x * k, x * y * k - z * s, x * z * k + y * s],
            [y * x * k + z * s, c + y * y * k, y * z * k - x * s],
            [z * x * k - y * s, z * y * k + x * s, c + z * z * k],
        ]
    )


def rotation(R_a: Array, R_b: Array) -> tuple[Array, float]:
    """Unit axis (3,) and angle [rad] of the turn from `R_a` to `R_b`."""
    R = R_b @ R_a.T
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.linalg.norm(v)) / 2.0
    angle = float(np.arctan2(sine, (np.trace(R) - 1.0) / 2.0))
    if sine > 1e-6:
        return v / (2.0 * sine), angle
    if angle < 1.0:
        return np.array([0.0, 0.0, 1.0]), 0.0
    symmetric = R + np.eye(3)  # half a turn: the axis spans the symmetric part
    axis = symmetric[:, int(np.argmax(np.diag(R)))]
    return axis / np.linalg.norm(axis), angle
