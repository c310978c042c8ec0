"""The node: serves one backend on the wire and keeps its time.

All work happens on one thread. Commands arrive on the wire's threads, wait in an inbox and are
answered when the loop has taken them in; `hil.guard` decides about them. Three loops:

- lock-step: time moves only by `sim/step`;
- a steppable backend in real time: simulated time follows wall time. A late cycle (a rendered
  image takes some 30 ms) is caught up at once, up to `_MAX_CATCH_UP` periods; what is later still
  is given up, and simulated time falls behind for good;
- a backend with a cycle of its own: `advance` waits for it. Here nothing is caught up; frames leave
  by a thread of their own, and what happens to the devices becomes events.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

from cell.clock import Clock, WallClock
from cell.config import CellConfig
from cell.errors import BackendError, RefusedError
from cell.limits import RefusalCode
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
    LightCommand,
    ResetRequest,
    Resume,
    StepReply,
    StepRequest,
    Stop,
    Trajectory,
    Truth,
    TruthRequest,
)
from hil.backend import Backend, KnowsTruth, TellsNews, WorksAhead
from hil.guard import ERROR, WARN, Guard, check_batch
from hil.inbox import Inbox
from hil.outbox import Outbox, publish_frame
from hil.real_time import ask_for_real_time

_MAX_STEP = 1000
_STATUS_TICKS = 5
"""Control periods between two publications of slow states."""
_MAX_CATCH_UP = 25
"""Simulated periods done in one go after a late cycle."""
_END_TIME = 3.0
"""Longest braking when the node is told to end [s]."""
_PRIORITY = 2
"""Of the loop that a real arm depends on."""
_PATIENCE, _PATIENCE_LOCK_STEP = 1.5, 30.0
"""How long a command may wait for the loop [s]; callers in real time give up after 2 s."""


class _BackendFailed(BackendError):
    """Ends the loop."""


class Node:
    """Serves `backend`, which is connected, on `session`.

    Args:
        lock_step: time moves only by `sim/step`; needs a steppable backend.
        clock: wall time, for the schedule and the heartbeat's deadline.
    """

    def __init__(
        self,
        config: CellConfig,
        backend: Backend,
        session: Session,
        *,
        lock_step: bool,
        clock: Clock | None = None,
    ) -> None:
        if lock_step and not backend.steppable:
            raise BackendError(f"backend {backend.name} cannot run in lock-step: it has a clock of its own")
        self._config, self._backend, self._session = config, backend, session
        self._lock_step = lock_step
        self._clock: Clock = clock or WallClock()
        self._guard = Guard(config, backend, self._say)
        self._inbox = Inbox(self._guard.note_refusal, _PATIENCE_LOCK_STEP if lock_step else _PATIENCE)
        self._ended = False
        self._failure = ""
        self._ticks = 0
        self._listened = self._clock.now()
        self._published: ArmStatus | None = None
        self._beats = session.latest(session.keys.heartbeat, Heartbeat)
        self._serve()

    def end(self) -> None:
        """Ask the loop to stop the arm on its path and return; callable from anywhere."""
        self._ended = True
        self._inbox.wake()

    def run(self) -> None:
        """Serve until `end`, then brake.

        Raises:
            BackendError: the backend failed; the arm was braked as far as that was possible.
        """
        try:
            if self._lock_step:
                while not self._ended:
                    self._inbox.work()
                    self._use_idle_time()
            elif self._backend.steppable:
                self._follow_wall_time()
            else:
                self._follow_real_cycle()
        except _BackendFailed:
            pass  # said below, after braking
        finally:
            self._brake()
            self._inbox.close()
        if self._failure:
            raise BackendError(self._failure)

    # -- loops ------------------------------------------------------------------------------------

    def _use_idle_time(self) -> None:
        """While the supervisor thinks: work that a later step would have to do."""
        if isinstance(self._backend, WorksAhead):
            with self._backend_works():
                while self._inbox.empty and self._backend.work_ahead():
                    pass

    def _follow_wall_time(self) -> None:
        period = self._config.arm.control_period
        start, done = self._clock.now(), 0
        while not self._ended:
            self._clock.sleep_until(start + (done + 1) * period)
            self._listen()
            due = max(1, int((self._clock.now() - start) / period) - done)
            if due > _MAX_CATCH_UP:
                self._say(WARN, f"the loop was {due * period * 1e3:.0f} ms late")
                start += (due - _MAX_CATCH_UP) * period
                due = _MAX_CATCH_UP
            for _ in range(due):
                self._cycle()
            done += due
            self._publish_frames()

    def _follow_real_cycle(self) -> None:
        ask_for_real_time(_PRIORITY)
        sys.setswitchinterval(0.001)  # other threads must not keep the interpreter from the loop
        outbox = Outbox(self._session)
        try:
            while not self._ended:
                self._listen()
                self._cycle()
                with self._backend_works():
                    for frame in self._backend.take_frames():
                        outbox.put(frame, self._backend.camera_info(frame.camera))
                self._tell_news()
        finally:
            outbox.close()

    def _tell_news(self) -> None:
        if isinstance(self._backend, TellsNews):
            for level, text in self._backend.news():
                self._say(level, text)

    def _listen(self) -> None:
        """Take in commands and heartbeats; a heart that stopped stops the arm.

        A simulation that renders, or that a busy machine held up, was deaf meanwhile: beats sent
        then may still be on their way. A real arm's loop gets no such grace.
        """
        self._inbox.drain()
        now = self._clock.now()
        for beat in self._beats.take_all():
            self._guard.beat(beat.holder, now)
        late = now - self._listened - 2 * self._config.arm.control_period
        self._guard.watch(now, max(0.0, late) if self._backend.steppable else 0.0)
        self._listened = now

    def _cycle(self) -> None:
        """One control period, and its samples on the wire."""
        with self._backend_works():
            self._guard.cycle()
            self._publish_states()

    @contextmanager
    def _backend_works(self) -> Iterator[None]:
        """Whatever goes wrong inside ends the node."""
        try:
            yield
        except Exception as error:
            text = str(error) if isinstance(error, BackendError) else f"{type(error).__name__}: {error}"
            self._failure = self._failure or f"backend {self._backend.name} failed: {text}"
            self._ended = True
            raise _BackendFailed(self._failure) from error

    def _brake(self) -> None:
        """Bring the arm to rest on its path, for at most `_END_TIME`, as far as the backend can."""
        period, executor = self._config.arm.control_period, self._guard.executor
        if self._failure:
            self._say(ERROR, self._failure)
        executor.stop(self._failure or "the node ends")
        with suppress(Exception):
            for _ in range(round(_END_TIME / period)):
                if not executor.moving:
                    break
                due = self._clock.now() + period
                self._guard.cycle()
                self._publish_states()
                if self._backend.steppable and not self._lock_step:
                    self._clock.sleep_until(due)
            self._session.publish(self._session.keys.arm_status, self._guard.status())

    # -- samples ----------------------------------------------------------------------------------

    def _publish_states(self) -> None:
        """Joint states every period; the rest at 25 Hz, and when the arm's status changes."""
        keys, backend = self._session.keys, self._backend
        joints = backend.read_joints()
        self._session.publish(keys.joint_states, joints)
        self._ticks += 1
        status = self._guard.status()
        if self._ticks % _STATUS_TICKS == 0 or self._changed(status):
            self._published = status
            self._session.publish(keys.arm_status, status)
            self._session.publish(keys.gripper_state, backend.read_gripper())
            self._session.publish(keys.belt_state, backend.read_belt())
            self._session.publish(keys.clock, ClockTick(joints.t))

    def _changed(self, status: ArmStatus) -> bool:
        if self._published is None:
            return True
        return replace(status, t=0.0, progress=0.0) != replace(self._published, t=0.0, progress=0.0)

    def _publish_frames(self) -> tuple[Frame, ...]:
        with self._backend_works():
            frames = tuple(self._backend.take_frames())
            for frame in frames:
                publish_frame(self._session, frame, self._backend.camera_info(frame.camera))
        return frames

    def _samples(self, frames: tuple[Frame, ...]) -> StepReply:
        backend = self._backend
        return StepReply(
            backend.read_joints(), self._guard.status(), backend.read_gripper(), backend.read_belt(), frames
        )

    def _say(self, level: int, text: str) -> None:
        """An event. Telling people must never be what stops the loop."""
        with suppress(Exception):
            self._session.publish(self._session.keys.events, Event(self._backend.now(), level, "node", text))

    # -- wire -------------------------------------------------------------------------------------

    def _serve(self) -> None:
        keys, guard = self._session.keys, self._guard
        handlers: list[tuple[str, type[Any], Callable[[Any], Any]]] = [
            (keys.trajectory, Trajectory, guard.on_trajectory),
            (keys.stop, Stop, guard.on_stop),
            (keys.resume, Resume, guard.on_resume),
            (keys.gripper_command, GripperCommand, guard.on_gripper),
            (keys.light_command, LightCommand, guard.on_light),
            (keys.belt_command, BeltCommand, guard.on_belt),
        ]
        for camera in self._config.cameras:
            handlers.append((keys.camera(camera, "capture"), Capture, guard.on_capture(camera)))
        if self._backend.steppable:
            handlers.append((keys.sim_truth, TruthRequest, self._on_truth))
        elif isinstance(self._backend, KnowsTruth) and self._backend.truth is not None:
            # from another process, which may take its time: the loop must not wait for it
            truth = self._backend.truth
            self._session.serve(keys.sim_truth, TruthRequest, lambda request: truth())
        if self._lock_step:
            handlers.append((keys.sim_step, StepRequest, self._on_step))
            handlers.append((keys.sim_reset, ResetRequest, self._on_reset))
        for key, kind, handler in handlers:
            self._session.serve(key, kind, self._inbox.wrap(handler))

    def _on_step(self, request: StepRequest) -> StepReply:
        """Advance; the request is the heartbeat, so time between requests does not count."""
        if not 1 <= request.ticks <= _MAX_STEP:
            raise _refused(RefusalCode.RANGE, f"ticks must be 1..{_MAX_STEP}, got {request.ticks}")
        self._guard.beat(request.holder, self._backend.now())
        self._guard.lease.require(request.holder)
        for _ in range(request.ticks):
            self._cycle()
        self._guard.beat(request.holder, self._backend.now())
        return self._samples(self._publish_frames())

    def _on_reset(self, request: ResetRequest) -> StepReply:
        self._guard.beat(request.holder, 0.0)  # a world that could not be rebuilt has no time
        self._guard.lease.require(request.holder)
        check_batch(request.onions, request.seed)
        reset = getattr(self._backend, "reset", None)
        if reset is None:
            raise _refused(RefusalCode.UNSUPPORTED, f"backend {self._backend.name} cannot be reset")
        reset(request.seed, request.onions)
        self._guard.renew()
        self._guard.beat(request.holder, self._backend.now())
        self._published = None
        return self._samples(())

    def _on_truth(self, request: TruthRequest) -> Truth:
        del request
        truth: Callable[[], Truth] | None = getattr(self._backend, "truth", None)
        if truth is None:
            raise _refused(RefusalCode.UNSUPPORTED, f"backend {self._backend.name} knows no truth")
        return truth()


def _refused(code: RefusalCode, reason: str) -> RefusedError:
    return RefusedError(code.value, reason)
