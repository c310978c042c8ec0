"""The simulated UR3e: joint motors that follow set-points with the real arm's delay.

A UR controller's `servoj` follows a streamed set-point about one look-ahead time late. Here
the set-points are kept, interpolated and given to PyBullet's joint motors
`lag` seconds late; the motors are limited to the published joint torques.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from cell.frames import Array
from hil.sim.physics import bullet
from urdf import JOINT_NAMES

_POSITION_GAIN = 0.3
_VELOCITY_GAIN = 1.0
_TORQUE = (54.0, 54.0, 28.0, 9.0, 9.0, 9.0)
"""Largest joint torques [Nm] (urdf/SOURCES.md)."""


class SimArm:
    """Six joints of body `body`.

    Args:
        client: physics client id.
        body: PyBullet body of the robot.
        joints: PyBullet joint index by name.
        lag: delay [s]. step: physics step [s].
        home: joint angles [rad] at which it starts, at rest.
    """

    def __init__(
        self, client: int, body: int, joints: dict[str, int], lag: float, step: float, home: Array
    ) -> None:
        self._client, self._body, self._lag, self._step = client, body, lag, step
        self._indices = [joints[name] for name in JOINT_NAMES]
        self._setpoints: deque[tuple[float, Array, Array]] = deque()
        self.place(home)

    def place(self, q: Array) -> None:
        """Put the arm at rest at `q` [rad] at once (only while setting the scene)."""
        for index, angle in zip(self._indices, q, strict=True):
            bullet.resetJointState(self._body, index, float(angle), 0.0, physicsClientId=self._client)
        self._setpoints.clear()
        self._setpoints.append((-np.inf, np.array(q, float), np.zeros(6)))
        self._drive(np.asarray(q, float), np.zeros(6))

    def command(self, t: float, q: Array, qd: Array) -> None:
        """Set-point to be reached at time `t` [s] (plus the lag)."""
        self._setpoints.append((t, np.array(q, float), np.array(qd, float)))

    def follow(self, t: float) -> None:
        """Drive the motors for the physics step that ends at `t` [s]."""
        # Bullet's motor compares the position before the step with its target, but gives the speed
        # that the step ends with; the two targets are a step apart.
        q, _ = self._delayed(t - self._lag - self._step)
        _, qd = self._delayed(t - self._lag)
        self._drive(q, qd)

    def measure(self) -> tuple[Array, Array, Array]:
        """q [rad], qd [rad/s], motor torque [Nm], each shape (6,)."""
        states = bullet.getJointStates(self._body, self._indices, physicsClientId=self._client)
        return (
            np.array([s[0] for s in states]),
            np.array([s[1] for s in states]),
            np.array([s[3] for s in states]),
        )

    def angles(self) -> tuple[float, ...]:
        """The joint angles alone (6,) [rad]."""
        states = bullet.getJointStates(self._body, self._indices, physicsClientId=self._client)
        return tuple(s[0] for s in states)

    def _delayed(self, t: float) -> tuple[Array, Array]:
        points = self._setpoints
        while len(points) > 1 and points[1][0] <= t:
            points.popleft()
        t0, q0, qd0 = points[0]
        if len(points) == 1 or not np.isfinite(t0):
            return q0, np.zeros(6)  # nothing newer was commanded: hold
        t1, q1, qd1 = points[1]
        h = t1 - t0
        s = (t - t0) / h
        # Speed is linear in between, so that a window of any phase sees no more acceleration than
        # was planned; position is its integral, with what that misses spread evenly.
        missed = q1 - q0 - 0.5 * h * (qd0 + qd1)
        q = q0 + h * (s * qd0 + 0.5 * s * s * (qd1 - qd0)) + s * missed
        return q, (1 - s) * qd0 + s * qd1

    def _drive(self, q: Array, qd: Array) -> None:
        bullet.setJointMotorControlArray(
            self._body,
            self._indices,
            bullet.POSITION_CONTROL,
            targetPositions=q.tolist(),
            targetVelocities=qd.tolist(),
            forces=_TORQUE,
            positionGains=[_POSITION_GAIN] * 6,
            velocityGains=[_VELOCITY_GAIN] * 6,
            physicsClientId=self._client,
        )
