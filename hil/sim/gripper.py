"""The simulated parallel gripper: two geared sliding fingers that hold by friction alone.

Nothing is ever glued to the fingers. A gear constraint keeps them symmetric and friction
anchors keep a held object from creeping at the solver's step (urdf/SOURCES.md).
"""

from __future__ import annotations

import numpy as np

from cell.settings import GripperConfig
from hil.sim.physics import bullet
from urdf import FINGER_JOINT_NAMES

_ARRIVED = 0.0004
"""The width counts as reached this close to the target [m]."""
_STALLED_SPEED = 0.002
_STALLED_TIME = 0.05
"""Slower than this [m/s] for this long [s] before the target means: holding something."""
_LOST_CLOSING = 0.004
"""Fingers that close this much further [m] have lost what they held."""

_GEAR_ERP = 0.2
"""How fast the fingers' mechanics evens out a difference; stiffer, it chatters on a held onion."""


class SimGripper:
    """Fingers of body `body`; width is the distance between the pads [m]."""

    def __init__(self, client: int, body: int, joints: dict[str, int], config: GripperConfig) -> None:
        self._client, self._body, self._config = client, body, config
        self._fingers = [joints[name] for name in FINGER_JOINT_NAMES]
        self.target = config.stroke
        self._speed, self._force = config.max_speed, config.min_force
        self._stalled = 0.0
        self._held_width: float | None = None
        for finger in self._fingers:
            bullet.resetJointState(body, finger, config.stroke / 2, 0.0, physicsClientId=client)
            bullet.changeDynamics(
                body, finger, lateralFriction=0.9, spinningFriction=0.01, frictionAnchor=1,
                physicsClientId=client,
            )  # fmt: skip
        gear = bullet.createConstraint(
            body, self._fingers[0], body, self._fingers[1], bullet.JOINT_GEAR,
            [1, 0, 0], [0, 0, 0], [0, 0, 0], physicsClientId=client,
        )  # fmt: skip
        bullet.changeConstraint(gear, gearRatio=-1, maxForce=500, erp=_GEAR_ERP, physicsClientId=client)

    def command(self, width: float, speed: float, force: float) -> tuple[float, float, float]:
        """Start moving; returns (width [m], speed [m/s], force [N]) clipped to the device."""
        c = self._config
        self.target = float(np.clip(width, 0.0, c.stroke))
        self._speed = float(np.clip(speed, c.min_speed, c.max_speed))
        self._force = float(np.clip(force, c.min_force, c.max_force))
        self._stalled, self._held_width = 0.0, None
        return self.target, self._speed, self._force

    def place(self, fingers: tuple[float, float], holding: bool) -> None:
        """Put the fingers there at once [m], holding something or not, as seen elsewhere."""
        for finger, position in zip(self._fingers, fingers, strict=True):
            bullet.resetJointState(self._body, finger, position, 0.0, physicsClientId=self._client)
        self._held_width = sum(fingers) if holding else None

    def measure(self) -> tuple[float, float]:
        """Width [m] and its rate [m/s]."""
        states = bullet.getJointStates(self._body, self._fingers, physicsClientId=self._client)
        return sum(s[0] for s in states), sum(s[1] for s in states)

    def fingers(self) -> tuple[float, float]:
        """Positions of both fingers [m]."""
        left, right = bullet.getJointStates(self._body, self._fingers, physicsClientId=self._client)
        return left[0], right[0]

    @property
    def holding(self) -> bool:
        """Stopped on an object before the target width; until the fingers close further."""
        return self._held_width is not None

    def drive(self, period: float) -> bool:
        """Set the motors for the coming control period [s]; True while the fingers move."""
        width, rate = self.measure()
        error = self.target - width
        arrived = abs(error) <= _ARRIVED
        stalled = error < -_ARRIVED and abs(rate) < _STALLED_SPEED
        self._stalled = self._stalled + period if stalled else 0.0
        if self._held_width is None and self._stalled >= _STALLED_TIME:
            self._held_width = width
        elif self._held_width is not None and width < self._held_width - _LOST_CLOSING:
            self._stalled, self._held_width = 0.0, None
        # Half the speed and the whole force per finger: they share the object, not the force.
        velocity = 0.0 if arrived else float(np.clip(error / period, -self._speed, self._speed)) / 2
        for finger in self._fingers:
            bullet.setJointMotorControl2(
                self._body, finger, bullet.VELOCITY_CONTROL, targetVelocity=velocity,
                force=self._force, physicsClientId=self._client,
            )  # fmt: skip
        return not arrived and not self.holding
