"""Forward and inverse kinematics of the emulated arms, in the controller's base frame.

The Denavit-Hartenberg chain of these arms is written out: joints 2, 3 and 4 are parallel, so it is
that of a plane turned by joint 1, and of a wrist. Everything is plain floats, see `poses`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import ur_analytic_ik

from cell.errors import BackendError, one_of
from cell.frames import Array
from hil.emulator.models import Model
from hil.emulator.poses import (
    IDENTITY,
    Frame,
    Vector,
    compose,
    cross,
    frame_of,
    invert,
    norm,
    pose_of,
)

_SOLVERS = {"UR3": "ur3e", "UR5": "ur5e"}
_NEAR = 1e-7
"""How well a pose must be met [m], [rad]."""
_POOR = 1e-4
"""Analytic solutions lose digits near singularities; what is this good is improved."""
_TURN = 2.0 * math.pi
_ATTEMPTS = 60
_STEP = 0.3
_DAMPING = 1e-6


class Kinematics:
    """One arm's kinematics. Joint angles are any sequence of 6 floats [rad].

    Attributes:
        model: the arm.
        q_max, qd_max: its limits as lists [rad], [rad/s].
    """

    def __init__(self, model: Model) -> None:
        if model.name not in _SOLVERS:
            raise BackendError(f"no inverse kinematics for the arm: {one_of(model.name, _SOLVERS)}")
        self.model = model
        self.q_max: list[float] = [float(v) for v in model.q_max]
        self.qd_max: list[float] = [float(v) for v in model.qd_max]
        self._solver = getattr(ur_analytic_ik, _SOLVERS[model.name])
        self._a2, self._a3 = float(model.a[1]), float(model.a[2])
        self._d1, self._d4, self._d5, self._d6 = (float(model.d[i]) for i in (0, 3, 4, 5))

    # -- forward -----------------------------------------------------------------------------------

    def flange(self, q: Sequence[float]) -> Frame:
        """X_BE."""
        return self._chain(q)[0]

    def tool(self, q: Sequence[float], offset: Frame) -> Frame:
        """X_BT of a tool at `offset` in the flange."""
        return compose(self._chain(q)[0], offset)

    def pose(self, q: Sequence[float], tcp: Sequence[float]) -> list[float]:
        """Pose of the TCP whose offset in the flange is `tcp`; both 6 numbers."""
        return pose_of(compose(self._chain(q)[0], frame_of(tcp)))

    def jacobian(self, q: Sequence[float], offset: Frame = IDENTITY) -> tuple[Frame, Array]:
        """X_BT, and the geometric Jacobian (6, 6) there: rows 0-2 [m/rad], rows 3-5 [rad/rad], in B."""
        flange, shoulder, elbow, wrist1, wrist3, z1, z4 = self._chain(q)
        frame = compose(flange, offset)
        px, py, pz = p = frame[0]
        z5 = flange[3]
        parts: list[Vector] = [(-py, px, 0.0)]
        for axis, origin in ((z1, shoulder), (z1, elbow), (z1, wrist1), (z4, wrist3), (z5, wrist3)):
            parts.append(cross(axis, (px - origin[0], py - origin[1], pz - origin[2])))
        del p
        turns = ((0.0, 0.0, 1.0), z1, z1, z1, z4, z5)
        J = np.array(
            [[part[k] for part in parts] for k in range(3)] + [[z[k] for z in turns] for k in range(3)]
        )
        return frame, J

    def _chain(self, q: Sequence[float]) -> tuple[Frame, Vector, Vector, Vector, Vector, Vector, Vector]:
        """Flange; origins on the axes of joints 2, 3, 4 and of both 5 and 6; axes of joints 2-4 and 5."""
        c1, s1 = math.cos(q[0]), math.sin(q[0])
        q23 = q[1] + q[2]
        q234 = q23 + q[3]
        c5, s5 = math.cos(q[4]), math.sin(q[4])
        c6, s6 = math.cos(q[5]), math.sin(q[5])
        cw, sw = math.cos(q234), math.sin(q234)
        # In the plane that joint 1 turns: r outwards, h upwards; z1 is normal to it.
        r3, h3 = self._a2 * math.cos(q[1]), self._d1 + self._a2 * math.sin(q[1])
        r4, h4 = r3 + self._a3 * math.cos(q23), h3 + self._a3 * math.sin(q23)
        z1 = (s1, -c1, 0.0)
        x4 = (cw * c1, cw * s1, sw)
        z4 = (sw * c1, sw * s1, -cw)
        x5 = (c5 * x4[0] + s5 * z1[0], c5 * x4[1] + s5 * z1[1], c5 * x4[2])
        z5 = (c5 * z1[0] - s5 * x4[0], c5 * z1[1] - s5 * x4[1], -s5 * x4[2])
        d4, d5, d6 = self._d4, self._d5, self._d6
        wx, wy, wz = (
            r4 * c1 + d4 * z1[0] + d5 * z4[0],
            r4 * s1 + d4 * z1[1] + d5 * z4[1],
            h4 + d5 * z4[2],
        )
        x6 = (c6 * x5[0] - s6 * z4[0], c6 * x5[1] - s6 * z4[1], c6 * x5[2] - s6 * z4[2])
        y6 = (-s6 * x5[0] - c6 * z4[0], -s6 * x5[1] - c6 * z4[1], -s6 * x5[2] - c6 * z4[2])
        flange = ((wx + d6 * z5[0], wy + d6 * z5[1], wz + d6 * z5[2]), x6, y6, z5)
        shoulder, elbow, wrist1 = (0.0, 0.0, self._d1), (r3 * c1, r3 * s1, h3), (r4 * c1, r4 * s1, h4)
        return flange, shoulder, elbow, wrist1, (wx, wy, wz), z1, z4

    # -- inverse -----------------------------------------------------------------------------------

    def within(self, q: Sequence[float]) -> bool:
        """Whether all angles are inside the joint limits."""
        return all(abs(v) <= limit + 1e-9 for v, limit in zip(q, self.q_max, strict=True))

    def ik(self, pose: Sequence[float], tcp: Sequence[float], near: Sequence[float]) -> list[float] | None:
        """The solution nearest to `near` inside the joint limits that puts the TCP at a pose.

        Args:
            pose, tcp: wanted pose of the TCP, and its offset in the flange, 6 numbers.

        Returns:
            Joint angles; None when the pose is out of reach.
        """
        target = compose(frame_of(pose), invert(frame_of(tcp)))
        p, x, y, z = target
        X = np.array([[x[k], y[k], z[k], p[k]] for k in range(3)] + [[0.0, 0.0, 0.0, 1.0]])
        found = [self._unwrapped(raw.tolist(), near) for raw in self._solver.inverse_kinematics(X)]
        reachable = [q for q in found if q is not None]
        reachable.sort(key=lambda q: sum((a - b) ** 2 for a, b in zip(q, near, strict=True)))
        for q in reachable:
            off = max(abs(e) for e in error(target, self.flange(q)))
            if off < _NEAR:
                return q
            if off < _POOR and (better := self._newton(target, q)) is not None and self.within(better):
                return better
        last = self._newton(target, list(near))  # close to a singularity nothing analytic may be left
        return last if last is not None and self.within(last) else None

    def _unwrapped(self, q: Sequence[float], near: Sequence[float]) -> list[float] | None:
        """Whole turns added so that each angle is nearest to `near` inside the limits."""
        out = []
        for angle, seed, limit in zip(q, near, self.q_max, strict=True):
            a = angle + _TURN * round((seed - angle) / _TURN)
            if abs(a) > limit:
                a -= math.copysign(_TURN, a)
            if not abs(a) <= limit:
                return None
            out.append(a)
        return out

    def _newton(self, target: Frame, start: list[float]) -> list[float] | None:
        q = start
        for _ in range(_ATTEMPTS):
            frame, J = self.jacobian(q)
            e = error(target, frame)
            if max(abs(v) for v in e) < _NEAR * 1e-3:
                return q
            step = J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(6), np.array(e))
            step *= min(1.0, _STEP / max(float(np.abs(step).max()), 1e-12))
            q = [a + b for a, b in zip(q, step.tolist(), strict=True)]
        e = error(target, self.flange(q))
        return q if max(abs(v) for v in e) < _NEAR else None


def error(target: Frame, at: Frame) -> list[float]:
    """Small motion from `at` to `target`: translation [m] and rotation vector [rad], in their parent.

    The rotation is exact to third order, and grows with the true angle up to a quarter turn.
    """
    p, q = target[0], at[0]
    turns = [cross(at[k], target[k]) for k in (1, 2, 3)]
    rotation = [0.5 * (turns[0][k] + turns[1][k] + turns[2][k]) for k in range(3)]
    return [p[0] - q[0], p[1] - q[1], p[2] - q[2], *rotation]


def tool_speed(J: Array, qd: Sequence[float]) -> list[float]:
    """Twist (6,) [m/s], [rad/s] of joint speeds at a Jacobian."""
    twist: list[float] = (J @ np.array(qd)).tolist()
    return twist


def length(twist: Sequence[float]) -> float:
    """Size of a twist: the larger of its speed [m/s] and its turn rate [rad/s]."""
    return max(norm(twist[:3]), norm(twist[3:]))
