"""Stands between commands and a backend: lease, expiry, limits, stops. No wire, no threads.

Every command of the contract passes one of the methods here, which answer with a `Reply` or
raise `RefusedError`. `cycle` is one control period: look at the robot's own state, compute the
set-point, hand it over, let the period pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from cell.config import CellConfig
from cell.errors import RefusedError, one_of
from cell.limits import Limits, RefusalCode
from cell.wire.types import (
    ArmStatus,
    BeltCommand,
    Capture,
    GripperCommand,
    LightCommand,
    Reply,
    Resume,
    Stop,
    Trajectory,
)
from cell.wire.vocabulary import SIGNALS
from hil.backend import Backend, NeedsArming
from hil.executor import Executor
from hil.lease import Lease
from hil.pace import FirstMotion

INFO, WARN, ERROR = 20, 30, 40
"""Levels of events."""
MAX_ONIONS = 1000
_RUNNING = 7
_SAFETY_FINE = (1, 2)
_SAFETY_NAMES = {
    3: "protective stop",
    4: "recovery",
    5: "safeguard stop",
    6: "system emergency stop",
    7: "robot emergency stop",
    8: "violation",
    9: "fault",
}
"""Universal Robots numbering: robot mode 7 runs; safety modes 1 normal and 2 reduced let it move."""


class Guard:
    """The rules of one connected backend.

    Args:
        say: told what people should know: level and text.

    Attributes:
        executor, lease: what they are; both start afresh with `renew`.
        refusal: code and reason of the last refused command, empty if none.
    """

    def __init__(self, config: CellConfig, backend: Backend, say: Callable[[int, str], None]) -> None:
        self._config, self._backend, self._say = config, backend, say
        self._limits = Limits.from_config(config)
        self._device = backend if isinstance(backend, NeedsArming) else None
        self._first = FirstMotion(self._device.first_motion_speed if self._device else math.inf, config)
        self.refusal = ""
        self.renew()

    def renew(self) -> None:
        """A new world: nobody commands, nothing runs, the set-point is where the arm is."""
        self.executor = Executor(self._limits, self._config.arm.control_period, self._backend.read_joints().q)
        self.lease = Lease(self._config.supervisor.heartbeat_deadline)

    # -- the control loop ------------------------------------------------------------------------

    def cycle(self) -> None:
        """One control period. Raises whatever the backend raises."""
        status = self._backend.read_status()
        if problem := robot_problem(status):
            self.stop(problem)
        q, qd = self.executor.tick(self._backend.now(), status.speed_scaling * self._first.pace)
        self._first.follow(self.executor)
        self._backend.command_joints(q, qd)
        self._backend.advance()

    def beat(self, holder: str, now: float) -> None:
        """A heartbeat heard at `now` [s]."""
        free = not self.lease.holder
        self.lease.beat(holder, now)
        if free:
            self.executor.forget_ids()
            self._say(INFO, f"'{holder}' holds the lease")

    def watch(self, now: float, deaf: float = 0.0) -> None:
        """Stop the arm when the lease's holder has been silent for too long at `now` [s].

        Args:
            deaf: time up to now in which nobody listened, and which is therefore no silence [s].
        """
        if deaf > 0.0:
            self.lease.excuse(deaf, now)
        if silent := self.lease.lost(now):
            deadline = self._config.supervisor.heartbeat_deadline
            self.stop(f"heartbeat lost: nothing from '{silent}' for {deadline * 1e3:.0f} ms")

    def stop(self, reason: str) -> None:
        """Brake on the path and latch."""
        if not self.executor.stop_reason:
            self._say(WARN, f"stop: {reason}")
            self._backend.command_light("stopped")
        self.executor.stop(reason)

    def status(self) -> ArmStatus:
        """The robot's state with the executor's and the lease's part filled in."""
        e, robot = self.executor, self._backend.read_status()
        return replace(
            robot,
            speed_scaling=robot.speed_scaling * self._first.pace,
            trajectory_id=e.trajectory_id,
            progress=e.progress,
            moving=e.moving,
            stopped=bool(e.stop_reason),
            stop_reason=e.stop_reason,
            last_refusal=self.refusal,
            lease=self.lease.holder,
        )

    def note_refusal(self, code: str, reason: str) -> None:
        """Keep it for the status and tell people."""
        self.refusal = f"{code}: {reason}"
        self._say(WARN, f"refused: {self.refusal}")

    # -- commands ----------------------------------------------------------------------------------

    def on_trajectory(self, trajectory: Trajectory) -> Reply:
        self.lease.require(trajectory.holder)
        self._robot_runs()
        self.executor.accept(trajectory, self._backend.now(), self._backend.read_joints().q)
        if text := self._first.begin(trajectory):
            self._say(INFO, text)
        return Reply(True)

    def on_stop(self, stop: Stop) -> Reply:
        self.stop(stop.reason or f"by '{stop.holder}'")
        return Reply(True)

    def on_resume(self, resume: Resume) -> Reply:
        self.lease.require(resume.holder)
        stopped = bool(self.executor.stop_reason)
        if self._device is not None and stopped:
            self._device.prepare()
        self._robot_runs()
        joints = self._backend.read_joints()
        self.executor.resume(joints.q, joints.qd)
        if stopped:
            if self._device is not None:
                self._device.enable()
            self._first.again()
            self._say(INFO, f"'{resume.holder}' lifted the stop")
        return Reply(True)

    def on_gripper(self, command: GripperCommand) -> Reply:
        self.lease.require(command.holder)
        self._fresh(command.expires)
        asked = {"width": command.width, "speed": command.speed, "force": command.force}
        for name, value in asked.items():
            if not math.isfinite(value):
                raise _refused(RefusalCode.NOT_FINITE, f"{name} must be a finite number, got {value}")
            if value < 0.0:
                raise _refused(RefusalCode.RANGE, f"{name} must be at least 0, got {value:g}")
        if self.executor.stop_reason:
            raise _refused(RefusalCode.STOPPED, f"{self.executor.stop_reason}; send resume first")
        sent = self._backend.command_gripper(command.width, command.speed, command.force)
        changes = [
            f"{name} {value:g} -> {got:g} {unit}"
            for (name, value), got, unit in zip(asked.items(), sent, ("m", "m/s", "N"), strict=True)
            if abs(value - got) > 1e-9
        ]
        return Reply(True, "clipped", f"the device's range: {', '.join(changes)}") if changes else Reply(True)

    def on_light(self, command: LightCommand) -> Reply:
        self.lease.require(command.holder)
        self._fresh(command.expires)
        if command.signal not in SIGNALS:
            raise _refused(RefusalCode.RANGE, f"signal: {one_of(command.signal, SIGNALS)}")
        if not self.executor.stop_reason:
            self._backend.command_light(command.signal)
        return Reply(True)

    def on_belt(self, command: BeltCommand) -> Reply:
        self.lease.require(command.holder)
        check_batch(command.onions, command.seed)
        self._backend.command_belt(command.onions, command.seed)
        return Reply(True)

    def on_capture(self, camera: str) -> Callable[[Capture], Reply]:
        """The handler of one camera's `capture`."""

        def capture(request: Capture) -> Reply:
            self.lease.require(request.holder)
            self._backend.request_frame(camera)
            return Reply(True)

        return capture

    def _fresh(self, expires: float) -> None:
        """Refuse a command whose time `expires` [s] has passed."""
        now = self._backend.now()
        if not math.isfinite(expires):
            raise _refused(RefusalCode.NOT_FINITE, "the expiry must be a finite time")
        if now > expires:
            raise _refused(RefusalCode.STALE, f"it expired {now - expires:.3f} s ago")

    def _robot_runs(self) -> None:
        if problem := robot_problem(self._backend.read_status()):
            raise _refused(RefusalCode.STOPPED, problem)


def robot_problem(status: ArmStatus) -> str:
    """Why the robot itself does not let the arm move; empty when it does."""
    if status.stop_reason:
        return status.stop_reason
    if status.safety_mode not in _SAFETY_FINE:
        name = _SAFETY_NAMES.get(status.safety_mode, "see the robot's log")
        return f"the robot's safety mode is {status.safety_mode} ({name})"
    if status.robot_mode != _RUNNING:
        return f"the robot is not running (robot mode {status.robot_mode})"
    return ""


def check_batch(onions: int, seed: int) -> None:
    """Refuse a batch that no backend could bring."""
    if not 1 <= onions <= MAX_ONIONS:
        raise _refused(RefusalCode.RANGE, f"onions must be 1..{MAX_ONIONS}, got {onions}")
    if seed < 0:
        raise _refused(RefusalCode.RANGE, f"seed must be at least 0, got {seed}")


def _refused(code: RefusalCode, reason: str) -> RefusedError:
    return RefusedError(code.value, reason)
