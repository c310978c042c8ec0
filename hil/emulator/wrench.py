"""The force that the surroundings exert on the tool, as the controller's flange sensor reports it.

It is the weight of the onion that both fingers hold, and what everything else that touches the arm
or the gripper presses against it (normal forces of the contacts; their friction is left out). The
weight of the gripper itself is not in it: a sensor that was zeroed with the gripper mounted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cell.frames import Array
from hil.emulator.interfaces import ZERO6
from hil.sim.physics import bullet
from hil.sim.world import World
from urdf import FINGER_JOINT_NAMES

Contact = tuple[Any, ...]

_GRAVITY = 9.81
_W_TO_B = np.array([-1.0, -1.0, 1.0, -1.0, -1.0, 1.0])
"""World axes (ROS base_link) to the controller's base frame B: half a turn about z."""


class ToolForce:
    """Reads one world's contacts."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._fingers = {world.joints[name] for name in FINGER_JOINT_NAMES}

    def measure(self, contacts: Sequence[Contact], masses: Mapping[int, float]) -> Array:
        """Force [N] and torque [Nm] about the tool centre point, axes of B, shape (6,).

        Args:
            contacts: all of the robot, as `getContactPoints` gives them.
            masses: of the bodies that can be held [kg], by PyBullet body.
        """
        world, c = self._world, self._world.client
        points = [p for p in contacts if p[2] != world.robot]
        if not points:
            return ZERO6
        tool = bullet.getLinkState(world.robot, world.tcp_link, physicsClientId=c)[4]
        held = self._held(points, masses)
        out = np.zeros(6)
        for point in points:
            if point[2] in held:
                continue
            force = point[9] * np.array(point[7])  # the normal on B points towards the robot
            out[:3] += force
            out[3:] += np.cross(np.array(point[5]) - tool, force)
        out[2] -= _GRAVITY * sum(masses[body] for body in held)
        out *= _W_TO_B
        return out

    def _held(self, points: Sequence[Contact], masses: Mapping[int, float]) -> set[int]:
        """Bodies between the fingers, while the gripper is stopped on something."""
        if not self._world.gripper.holding:
            return set()
        touching = [{p[2] for p in points if p[3] == finger} for finger in self._fingers]
        return touching[0] & touching[1] & masses.keys()
