"""The few things a skill is made of: follow a path, move the fingers, look, wait.

Skills are generators. `x = yield` hands the collected commands to the node and comes back
with the next tick's `Inputs`; a primitive is used as `result = yield from primitive(...)`.
Nothing here reads a clock or a wire, so a skill replays exactly from recorded inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TypeVar

import numpy as np

from cell.config import CellConfig
from cell.decision.following import Following, Lead, Obstructed, trajectory
from cell.decision.io import Command, Inputs, Order
from cell.frames import Array
from cell.motion.timing import TimedPath
from cell.wire.types import Capture, Frame, GripperCommand, LightCommand, Reply, Resume, Trajectory

T = TypeVar("T")
GiveWay = Callable[[], str]
"""Why what the arm does is to be given up; empty as long as it is not."""
Skill = Generator[None, Inputs, T]
"""A running skill or primitive; its return value is T."""

_REST_SPEED = 0.01
"""The arm counts as at rest below this joint speed [rad/s]."""
_SLACK = 2.0
"""How much longer than planned a motion may take [s]."""
_HORIZON = 1.2
"""How far ahead on its path the arm looks for a person [s]."""
_GRIPPER_TIME = 4.0
_REPLY_TIME = 1.0
"""Longest waits for the fingers and for a reply [s]."""


def never() -> str:
    """No reason to give way."""
    return ""


class SkillError(Exception):
    """A skill cannot go on. `code` is one word for the FSM, `reason` a sentence for people."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason


class Primitives:
    """Shared state of all skills: the newest inputs, outgoing commands, the arm's rest pose.

    Attributes:
        speed_cap: TCP speed cap in force [m/s]. obstructed: whether a person is in the way.
        waiting: the arm waits on its path for a person.
        held: an operator wants the arm to wait on its path; whoever sets it makes `obstructed` say so.
    """

    def __init__(self, config: CellConfig, holder: str) -> None:
        self.config = config
        self.holder = holder
        self.speed_cap = config.motion.collaborative_speed
        self.waiting = False
        self.held = False
        self.obstructed: Obstructed = lambda q: False
        lead = config.supervisor.seam_lead
        self._lead = Lead(lead, lead)
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

    def follow(self, path: TimedPath, give_way: GiveWay = never) -> Skill[None]:
        """Execute a timed path from rest to rest; returns when the set-point has arrived.

        On the way it is retimed whenever the cap changes, and waits while a person is in the way.

        Args:
            path: the plan, made under the present `speed_cap`.
            give_way: says why the motion is to be given up, empty as long as it is not.

        Raises:
            SkillError: "yielded" when it was given up; the arm rests on the path then.
        """
        cap = self.speed_cap
        while self.held:
            self._checked()
            yield from self.tick()
        began = self.now
        order = self._trajectory(path, 0.0)
        yield from self._accepted(order)
        moving = Following(self.config, path, order.id, began, cap, self._lead)
        deadline = self.now + path.duration + _SLACK
        given_way, before = "", self.now
        try:
            while True:
                inputs = self._checked()
                moving.note(inputs)
                # the arm's path clock runs slower than ours where the controller says so
                deadline += (self.now - before) * (1.0 - inputs.arm.speed_scaling)
                before = self.now
                self.waiting = moving.waiting
                if self.held:
                    moving.since = self.now  # an operator's patience has no end
                given_way = given_way or give_way()
                if moving.ended(inputs) or (given_way and moving.waiting):
                    break
                if moving.waiting and self.now - moving.since > self.config.separation.patience:
                    given_way = "a person stayed in the way"
                    break
                if given_way:
                    change = moving.stop_here(inputs)
                else:
                    change = moving.change(inputs, self.speed_cap, self.obstructed, _HORIZON)
                if change is not None:
                    self._send_change(moving, *change)
                if moving.waiting or change is not None:
                    deadline = self.now + moving.longest() + _SLACK
                if self.now > deadline:
                    raise SkillError("timeout", f"motion {order.id} did not finish in time")
                yield from self.tick()
        finally:
            self.waiting = False
        self._q_rest = moving.q_end()
        if given_way:
            raise SkillError("yielded", given_way)

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

    def pause(self, seconds: float) -> Skill[None]:
        """Let time pass."""
        end = self.now + seconds
        while self.now < end:
            self._checked()
            yield from self.tick()

    def show(self, signal: str) -> None:
        """Put a signal on the mode light, one of `vocabulary.SIGNALS`."""
        expires = self.now + self.config.supervisor.command_lifetime
        self._send(LightCommand(self.holder, expires, signal))

    def resume(self) -> int:
        """Ask the node to lift a latched stop; the ticket of its reply."""
        return self._send(Resume(self.holder))

    def tick(self) -> Skill[None]:
        """Wait for the next tick."""
        self.inputs = yield

    # -- internals ------------------------------------------------------------------------------

    def _trajectory(self, path: TimedPath, start: float) -> Trajectory:
        """The next trajectory's message."""
        self._trajectories += 1
        expires = self.now + self.config.supervisor.command_lifetime
        period = self.config.arm.control_period
        return trajectory(path, self._trajectories, self.holder, start, expires, period)

    def _send(self, order: Order) -> int:
        self._tickets += 1
        self.outbox.append(Command(self._tickets, order))
        return self._tickets

    def _send_change(self, moving: Following, path: TimedPath, start: float, holds: bool) -> None:
        order = self._trajectory(path, start)
        moving.sent(self._send(order), order.id, path, start, holds)

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
