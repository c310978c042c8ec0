"""Geometric ways from one arm pose to another, the likely best ones first.

A route is a list of joint waypoints. Straight joint moves are quick for the arm; straight tool
moves are quick under a tool speed cap; via poses lead round the furniture.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from cell.config import CellConfig
from cell.errors import PlanError
from cell.frames import Array, pose
from cell.motion.kinematics import Kinematics

_LINE_STEP = 0.012
"""Distance between IK solutions along a straight line [m]."""
_SWEEP_STEP = 0.03
"""The same along an arc round the base [m]."""
_TURN_STEP = 0.2
"""Turn of the tool between IK solutions, at most [rad]."""
_JUMP = 0.45
"""Joint step between neighbouring IK solutions that means another branch [rad]."""
_LIFTS = (0.05, 0.12, 0.20)
_PULLS = (1.0, 0.8, 0.65)


class Routes:
    """Routes of one arm. Joint angles are (6,) [rad], poses X_WT (4, 4) are the TCP's."""

    def __init__(self, config: CellConfig, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._home = np.array(config.arm.home)

    def line(self, q_from: Array, X_WT: Array, *, step: float = _LINE_STEP) -> list[Array]:
        """Waypoints along which the tool moves straight to X_WT and turns evenly.

        Raises:
            PlanError: the line leaves the arm's reach, or the arm would have to turn over.
        """
        X_from = self._kinematics.X_WT(q_from)
        turn = _rotation_vector(X_from[:3, :3].T @ X_WT[:3, :3])
        distance = float(np.linalg.norm(X_WT[:3, 3] - X_from[:3, 3]))
        count = _pieces(distance / step, turn)
        poses = []
        for w in np.linspace(0, 1, count + 1)[1:-1]:
            R = X_from[:3, :3] @ _rotation(w * turn)
            poses.append(pose(R, (1 - w) * X_from[:3, 3] + w * X_WT[:3, 3]))
        return self._follow(q_from, [*poses, X_WT])

    def arc(self, q_from: Array, X_WT: Array) -> list[Array]:
        """As `line`, but the tool sweeps round the base: distance, azimuth and height change evenly."""
        X_from = self._kinematics.X_WT(q_from)
        (r0, a0), (r1, a1) = _polar(X_from[:3, 3]), _polar(X_WT[:3, 3])
        a1 = a0 + (a1 - a0 + np.pi) % (2 * np.pi) - np.pi
        turn = _rotation_vector(X_from[:3, :3].T @ X_WT[:3, :3])
        length = float(np.hypot(np.hypot(r1 - r0, X_WT[2, 3] - X_from[2, 3]), 0.5 * (r0 + r1) * (a1 - a0)))
        count = _pieces(length / _SWEEP_STEP, turn)
        poses = []
        for w in np.linspace(0, 1, count + 1)[1:-1]:
            r, a, z = (1 - w) * r0 + w * r1, (1 - w) * a0 + w * a1, (1 - w) * X_from[2, 3] + w * X_WT[2, 3]
            poses.append(pose(X_from[:3, :3] @ _rotation(w * turn), (r * np.cos(a), r * np.sin(a), z)))
        return self._follow(q_from, [*poses, X_WT])

    def direct(self, q_from: Array, q_to: Array) -> Iterator[list[Array]]:
        """Routes without detours that end at exactly q_to."""
        yield [q_from, q_to]
        X_WT = self._kinematics.X_WT(q_to)
        for make in (partial(self.line, step=_SWEEP_STEP), self.arc):
            try:
                route = make(q_from, X_WT)
            except PlanError:
                continue
            missing = q_to - route[-1]
            missing[5] -= 2 * np.pi * np.round(missing[5] / (2 * np.pi))
            if np.abs(missing).max() < 1e-6:
                turns = np.linspace(0, 1, len(route))[:, None] * (q_to - route[-1])
                yield list(route + turns)  # whole turns of the last joint, spread evenly

    def detours(self, q_from: Array, q_to: Array) -> Iterator[list[Array]]:
        """Routes over raised, drawn-in and tucked poses."""
        p_from, p_to = (self._kinematics.X_WT(q)[:3, 3] for q in (q_from, q_to))
        middle = 0.5 * (q_from + q_to)
        X_WT = self._kinematics.X_WT(middle)
        for lift in _LIFTS:
            for pull in _PULLS:
                raised = X_WT.copy()
                raised[:2, 3] *= pull
                raised[2, 3] = max(p_from[2], p_to[2], raised[2, 3]) + lift
                for q in self._kinematics.ik(raised, middle)[:2]:
                    if np.abs(q - middle).max() < 1.5:
                        yield [q_from, q, q_to]
        tucked = self._home.copy()
        tucked[0] = middle[0]
        yield [q_from, tucked, q_to]
        yield [q_from, np.array([q_from[0], *tucked[1:]]), np.array([q_to[0], *tucked[1:]]), q_to]
        for q in self._lifted(q_from, p_from):
            for r in self._lifted(q_to, p_to):
                yield [q_from, q, r, q_to]
        yield [q_from, self._home, q_to]

    def _lifted(self, q: Array, p_WT: Array) -> list[Array]:
        """Poses straight above q and drawn in towards the base."""
        out = []
        for lift, pull in ((0.12, 1.0), (0.12, 0.8), (0.20, 0.7)):
            X_WT = self._kinematics.X_WT(q)
            X_WT[:3, 3] = (pull * p_WT[0], pull * p_WT[1], p_WT[2] + lift)
            out += [s for s in self._kinematics.ik(X_WT, q)[:1] if np.abs(s - q).max() < 1.5]
        return out

    def _follow(self, q_from: Array, poses: list[Array]) -> list[Array]:
        """The chain of nearest IK solutions through `poses`."""
        route = [q_from]
        for X_WT in poses:
            near = route[-1]
            options = self._kinematics.ik(X_WT, near)
            if not options:
                self._kinematics.ik_near(X_WT, near)  # raises, naming the pose
            q = min(options, key=lambda o: float(np.abs(o - near).max()))
            if np.abs(q - near).max() > _JUMP:
                raise PlanError("a straight tool motion would have to turn the arm over")
            route.append(q)
        return route


def _pieces(steps: float, turn: Array) -> int:
    """Into how many pieces a tool motion is cut, for its length in steps and its turn [rad]."""
    return max(2, int(np.ceil(max(steps, float(np.linalg.norm(turn)) / _TURN_STEP))))


def _polar(p: Array) -> tuple[float, float]:
    """Distance from the base axis [m] and azimuth [rad]."""
    return float(np.hypot(p[0], p[1])), float(np.arctan2(p[1], p[0]))


def _rotation_vector(R: Array) -> Array:
    """Axis times angle [rad], shape (3,), of a rotation matrix."""
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sin, cos = float(np.linalg.norm(axis)), 0.5 * (np.trace(R) - 1)
    if sin > 1e-6:
        out: Array = axis / sin * np.arctan2(sin, cos)
        return out
    if cos > 0:
        return axis
    column = R + np.eye(3)  # a half turn: every column of R + 1 is along the axis
    v = column[:, int(np.argmax(np.diag(R)))]
    half_turn: Array = np.pi * v / np.linalg.norm(v)
    return half_turn


def _rotation(v: Array) -> Array:
    """The rotation matrix of a rotation vector (3,) [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = v / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    out: Array = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)
    return out
