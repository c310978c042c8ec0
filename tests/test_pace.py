"""The first motion of a device that needs arming is slow; frames leave a loop without holding it up."""

from __future__ import annotations

import numpy as np
import pytest

from cell.clock import perf_s
from cell.config import load
from cell.errors import RefusedError
from cell.limits import RefusalCode, tcp_positions
from cell.wire import types as T
from cell.wire.session import Session
from hil.backend import NeedsArming
from hil.guard import Guard
from hil.outbox import Outbox
from tests.fake_backend import FakeBackend
from tests.test_limits import HOME, move
from tests.wire_helpers import own_port, until

CONFIG = load()
AWAY = HOME + np.array([0.4, -0.2, 0.2, 0.1, 0.1, 0.2])


class Armed(FakeBackend):
    """A fake that must be armed; `ready` says whether it is.

    Attributes:
        calls: of `prepare` and `enable`.
    """

    first_motion_speed = 0.1

    def __init__(self) -> None:
        super().__init__(CONFIG)
        self.ready = True
        self.calls: list[str] = []
        self.connect()

    def prepare(self) -> None:
        self.calls.append("prepare")
        if not self.ready:
            raise RefusedError(RefusalCode.BUSY.value, "ask again")

    def enable(self) -> None:
        self.calls.append("enable")


class Desk:
    """A guard on it, and a commander."""

    def __init__(self) -> None:
        self.backend, self.said = Armed(), []  # type: ignore[var-annotated]
        self.guard = Guard(CONFIG, self.backend, lambda level, text: self.said.append(text))
        self.guard.beat("me", 0.0)
        self._number = 0

    def move(self, end: np.ndarray) -> tuple[float, float]:
        """(duration [s], greatest tool speed [m/s]) of a motion of 1.5 s as it was executed."""
        self._number += 1
        order = move(self.backend.q, end, 1.5)
        order = T.Trajectory(self._number, "me", 0.0, 1e9, order.times, order.q, order.qd)
        assert self.guard.on_trajectory(order).accepted
        q = []
        while self.guard.executor.moving:
            self.guard.cycle()
            q.append(self.backend.q)
        p = tcp_positions(np.array(q), CONFIG.gripper.length)
        period = CONFIG.arm.control_period
        return len(q) * period, float(np.linalg.norm(np.diff(p, axis=0), axis=1).max() / period)


def test_the_first_motion_is_slow_and_the_next_is_not() -> None:
    desk = Desk()
    seconds, speed = desk.move(AWAY)
    assert speed <= 0.1 * 1.02 and seconds > 2.0
    assert any("first motion: slowed down" in text for text in desk.said)
    seconds, speed = desk.move(HOME)
    assert seconds == pytest.approx(1.5, abs=0.02) and speed > 0.12


def test_the_status_tells_how_slow() -> None:
    desk = Desk()
    order = move(desk.backend.q, AWAY, 1.5)
    desk.guard.on_trajectory(T.Trajectory(1, "me", 0.0, 1e9, order.times, order.q, order.qd))
    assert 0.2 < desk.guard.status().speed_scaling < 0.7


def test_after_a_stop_it_is_armed_first_and_slow_again() -> None:
    desk = Desk()
    desk.move(AWAY)
    desk.guard.stop("a test")
    desk.backend.ready = False
    with pytest.raises(RefusedError, match="ask again"):
        desk.guard.on_resume(T.Resume("me"))
    assert desk.guard.status().stopped
    desk.backend.ready = True
    assert desk.guard.on_resume(T.Resume("me")).accepted
    assert desk.backend.calls == ["prepare", "prepare", "enable"]
    assert desk.move(HOME)[1] <= 0.1 * 1.02


def test_the_robots_own_word_for_a_stop_is_the_reason() -> None:
    desk = Desk()
    desk.backend.robot = T.ArmStatus(0.0, stop_reason="disconnected: nothing comes from the robot")
    desk.guard.cycle()
    assert desk.guard.status().stop_reason.startswith("disconnected")
    with pytest.raises(RefusedError, match="disconnected"):
        desk.guard.on_resume(T.Resume("me"))
    assert desk.backend.calls == ["prepare"]


def test_a_plain_backend_needs_no_arming() -> None:
    assert not isinstance(FakeBackend(CONFIG), NeedsArming)
    assert isinstance(Armed(), NeedsArming)


def test_frames_leave_on_a_thread_of_their_own() -> None:
    config = own_port()
    with Session.listen(config) as server, Session.connect(config) as client:
        reader = client.latest_frame("belt")
        outbox = Outbox(server)
        info = T.CameraInfo(0.0, "camera_belt", 640, 480, 600.0, 600.0, 319.5, 239.5)
        rgb, depth = np.zeros((480, 640, 3), np.uint8), np.ones((480, 640), np.float32)
        seen: list[T.Frame] = []
        until(lambda: _sent(outbox, info, rgb, depth) and bool(seen.extend(reader.take_all()) or seen), 10.0)
        began = perf_s()
        for k in range(20):
            outbox.put(T.Frame("belt", k + 2, 10.0 + k, rgb, depth), info)
        assert perf_s() - began < 0.05
        until(lambda: bool(seen.extend(reader.take_all()) or seen[-1].t == 29.0), 10.0)
        outbox.close()


def _sent(outbox: Outbox, info: T.CameraInfo, rgb: np.ndarray, depth: np.ndarray) -> bool:
    outbox.put(T.Frame("belt", 1, 1.0, rgb, depth), info)
    return True
