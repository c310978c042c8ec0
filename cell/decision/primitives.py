"""The few things a skill is made of: follow a path, move the fingers, look, wait.

Skills are generators. `x = yield` hands the collected commands to the node and comes back
with the next tick's `Inputs`; a primitive is used as `result = yield from primitive(...)`.
Nothing here reads a clock or a wire, so a skill replays exactly from recorded inputs.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

import numpy as np

from cell.config import CellConfig
from cell.decision.io import Command, Inputs, Order
from cell.frames import Array
from cell.motion.timing import TimedPath
from cell.wire.types import Capture, Frame, GripperCommand, Reply, Trajectory

T = TypeVar("T")
Skill = Generator[None, Inputs, T]
"""A running skill or primitive; its return value is T."""

_REST_SPEED = 0.01
"""The arm counts as at rest below this joint speed [rad/s]."""
_SLACK = 2.0
"""How much longer than planned a motion may take [s]."""
_GRIPPER_TIME = 4.0
_REPLY_TIME = 1.0
"""Longest waits for the fingers and for a reply [s]."""


class SkillError(Exception):
    """A skill cannot go on. `code` is one word for the FSM, `reason` a sentence for people."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason


class Primitives:
    """Shared state of all skills: the newest inputs, outgoing commands, the arm's rest pose."""

    def __init__(self, config: CellConfig, holder: str) -> None:
        self.config = config
        self.holder = holder
        self.speed_cap = config.motion.collaborative_speed
        self.outbox: list[Command] = []
        self.inputs: Inputs | None = None
        self._tickets = 0
        self._trajectories = 0
        self._q_rest: Array | None = None

    # -- state ----------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """Time of the newest inputs [s]."""
        assert self.inputs is not None
        return self.inputs.t

    @property
    def q_rest(self) -> Array:
        """Joint angles (6,) [rad] from which the next motion starts: the last set-point."""
        assert self.inputs is not None
        return self.inputs.joints.q if self._q_rest is None else self._q_rest

    def forget_set_point(self) -> None:
        """After a stop: the next motion starts from measured joints."""
        self._q_rest = None

    def take_outbox(self) -> tuple[Command, ...]:
        """Commands collected since the last call, in order."""
        out = tuple(self.outbox)
        self.outbox.clear()
        return out

    # -- primitives -----------------------------------------------------------------------------

    def follow(self, path: TimedPath) -> Skill[None]:
        """Execute a timed path from rest to rest; returns when the set-point has arrived."""
        times, q, qd = path.to_points(self.config.arm.control_period)
        self._trajectories += 1
        number = self._trajectories
        order = Trajectory(
            id=number,
            holder=self.holder,
            start=0.0,
            expires=self.now + self.config.supervisor.command_lifetime,
            times=times,
            q=q,
            qd=qd,
        )
        yield from self._accepted(order)
        self._q_rest = np.array(q[-1])
        deadline = self.now + float(times[-1]) + _SLACK
        while True:
            arm = self._checked().arm
            if arm.trajectory_id == number and not arm.moving:
                return
            if self.now > deadline:
                raise SkillError("timeout", f"motion {number} did not finish in time")
            yield from self.tick()

    def settle(self) -> Skill[None]:
        """Wait until the arm's measured joints have come to rest at the set-point."""
        deadline = self.now + _SLACK
        while np.max(np.abs(self._checked().joints.qd)) > _REST_SPEED:
            if self.now > deadline:
                raise SkillError("timeout", "the arm does not come to rest")
            yield from self.tick()

    def grip(self, width: float) -> Skill[bool]:
        """Move the fingers to `width` [m]; True when they stopped on an object."""
        g = self.config.gripper
        yield from self._accepted(
            GripperCommand(
                self.holder,
                self.now + self.config.supervisor.command_lifetime,
                width,
                g.grip_speed,
                g.grip_force,
            )
        )
        deadline = self.now + _GRIPPER_TIME
        yield from self.tick()
        while self._checked().gripper.moving:
            if self.now > deadline:
                raise SkillError("timeout", "the gripper does not come to rest")
            yield from self.tick()
        return self._checked().gripper.holding

    def look(self, camera: str) -> Skill[Frame]:
        """One frame of `camera` exposed now; tries again when a frame does not come."""
        s = self.config.supervisor
        for _ in range(s.look_attempts):
            asked = self.now
            yield from self._accepted(Capture(self.holder), camera)
            while self.now <= asked + s.max_frame_age:
                for frame in self._checked().frames:
                    if frame.camera == camera and frame.t >= asked - 1e-9:
                        return frame
                yield from self.tick()
        raise SkillError("no_image", f"the {camera} camera delivers no frames")

    def holds(self) -> bool:
        """Something is between the fingers."""
        gripper = self._checked().gripper
        return gripper.holding and gripper.width > 0.5 * self.config.onions.diameter[0]

    def tick(self) -> Skill[None]:
        """Wait for the next tick."""
        self.inputs = yield

    # -- internals ------------------------------------------------------------------------------

    def _checked(self) -> Inputs:
        """The newest inputs; raises when the arm was stopped under the skill."""
        assert self.inputs is not None
        if self.inputs.arm.stopped:
            raise SkillError("stopped", self.inputs.arm.stop_reason or "the arm was stopped")
        return self.inputs

    def _accepted(self, order: Order, camera: str = "") -> Skill[Reply]:
        """Send an order and wait for its reply; raises `SkillError` when it is refused."""
        self._checked()
        self._tickets += 1
        ticket = self._tickets
        self.outbox.append(Command(ticket, order, camera))
        deadline = self.now + _REPLY_TIME
        while True:
            yield from self.tick()
            for number, reply in self._checked().replies:
                if number == ticket:
                    if not reply.accepted:
                        raise SkillError("refused", f"{reply.code}: {reply.reason}")
                    return reply
            if self.now > deadline:
                raise SkillError("timeout", "the node did not answer a command")
