"""What the simulated person can see of the cell, asked only when it matters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.frames import Array
from hil.sim.physics import bullet

if TYPE_CHECKING:
    from hil.sim.world import World

_FACING = 0.30
"""Cosine between a blemish's direction and the line of sight from which it is seen."""
_GRASPED = 0.05
"""What the closed gripper holds is this near to the tool centre point [m]."""
_LIFTED = 0.03
"""An onion that the robot lifted this far was dealt with [m]."""


class Sight:
    """`agent.Surroundings` of a world; also remembers which onions the robot dealt with.

    Args:
        tcp: link index of the tool centre point.

    Attributes:
        signal: what the mode light shows. in_gripper: the onion that the robot holds, or None.
        dealt: onions that the robot lifted, and so sorted.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._tcp = world.tcp_link
        self.signal = "off"
        self.in_gripper: int | None = None
        self.dealt: set[int] = set()
        self._from = 0.0

    def follow(self) -> None:
        """Notice what the gripper does; once per control period."""
        world = self._world
        if not world.gripper.holding:
            self.in_gripper = None
            return
        if self.in_gripper is None:
            self.in_gripper = self._grasped()
            self._from = self.place(self.in_gripper)[2] if self.in_gripper is not None else 0.0
        if self.in_gripper is not None and self.place(self.in_gripper)[2] > self._from + _LIFTED:
            self.dealt.add(self.in_gripper)

    def count(self) -> int:
        return len(self._world.onions)

    def place(self, onion: int) -> Array:
        p, _ = bullet.getBasePositionAndOrientation(
            self._world.onion_bodies[onion], physicsClientId=self._world.client
        )
        return np.array(p)

    def radius(self, onion: int) -> float:
        return self._world.onions[onion].collision_radius

    def free(self, onion: int) -> bool:
        if onion in self.dealt or onion == self.in_gripper:
            return False
        return self._world.place_of(onion) == "belt"

    def shows_blemish(self, onion: int, p_WE: Array) -> bool:
        X_WO = self._world.onion_pose(onion)
        sight = p_WE - X_WO[:3, 3]
        sight = sight / np.linalg.norm(sight)
        return any(
            float(sight @ X_WO[:3, :3] @ np.array(direction)) > _FACING
            for direction, _ in self._world.onions[onion].blemishes
        )

    def blemished(self, onion: int) -> bool:
        return self._world.onions[onion].blemished

    def tool(self) -> Array:
        state = bullet.getLinkState(
            self._world.robot, self._tcp, computeForwardKinematics=1, physicsClientId=self._world.client
        )
        return np.array(state[4])

    def _grasped(self) -> int | None:
        tool = self.tool()
        far = [float(np.linalg.norm(self.place(i) - tool)) for i in range(self.count())]
        if not far or min(far) > _GRASPED:
            return None
        return int(np.argmin(far))
