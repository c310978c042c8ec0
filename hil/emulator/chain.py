"""Where TCP and elbow are and how they move, as the controller reports it."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

from cell.frames import Array
from hil.emulator.kinematics import Kinematics
from hil.emulator.models import Model
from hil.emulator.poses import IDENTITY, Frame, Vector, frame_of, pose_of

_INSTANT = 1e-6
"""Accelerations are differences of speeds over this time [s]."""


@dataclass(frozen=True)
class Motion:
    """One moment of the arm, in base B.

    Attributes:
        pose: of the TCP, position and axis-angle [m], [rad], length 6.
        speed: of the TCP, linear and angular [m/s], [rad/s], length 6.
        elbow, elbow_speed: of the axis of joint 3 [m], [m/s].
    """

    pose: tuple[float, ...]
    speed: tuple[float, ...]
    elbow: Vector
    elbow_speed: Vector


class Chain:
    """The joints of one model, with a tool."""

    def __init__(self, model: Model) -> None:
        self._kinematics = Kinematics(model)
        self._upper, self._height = float(model.a[1]), float(model.d[0])
        self._offset: Frame = IDENTITY

    def tool(self, tcp: Array) -> None:
        """Set the TCP in the flange, position and axis-angle, shape (6,)."""
        self._offset = frame_of(tcp.tolist())

    def motion(self, q: Array, qd: Array) -> Motion:
        """At joints q [rad] moving at qd [rad/s], shape (6,)."""
        frame, J = self._kinematics.jacobian(q.tolist(), self._offset)
        elbow, elbow_speed = self._elbow(q.tolist(), qd.tolist())
        return Motion(tuple(pose_of(frame)), tuple((J @ qd).tolist()), elbow, elbow_speed)

    def acceleration(self, motion: Motion, q: Array, qd: Array, qdd: Array) -> tuple[float, ...]:
        """Of the TCP, linear and angular [m/s^2], [rad/s^2], length 6; `motion` is that of q and qd."""
        later = (q + qd * _INSTANT).tolist()
        speed = self._kinematics.jacobian(later, self._offset)[1] @ (qd + qdd * _INSTANT)
        return tuple(((speed - motion.speed) / _INSTANT).tolist())

    def flange(self, q: Array) -> Frame:
        """X_BE."""
        return self._kinematics.flange(q.tolist())

    def _elbow(self, q: list[float], qd: list[float]) -> tuple[Vector, Vector]:
        c1, s1, c2, s2 = cos(q[0]), sin(q[0]), cos(q[1]), sin(q[1])
        out, out_speed = self._upper * c2, -self._upper * s2 * qd[1]
        place = (out * c1, out * s1, self._height + self._upper * s2)
        speed = (
            out_speed * c1 - out * s1 * qd[0],
            out_speed * s1 + out * c1 * qd[0],
            self._upper * c2 * qd[1],
        )
        return place, speed
