"""The rim between the supervisor and the wire: commands out, inputs in.

Two links share one small interface. `StepLink` moves simulated time itself (lock-step: the
result depends on nothing but seed and commands); `LiveLink` follows the node's own time,
beats its heart and refuses stale readings.
"""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import Protocol

from cell.clock import Clock, WallClock
from cell.config import CellConfig
from cell.decision.io import Command, Inputs
from cell.errors import StaleError, WireError
from cell.wire.session import Session
from cell.wire.types import (
    ArmStatus,
    BeltState,
    Capture,
    Frame,
    GripperCommand,
    GripperState,
    Heartbeat,
    JointState,
    LightCommand,
    Reply,
    Resume,
    StepReply,
    StepRequest,
    Stop,
    Trajectory,
)

_STEP_TIMEOUT = 60.0
"""Longest wall time one lock-step step may take [s]."""
_ANSWER_TIME = 2.0
"""Longest that a command may wait for its answer in real time [s]."""
_PATIENCE = 10
"""Stale joint states are waited out for this many times their greatest age."""
_LEASE = 3.0
"""How long the node may take to hear the heart [s]."""
_FIRST_DATA = 20.0
"""How long the first samples may take after connecting [s]."""


Look = Callable[[tuple[Frame, ...]], None]


class Link(Protocol):
    """One exchange per supervisor tick."""

    def exchange(self, commands: tuple[Command, ...], look: Look | None = None) -> Inputs:
        """Send the commands in order, let one cycle pass, and return what is known then.

        Args:
            look: shown the frames that the inputs will hold, before the arm's state is read.
        """
        ...

    def stop(self, reason: str) -> None:
        """Stop the arm on its path and wait until it rests."""
        ...

    def close(self) -> None: ...


def send(session: Session, command: Command, timeout: float = _ANSWER_TIME) -> Reply:
    """Send one command to the node; a failing wire becomes a refusal with its text."""
    keys, order = session.keys, command.order
    match order:
        case Trajectory():
            key = keys.trajectory
        case GripperCommand():
            key = keys.gripper_command
        case Resume():
            key = keys.resume
        case LightCommand():
            key = keys.light_command
        case Capture():
            key = keys.camera(command.camera, "capture")
    try:
        return session.call(key, order, Reply, timeout)
    except WireError as error:
        return Reply(False, "wire", str(error))


class StepLink:
    """Lock-step: time moves by `sim/step`, whose reply carries every sample."""

    def __init__(self, session: Session, config: CellConfig, holder: str) -> None:
        self._session, self._holder = session, holder
        self._ticks = config.supervisor.ticks_per_cycle
        self._rest_cycles = round(3.0 / (self._ticks * config.arm.control_period))

    def exchange(self, commands: tuple[Command, ...], look: Look | None = None) -> Inputs:
        del look  # time stands still meanwhile
        # A busy machine may take its time; a refusal for that would change the result.
        replies = tuple((c.ticket, send(self._session, c, _STEP_TIMEOUT)) for c in commands)
        return _inputs(self._step(), replies)

    def stop(self, reason: str) -> None:
        self._session.call(self._session.keys.stop, Stop(self._holder, reason), Reply)
        for _ in range(self._rest_cycles):
            if not self._step().arm_status.moving:
                return

    def close(self) -> None:
        """Nothing to end: the session belongs to the caller."""

    def _step(self) -> StepReply:
        request = StepRequest(self._holder, self._ticks)
        return self._session.call(self._session.keys.sim_step, request, StepReply, timeout=_STEP_TIMEOUT)


class LiveLink:
    """Real time: the node runs freely; readings have an age, the heart beats in a thread.

    The heart beats only while the decision loop comes by at least every `loop_deadline`, so a
    hung loop is noticed by the node like a dead process, a little later.
    """

    def __init__(self, session: Session, config: CellConfig, holder: str) -> None:
        keys = session.keys
        self._session, self._config, self._holder = session, config, holder
        self._clock: Clock = WallClock()
        self._period = config.supervisor.ticks_per_cycle * config.arm.control_period
        self._joints = session.latest(keys.joint_states, JointState)
        self._arm = session.latest(keys.arm_status, ArmStatus)
        self._gripper = session.latest(keys.gripper_state, GripperState)
        self._belt = session.latest(keys.belt_state, BeltState)
        self._frames = {name: session.latest_frame(name) for name in config.cameras}
        self._heart = Heart(session, holder, config.supervisor.heartbeat_deadline)
        self._offsets: deque[tuple[float, float]] = deque()
        self._seen: float | None = None
        self._next = self._clock.now()
        self._wait_for_data()

    def exchange(self, commands: tuple[Command, ...], look: Look | None = None) -> Inputs:
        replies = tuple((c.ticket, send(self._session, c)) for c in commands)
        # Absolute schedule; a late cycle starts the next one at once, without catching up.
        self._next = max(self._next + self._period, self._clock.now() - self._period)
        self._clock.sleep_until(self._next)
        self._heart.loop_lives()
        frames: list[Frame] = []
        for reader in self._frames.values():
            frames += reader.take_all()
        if look is not None:
            look(tuple(frames))
        joints = self._fresh_joints()
        now, oldest = joints.t, self._config.supervisor.max_state_age
        return Inputs(
            t=joints.t,
            joints=joints,
            arm=self._arm.get(now, 2 * oldest),
            gripper=self._gripper.get(now, 2 * oldest),
            belt=self._belt.get(now, 1.0),
            frames=tuple(frames),
            replies=replies,
        )

    def stop(self, reason: str) -> None:
        self._session.call(self._session.keys.stop, Stop(self._holder, reason), Reply)
        end = self._clock.now() + 3.0
        while self._clock.now() < end:
            self._clock.sleep_until(self._clock.now() + 0.02)
            arm = self._arm.peek()
            if arm is not None and arm.stopped and not arm.moving:
                return

    def close(self) -> None:
        self._heart.close()

    def _fresh_joints(self) -> JointState:
        """The newest joint state; while it is stale nothing is decided, and in the end it raises."""
        oldest = self._config.supervisor.max_state_age
        deadline = self._clock.now() + _PATIENCE * oldest
        while True:
            try:
                return self._joints.get(self._now(), oldest)
            except StaleError:
                if self._clock.now() > deadline:
                    raise
            self._clock.sleep_until(self._clock.now() + 0.004)

    def _now(self) -> float:
        """Present time on the node's clock [s]: ours, moved by the least delayed recent sample.

        A simulation that could not keep up slips behind wall time, so only the samples of the
        last second count; a node that has fallen silent adds none, and its age grows.
        """
        wall = self._clock.now()
        newest = self._joints.peek()
        if newest is not None and newest.t != self._seen:
            self._seen = newest.t
            self._offsets.append((wall, newest.t - wall))
            while wall - self._offsets[0][0] > 1.0:
                self._offsets.popleft()
        return wall + max((offset for _, offset in self._offsets), default=0.0)

    def _wait_for_data(self) -> None:
        """Block until every reader has something; raises `StaleError` naming what is missing."""
        for reader in (self._joints, self._arm, self._gripper, self._belt):
            if reader.peek() is None:
                reader.wait(_FIRST_DATA)
        self._wait_for_lease()
        self._next = self._clock.now()

    def _wait_for_lease(self) -> None:
        """Until the node has heard our heart: before, it would refuse the first commands."""
        end = self._clock.now() + _LEASE
        while (owner := self._owner()) != self._holder:
            if self._clock.now() > end:
                raise WireError(
                    f"'{owner}' drives this cell; end it first"
                    if owner
                    else "the node does not hear heartbeats"
                )
            self._clock.sleep_until(self._clock.now() + 0.01)

    def _owner(self) -> str:
        arm = self._arm.peek()
        return "" if arm is None else arm.lease


class Heart:
    """Beats on the wire from its own thread while the decision loop is alive."""

    def __init__(self, session: Session, holder: str, deadline: float) -> None:
        self._session, self._holder = session, holder
        self._beat, self._loop_deadline = 0.2 * deadline, 8.0 * deadline
        self._clock = WallClock()
        sys.setswitchinterval(0.001)  # planning must not keep the interpreter from the heart for long
        self._alive = self._clock.now()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)
        self._thread.start()

    def loop_lives(self) -> None:
        """The decision loop came by."""
        self._alive = self._clock.now()

    def close(self) -> None:
        self._ended.set()
        self._thread.join(1.0)

    def _run(self) -> None:
        seq = 0
        while not self._ended.wait(self._beat):
            now = self._clock.now()
            if now - self._alive <= self._loop_deadline:
                seq += 1
                self._session.publish(self._session.keys.heartbeat, Heartbeat(self._holder, seq, now))


def _inputs(reply: StepReply, replies: tuple[tuple[int, Reply], ...]) -> Inputs:
    return Inputs(
        t=reply.joint_state.t,
        joints=reply.joint_state,
        arm=reply.arm_status,
        gripper=reply.gripper_state,
        belt=reply.belt_state,
        frames=reply.frames,
        replies=replies,
    )
