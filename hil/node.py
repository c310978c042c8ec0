"""The node: serves one backend on the wire and guards it.

All work happens on one thread. Commands arrive on the wire's threads, wait in an inbox and are
answered when the loop has taken them in. The node owns the trajectory execution, the lease, the
expiry of commands, the check of limits, and the stop when the supervisor falls silent.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import BackendError, RefusedError
from cell.limits import Limits, RefusalCode
from cell.wire.session import Session
from cell.wire.types import (
    ArmStatus,
    BeltCommand,
    Capture,
    ClockTick,
    Event,
    Frame,
    GripperCommand,
    Heartbeat,
    Reply,
    ResetRequest,
    Resume,
    StepReply,
    StepRequest,
    Stop,
    Trajectory,
    Truth,
    TruthRequest,
)
from hil.backend import Backend
from hil.executor import Executor
from hil.inbox import Inbox
from hil.lease import Lease

_MAX_STEP = 1000
_STATUS_TICKS = 5
"""Control periods between two publications of slow states."""
_MAX_CATCH_UP = 25
"""Simulated periods done in one go after a late cycle; what is later still is given up."""
_END_TIME = 3.0
"""Longest braking when the node is told to end [s]."""
_WARN = 30


class Node:
    """Serves `backend` on `session`.

    Args:
        lock_step: time moves only by `sim/step`.
    """

    def __init__(self, config: CellConfig, backend: Backend, session: Session, *, lock_step: bool) -> None:
        self._config, self._backend, self._session = config, backend, session
        self._lock_step = lock_step
        self._limits = Limits.from_config(config)
        self._lease = Lease(config.supervisor.heartbeat_deadline)
        self._inbox = Inbox(self._note_refusal)
        self._ended = threading.Event()
        self._clock = WallClock()
        self._refusal = ""
        self._ticks = 0
        self._published: ArmStatus | None = None
        self._executor = self._new_executor()
        self._beats = session.latest(session.keys.heartbeat, Heartbeat)
        self._serve()

    def end(self) -> None:
        """Ask the loop to stop the arm on its path and return; callable from any thread."""
        self._ended.set()
        self._inbox.wake()

    def run(self) -> None:
        """Serve until `end`. Raises whatever the backend raises, after stopping the arm."""
        try:
            if self._lock_step:
                self._run_lock_step()
            else:
                self._run_real_time()
        finally:
            self._brake("the node ends")

    # -- loops ------------------------------------------------------------------------------------

    def _run_lock_step(self) -> None:
        while not self._ended.is_set():
            self._inbox.work()

    def _run_real_time(self) -> None:
        """Keep the backend's time level with wall time; a late cycle is caught up, in bounds."""
        period = self._config.arm.control_period
        start = self._clock.now()
        done = 0
        while not self._ended.is_set():
            self._clock.sleep_until(start + (done + 1) * period)
            self._inbox.drain()
            due = int((self._clock.now() - start) / period) - done
            if due > _MAX_CATCH_UP:
                self._say(_WARN, f"the loop was {due * period * 1e3:.0f} ms late")
                start += (due - _MAX_CATCH_UP) * period
                due = _MAX_CATCH_UP
            for beat in self._beats.take_all():
                self._lease.beat(beat.holder, self._clock.now())
            self._watch_heart(self._clock.now())
            for _ in range(max(due, 1)):
                self._cycle()
                done += 1
            self._publish_frames()

    def _cycle(self) -> None:
        """One control period: set-point, backend, joint states."""
        now = self._backend.now()
        scaling = self._backend.read_status().speed_scaling
        q, qd = self._executor.tick(now, scaling)
        self._backend.command_joints(q, qd)
        self._backend.advance()
        keys = self._session.keys
        joints = self._backend.read_joints()
        self._session.publish(keys.joint_states, joints)
        self._ticks += 1
        status = self._status()
        if self._ticks % _STATUS_TICKS == 0 or self._changed(status):
            self._published = status
            self._session.publish(keys.arm_status, status)
            self._session.publish(keys.gripper_state, self._backend.read_gripper())
            self._session.publish(keys.belt_state, self._backend.read_belt())
            self._session.publish(keys.clock, ClockTick(joints.t))

    def _publish_frames(self) -> tuple[Frame, ...]:
        frames = tuple(self._backend.take_frames())
        for frame in frames:
            self._session.publish_frame(frame)
            info = self._backend.camera_info(frame.camera)
            self._session.publish(
                self._session.keys.camera(frame.camera, "camera_info"), replace(info, t=frame.t)
            )
        return frames

    def _watch_heart(self, now: float) -> None:
        silent = self._lease.lost(now)
        if silent:
            deadline = self._config.supervisor.heartbeat_deadline
            self._stop(f"no heartbeat of '{silent}' for {deadline * 1e3:.0f} ms")

    # -- wire --------------------------------------------------------------------------------------

    def _serve(self) -> None:
        keys = self._session.keys
        handlers: list[tuple[str, type[Any], Callable[[Any], Any]]] = [
            (keys.trajectory, Trajectory, self._on_trajectory),
            (keys.stop, Stop, self._on_stop),
            (keys.resume, Resume, self._on_resume),
            (keys.gripper_command, GripperCommand, self._on_gripper),
            (keys.belt_command, BeltCommand, self._on_belt),
        ]
        for camera in self._config.cameras:
            handlers.append((keys.camera(camera, "capture"), Capture, self._on_capture(camera)))
        if self._backend.steppable:
            handlers.append((keys.sim_truth, TruthRequest, self._on_truth))
            if self._lock_step:
                handlers += [
                    (keys.sim_step, StepRequest, self._on_step),
                    (keys.sim_reset, ResetRequest, self._on_reset),
                ]
        for key, kind, handler in handlers:
            self._session.serve(key, kind, self._inbox.wrap(handler))

    # -- commands (all on the loop's thread) -----------------------------------------------------------

    def _on_trajectory(self, trajectory: Trajectory) -> Reply:
        self._lease.require(trajectory.holder)
        self._executor.accept(trajectory, self._backend.now(), self._backend.read_joints().q)
        return Reply(True)

    def _on_stop(self, stop: Stop) -> Reply:
        self._stop(stop.reason or f"stop by '{stop.holder}'")
        return Reply(True)

    def _on_resume(self, resume: Resume) -> Reply:
        self._lease.require(resume.holder)
        joints = self._backend.read_joints()
        self._executor.resume(joints.q, joints.qd)
        return Reply(True)

    def _on_gripper(self, command: GripperCommand) -> Reply:
        self._lease.require(command.holder)
        self._fresh(command.expires)
        values = (command.width, command.speed, command.force)
        if not all(math.isfinite(v) and v >= 0 for v in values):
            raise RefusedError(RefusalCode.RANGE.value, "width, speed and force must be numbers >= 0")
        if self._executor.stopped:
            raise RefusedError(RefusalCode.STOPPED.value, f"{self._executor.stop_reason}; send resume first")
        sent = self._backend.command_gripper(*values)
        if np.allclose(sent, values, rtol=0, atol=1e-12):
            return Reply(True)
        return Reply(True, "clipped", "sent {:.4f} m, {:.3f} m/s, {:.0f} N".format(*sent))

    def _on_belt(self, command: BeltCommand) -> Reply:
        self._lease.require(command.holder)
        self._backend.command_belt(command.onions, command.seed)
        return Reply(True)

    def _on_capture(self, camera: str) -> Callable[[Capture], Reply]:
        def capture(request: Capture) -> Reply:
            self._lease.require(request.holder)
            self._backend.request_frame(camera)
            return Reply(True)

        return capture

    def _on_step(self, request: StepRequest) -> StepReply | Reply:
        if not 1 <= request.ticks <= _MAX_STEP:
            raise RefusedError(RefusalCode.RANGE.value, f"ticks must be 1..{_MAX_STEP}, got {request.ticks}")
        self._lease.beat(request.holder, self._backend.now())
        self._lease.require(request.holder)
        for _ in range(request.ticks):
            self._cycle()
        self._lease.beat(request.holder, self._backend.now())
        return self._samples(self._publish_frames())

    def _on_reset(self, request: ResetRequest) -> StepReply:
        self._lease.beat(request.holder, self._backend.now())
        self._lease.require(request.holder)
        reset = getattr(self._backend, "reset", None)
        if reset is None:
            raise RefusedError(RefusalCode.UNSUPPORTED.value, f"backend {self._backend.name} cannot be reset")
        reset(request.seed, request.onions)
        self._executor = self._new_executor()
        self._lease = Lease(self._config.supervisor.heartbeat_deadline)
        self._lease.beat(request.holder, self._backend.now())
        return self._samples(())

    def _on_truth(self, request: TruthRequest) -> Truth:
        del request
        truth: Callable[[], Truth] | None = getattr(self._backend, "truth", None)
        if truth is None:
            raise BackendError(f"backend {self._backend.name} knows no truth")
        return truth()

    # -- parts --------------------------------------------------------------------------------------------

    def _new_executor(self) -> Executor:
        return Executor(self._limits, self._config.arm.control_period, self._backend.read_joints().q)

    def _samples(self, frames: tuple[Frame, ...]) -> StepReply:
        backend = self._backend
        return StepReply(
            backend.read_joints(), self._status(), backend.read_gripper(), backend.read_belt(), frames
        )

    def _status(self) -> ArmStatus:
        e = self._executor
        return replace(
            self._backend.read_status(),
            trajectory_id=e.trajectory_id,
            progress=e.progress,
            moving=e.moving,
            stopped=e.stopped or bool(e.stop_reason),
            stop_reason=e.stop_reason,
            last_refusal=self._refusal,
            lease=self._lease.holder,
        )

    def _changed(self, status: ArmStatus) -> bool:
        if self._published is None:
            return True
        return replace(status, t=0.0, progress=0.0) != replace(self._published, t=0.0, progress=0.0)

    def _fresh(self, expires: float) -> None:
        now = self._backend.now()
        if now > expires:
            raise RefusedError(RefusalCode.STALE.value, f"it expired {now - expires:.3f} s ago")

    def _stop(self, reason: str) -> None:
        if not self._executor.stop_reason:
            self._say(_WARN, f"stop: {reason}")
        self._executor.stop(reason)

    def _brake(self, reason: str) -> None:
        """Bring the arm to rest on its path, for at most `_END_TIME`."""
        self._executor.stop(reason)
        period = self._config.arm.control_period
        for _ in range(round(_END_TIME / period)):
            if not self._executor.moving:
                return
            self._cycle()
            if not self._lock_step:
                self._clock.sleep_until(self._clock.now() + period)

    def _note_refusal(self, error: RefusedError) -> None:
        self._refusal = f"{error.code}: {error.reason}"
        self._say(_WARN, f"refused: {self._refusal}")

    def _say(self, level: int, text: str) -> None:
        self._session.publish(self._session.keys.events, Event(self._backend.now(), level, "node", text))
