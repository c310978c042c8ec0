"""The person in the simulated world: body in the picture, onions in the hands, truth for judging."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.frames import Array, inverse, pose
from cell.wire.types import PersonTruth
from hil.sim.person.agent import Agent
from hil.sim.person.body import Body
from hil.sim.person.persona import persona
from hil.sim.person.reach import Pose, Poser
from hil.sim.person.separation import RobotShape
from hil.sim.person.sight import Sight
from hil.sim.person.stance import Stance
from hil.sim.person.texture import paint
from hil.sim.physics import bullet
from hil.sim.render.scene import Visual

if TYPE_CHECKING:
    from hil.sim.world import World

LABEL = 7
_CHECK = 4
"""Contact with the robot is looked for every so many control periods."""
_HAND_RADIUS, _FOREARM_RADIUS = 0.05, 0.08
"""With room for how far the wrist bends [m]."""
_REACH_BACK = 0.25
"""Nothing of a person is farther ahead than the foremost hand's grip point and this [m]."""
_ROBOT_REACH = 0.12
"""Nothing of the robot is farther ahead than its foremost link and this [m]."""


class Presence:
    """One person in one world.

    Args:
        world: with its onions already in place. name: of the persona. seed: with it, decides all chance.
        anchor: a fixed PyBullet body to which the drawn mesh is attached. X_WA: its pose.

    Attributes:
        agent: who decides. sight: what it sees. poser: of its body. contacts: control periods in which
            the robot touched the person.
    """

    def __init__(self, world: World, name: str, seed: int, anchor: int, X_WA: Array) -> None:
        who = persona(name)
        self._world = world
        self.body = Body(who.body)
        self.poser = Poser(self.body, world.config.floor_z)
        self.sight = Sight(world)
        self.agent = Agent(who, world.config, self.poser, seed)
        self.contacts = 0
        self._robot = RobotShape(world.client, world.robot)
        self._held: int | None = None
        self._grip = np.zeros(3)
        self._X_HO = np.eye(4)
        self._ticks = 0
        self._posed = -1.0
        self._pose: Pose
        skin = paint(self.body, who.look)
        self._handle = world.scene.add(
            Visual(anchor, -1, inverse(X_WA), self.body.mesh, (1.0, 1.0, 1.0, 1.0), skin, LABEL)
        )
        self.refresh()

    # -- in the loop -----------------------------------------------------------------------------------

    def step(self, signal: str) -> None:
        """Live through one control period that has just passed."""
        now = self._world.time
        self.sight.signal = signal
        self.sight.follow()
        self.agent.advance(now, self.sight)
        if self.agent.held != self._held:
            self._change_hold(now)
        if self._held is not None:
            self._carry(now)
        self._ticks += 1
        if self._ticks % _CHECK == 0 and self._near(now) and self.separation() <= 0.0:
            self.contacts += _CHECK

    def stance(self) -> Stance:
        """How the person stands now."""
        return self.agent.figure.stance(self._world.time)

    def refresh(self, stance: Stance | None = None) -> None:
        """Bring the drawn mesh to a stance, or to the present one, before it is drawn."""
        at = self.pose() if stance is None else self.poser.pose(stance)
        vertices, normals = self.body.skin(at.G, at.p)
        self._world.scene.set_vertices(self._handle, vertices, normals)

    def pose(self) -> Pose:
        """All bones now."""
        now = self._world.time
        if now != self._posed:
            self._posed, self._pose = now, self.poser.pose(self.stance())
        return self._pose

    # -- truth ---------------------------------------------------------------------------------------------

    def truth(self) -> PersonTruth:
        """What the person is and does now."""
        agent, at = self.agent, self.pose()
        grips = np.array([self.poser.grip(at, side) for side in "LR"])
        return PersonTruth(
            agent.persona.name, agent.fatigued, int(agent.action), agent.gesture, self.separation(), grips,
            self.contacts, tuple(agent.gestures),
        )  # fmt: skip

    def separation(self) -> float:
        """From the skin to the robot, its gripper and the onion in it [m]; 0 in contact."""
        at = self.pose()
        return max(0.0, self._robot.distance(self.body.points(at.G, at.p), self._in_gripper()))

    def sorted_by_human(self, onion: int) -> bool:
        """The person has put this onion away."""
        return onion in self.agent.sorted_

    def _in_gripper(self) -> tuple[tuple[Array, float], ...]:
        onion = self.sight.in_gripper
        if onion is None:
            return ()
        return ((self.sight.place(onion), self._world.onions[onion].radius),)

    def _near(self, now: float) -> bool:
        """Whether a hand or forearm, as generous capsules, may meet the robot: worth a closer look.

        The rest of the body is farther back.
        """
        figure, world = self.agent.figure, self._world
        foremost = min(figure.grip(side, now)[0] for side in "LR") - _REACH_BACK
        if self._robot.ahead() + _ROBOT_REACH < foremost:
            return False
        for side in "LR":
            p, R = figure.grip(side, now), figure.grip_turn(side, now)
            wrist = p - R @ np.array([0.089, 0.0, 0.062])
            hand = wrist + np.linspace(0.0, 0.13, 5)[:, None] * R[:, 0]
            fore = wrist - np.linspace(0.0, 0.20, 5)[:, None] * R[:, 0]
            held = self._in_gripper() if world.gripper.holding else ()
            if self._robot.distance(hand, held) <= _HAND_RADIUS:
                return True
            if self._robot.distance(fore, held) <= _FOREARM_RADIUS:
                return True
        return False

    # -- the onion in the hand ---------------------------------------------------------------------------

    def _change_hold(self, now: float) -> None:
        world, new = self._world, self.agent.held
        if self._held is not None:
            body = world.onion_bodies[self._held]
            bullet.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0], physicsClientId=world.client)
            bullet.changeDynamics(
                body, -1, activationState=bullet.ACTIVATION_STATE_WAKE_UP, physicsClientId=world.client
            )
        if new is not None:
            self._X_HO = inverse(self._hand(now)) @ world.onion_pose(new)
        self._held = new

    def _carry(self, now: float) -> None:
        """The held onion follows the hand; in between, it moves on at the hand's speed."""
        assert self._held is not None
        world, body = self._world, self._world.onion_bodies[self._held]
        X_WO = self._hand(now) @ self._X_HO
        world.set_onion_pose(self._held, X_WO)
        period = world.config.arm.control_period
        ahead = (self.agent.figure.grip(self.agent.side, now + period) - self._hand(now)[:3, 3]) / period
        bullet.resetBaseVelocity(body, ahead.tolist(), [0, 0, 0], physicsClientId=world.client)

    def _hand(self, now: float) -> Array:
        figure, side = self.agent.figure, self.agent.side
        return pose(figure.grip_turn(side, now), figure.grip(side, now))
