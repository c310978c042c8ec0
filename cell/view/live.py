"""Moments of a running cell, from the wire. Readers hold the newest; nothing here makes anybody wait.

The simulation's truth is asked for by a thread of its own, twice a second and only while it is wanted.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, Protocol, TypeVar

from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import CellError, WireError
from cell.view.moment import Curves, Moment, Past
from cell.view.tool import tool_speed
from cell.wire.session import Session
from cell.wire.types import (
    ArmStatus,
    Detections,
    Event,
    Frame,
    GripperState,
    Hands,
    JointState,
    PlannedPath,
    Reply,
    SupervisorState,
    Truth,
    TruthRequest,
)

HOLDER = "view"
"""Name under which the view asks for things."""
_SILENT = 1.0
"""Without joint states for so long the cell counts as gone [s]."""
_ASK_EVERY = 0.5
_ANSWER = 2.0
_EVENTS = 12
_FRAMES = 6
_SAME_TIME = 1e-6


class _FromFrame(Protocol):
    @property
    def t(self) -> float: ...


F = TypeVar("F", bound=_FromFrame)


class Seen(Generic[F]):
    """Joins what was perceived with the frame that it was perceived in."""

    def __init__(self) -> None:
        self._waiting: deque[F] = deque(maxlen=_FRAMES)
        self.newest: tuple[F, Frame] | None = None

    def update(self, found: list[F], frames: deque[Frame]) -> None:
        self._waiting.extend(found)
        for one in self._waiting:
            for frame in frames:
                if abs(frame.t - one.t) < _SAME_TIME:
                    self.newest = (one, frame)


class LiveSource:
    """A client of a running cell.

    Args:
        timeout: how long to wait for the cell [s].

    Attributes:
        want_truth: whether to ask the simulation for the truth.

    Raises:
        WireError: no cell answers.
    """

    def __init__(self, config: CellConfig, timeout: float) -> None:
        self._session = Session.connect(config, timeout)
        session, keys = self._session, self._session.keys
        self._length = config.gripper.length
        self._joints = session.latest(keys.joint_states, JointState)
        self._arm = session.latest(keys.arm_status, ArmStatus)
        self._gripper = session.latest(keys.gripper_state, GripperState)
        self._state = session.latest(keys.supervisor_state, SupervisorState)
        self._path = session.latest(keys.planned_path, PlannedPath)
        self._detections = session.latest(keys.detections, Detections)
        self._hands = session.latest(keys.hands, Hands)
        self._events = session.latest(keys.events, Event)
        self._frames = {name: session.latest_frame(name) for name in config.cameras}
        self._kept: dict[str, deque[Frame]] = {name: deque(maxlen=_FRAMES) for name in config.cameras}
        self._seen_detections, self._seen_hands = Seen[Detections](), Seen[Hands]()
        self._said: deque[Event] = deque(maxlen=_EVENTS)
        self._past = Past()
        self._clock = WallClock()
        self._last_t, self._heard = -1.0, -1e9
        self._ended = threading.Event()
        self.want_truth = False
        self._truth: Truth | None = None
        threading.Thread(target=self._ask, name="truth", daemon=True).start()

    def moment(self) -> Moment:
        joints = self._joints.peek()
        now = self._clock.now()
        if joints is not None and joints.t != self._last_t:
            if joints.t < self._last_t:
                self._begin_again()
            self._last_t, self._heard = joints.t, now
        for name, reader in self._frames.items():
            self._kept[name].extend(reader.take_all())
        self._seen_detections.update(self._detections.take_all(), self._kept.get("belt", deque()))
        self._seen_hands.update(self._hands.take_all(), self._kept.get("person", deque()))
        self._said.extend(self._events.take_all())
        state = self._state.peek()
        if joints is not None and state is not None:
            speed = tool_speed(joints, self._length)
            self._past.note(joints.t, state.belief, state.speed_cap, speed)
        return Moment(
            t=self._last_t,
            fresh=now - self._heard < _SILENT,
            joints=joints,
            arm=self._arm.peek(),
            gripper=self._gripper.peek(),
            state=state,
            path=self._path.peek(),
            frames={name: kept[-1] for name, kept in self._kept.items() if kept},
            detections=self._seen_detections.newest,
            hands=self._seen_hands.newest,
            events=tuple(self._said),
            truth=self._truth,
        )

    def curves(self) -> Curves:
        return self._past.curves()

    def send(self, key: str, request: object) -> Reply:
        """Ask for something; a failing wire becomes a refusal with its text."""
        try:
            return self._session.call(key, request, Reply, _ANSWER)
        except CellError as error:
            return Reply(False, "wire", str(error))

    @property
    def session(self) -> Session:
        return self._session

    def close(self) -> None:
        self._ended.set()
        self._session.close()

    def _begin_again(self) -> None:
        """The node's clock was set back: another round."""
        for kept in self._kept.values():
            kept.clear()
        self._seen_detections, self._seen_hands = Seen[Detections](), Seen[Hands]()
        self._said.clear()
        self._truth = None

    def _ask(self) -> None:
        while not self._ended.wait(_ASK_EVERY):
            if not self.want_truth:
                self._truth = None
                continue
            try:
                key = self._session.keys.sim_truth
                self._truth = self._session.call(key, TruthRequest(HOLDER), Truth, timeout=_ANSWER)
            except WireError:
                self._truth = None
