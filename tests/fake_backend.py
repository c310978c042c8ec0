"""A kinematic stand-in for a robot cell, for tests of the node alone: no physics, no rendering.

Joints are where the last set-point was. It checks what the node promises to every backend: one
thread drives it, and set-points come once per period.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import replace

import numpy as np

from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import BackendError, one_of
from cell.wire import types as T


class FakeBackend:
    """See `hil.backend.Backend`.

    Args:
        steppable: False: a backend with a real cycle of its own, which `advance` waits for.

    Attributes:
        robot: what `read_status` reports; tests put faults here.
        fail: raised by the next `advance`.
        delay: the next `advance` takes this much longer [s].
        commanded: every set-point (q, qd) so far.
        threads: identities of the threads that called.
    """

    name = "fake"

    def __init__(self, config: CellConfig, *, steppable: bool = True) -> None:
        self._config = config
        self.steppable = steppable
        self.robot = T.ArmStatus(0.0)
        self.fail: Exception | None = None
        self.delay = 0.0
        self.commanded: list[tuple[T.Array, T.Array]] = []
        self.threads: set[int] = set()
        self.batches: list[tuple[int, int]] = []
        self.advanced = 0
        self.signal = "off"
        self._clock = WallClock()
        self._connected = False
        self.q = np.array(config.arm.home)

    def connect(self) -> None:
        if not self._connected:
            self._connected = True
            self._start()

    def _start(self) -> None:
        self.q, self.qd = np.array(self._config.arm.home), np.zeros(6)
        self._ticks, self._seq, self._width = 0, 0, self._config.gripper.stroke
        self._frames: deque[T.Frame] = deque()

    def reset(self, seed: int, onions: int) -> None:
        if onions > 100:
            raise BackendError("so many onions do not fit; ask for at most 100")
        self._start()
        self.batches.append((onions, seed))

    def close(self) -> None:
        self._connected = False
        self.qd = np.zeros(6)

    def now(self) -> float:
        self.threads.add(threading.get_ident())
        if not self._connected:
            raise BackendError("the fake is not connected; call connect() first")
        return self._ticks * self._config.arm.control_period

    def command_joints(self, q: T.Array, qd: T.Array) -> None:
        assert len(self.commanded) == self.advanced, "two set-points in one period"
        self.commanded.append((q.copy(), qd.copy()))

    def command_gripper(self, width: float, speed: float, force: float) -> tuple[float, float, float]:
        c = self._config.gripper
        self._width = float(np.clip(width, 0.0, c.stroke))
        return (
            self._width,
            float(np.clip(speed, c.min_speed, c.max_speed)),
            float(np.clip(force, c.min_force, c.max_force)),
        )

    def command_light(self, signal: str) -> None:
        self.signal = signal

    def command_belt(self, onions: int, seed: int) -> None:
        self.batches.append((onions, seed))

    def advance(self) -> None:
        self.threads.add(threading.get_ident())
        if self.fail is not None:
            raise self.fail
        wait = self.delay + (0.0 if self.steppable else self._config.arm.control_period)
        self.delay = 0.0
        if wait:
            self._clock.sleep_until(self._clock.now() + wait)
        if len(self.commanded) > self.advanced:
            self.q, self.qd = self.commanded[-1]
            self.advanced += 1
        else:
            self.qd = np.zeros(6)  # no set-point came: stop
        self._ticks += 1

    def read_joints(self) -> T.JointState:
        return T.JointState(self.now(), self.q, self.qd, np.zeros(6))

    def read_status(self) -> T.ArmStatus:
        return replace(self.robot, t=self.now())

    def read_gripper(self) -> T.GripperState:
        return T.GripperState(self.now(), self._width, self._width, False, False)

    def read_belt(self) -> T.BeltState:
        return T.BeltState(self.now(), len(self.batches), False, 0.0)

    def camera_info(self, camera: str) -> T.CameraInfo:
        self._check(camera)
        return T.CameraInfo(self.now(), f"camera_{camera}", 16, 16, 20.0, 20.0, 8.0, 8.0)

    def request_frame(self, camera: str) -> None:
        self._check(camera)
        self._seq += 1
        rgb = np.full((16, 16, 3), self._seq, np.uint8)
        self._frames.append(T.Frame(camera, self._seq, self.now(), rgb, np.ones((16, 16), np.float32)))

    def _check(self, camera: str) -> None:
        if camera not in self._config.cameras:
            raise BackendError(f"camera: {one_of(camera, self._config.cameras)}")

    def take_frames(self) -> list[T.Frame]:
        due = [f for f in self._frames if f.t + self._config.cameras[f.camera].latency <= self.now() + 1e-9]
        self._frames = deque(f for f in self._frames if f not in due)
        return due
