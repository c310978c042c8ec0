"""Moments of a recording. What is shown is kept in memory, thinned to what a page can show."""

from __future__ import annotations

from bisect import bisect_right
from pathlib import Path
from typing import Any

import numpy as np

from cell.config import CellConfig, from_dict, load
from cell.errors import CellError, DecodeError
from cell.record.content import CONFIG_FILE
from cell.record.mcap_reader import Recorded, Recording
from cell.view.moment import SPAN, Curves, Moment
from cell.view.tool import tool_speed
from cell.wire import codec, pictures
from cell.wire.keys import Keys
from cell.wire.layouts_image import join
from cell.wire.types import (
    ArmStatus,
    Detections,
    Event,
    Frame,
    GripperState,
    Hands,
    JointState,
    PlannedPath,
    SupervisorState,
)

_MOVES, _PICTURES = 0.04, 0.25
"""What moves is kept this often, pictures without anything perceived this often [s]."""
_MOST = 1_500_000_000
"""Most bytes of a recording that are kept."""
_EVENTS = 12
_SAME_TIME = 1e-6
_JSON_LIMIT = 8 * 1024 * 1024


class Track:
    """The kept messages of one topic in the order of time."""

    def __init__(self, cls: type[Any] | None, every: float) -> None:
        self._cls, self._every = cls, every
        self.times: list[float] = []
        self._payloads: list[bytes] = []
        self._decoded: tuple[int, Any] = (-1, None)

    def add(self, t: float, payload: bytes) -> int:
        """Keep it if it is due; the bytes that are kept."""
        if self.times and t - self.times[-1] < self._every:
            return 0
        self.times.append(t)
        self._payloads.append(payload)
        return len(payload)

    def index(self, t: float) -> int:
        """Of the newest message at t [s]; -1 before the first."""
        return bisect_right(self.times, t + _SAME_TIME) - 1

    def at(self, index: int) -> Any:
        """The decoded message; None for index -1, or where it is garbled."""
        if index < 0:
            return None
        if self._decoded[0] != index:
            try:
                payload = self._payloads[index]
                message = pictures.expand(payload) if self._cls is None else codec.decode(self._cls, payload)
            except DecodeError:
                message = None
            self._decoded = (index, message)
        return self._decoded[1]

    def newest(self, t: float) -> Any:
        return self.at(self.index(t))


class RecordedSource:
    """A recording, shown at the time that it is set to.

    Attributes:
        config: of the recorded cell. start, end: of the recording [s]. t: what `moment` shows [s].

    Raises:
        DecodeError: not a recording of a cell.
    """

    def __init__(self, path: Path) -> None:
        recording = Recording(path)
        self.config = _configuration(recording)
        keys = Keys(self.config.name)
        kinds: dict[str, tuple[type[Any], float]] = {
            keys.joint_states: (JointState, _MOVES),
            keys.arm_status: (ArmStatus, _MOVES),
            keys.gripper_state: (GripperState, _MOVES),
            keys.supervisor_state: (SupervisorState, 0.0),
            keys.planned_path: (PlannedPath, 0.0),
            keys.detections: (Detections, 0.0),
            keys.hands: (Hands, 0.0),
            keys.events: (Event, 0.0),
        }
        self._tracks = {f"/{key}": Track(cls, every) for key, (cls, every) in kinds.items()}
        self._keys, self._cameras = keys, tuple(self.config.cameras)
        for camera in self._cameras:
            every = 0.0 if camera == "belt" else _PICTURES
            for topic in self._topics(camera):
                self._tracks[topic] = Track(None, every)
        size = 0
        for item in recording.items(frozenset(self._tracks)):
            if isinstance(item, Recorded):
                size += self._tracks[item.topic].add(item.t / 1e9, item.payload)
                if size > _MOST:
                    raise DecodeError(f"{path} is too long to be shown: more than {_MOST >> 20} MB of it")
        times = self._track(keys.joint_states).times
        if not times:
            raise DecodeError(f"{path} holds no joint states of a cell called '{self.config.name}'")
        self.start, self.end, self.t = times[0], times[-1], times[0]
        self._past = self._curves()

    def moment(self) -> Moment:
        t, keys = self.t, self._keys
        frames = {c: f for c in self._cameras if (f := self._frame(c, t)) is not None}
        events = self._track(keys.events)
        last = events.index(t)
        said = [events.at(i) for i in range(max(0, last - _EVENTS + 1), last + 1)]
        return Moment(
            t=t,
            fresh=True,
            joints=self._track(keys.joint_states).newest(t),
            arm=self._track(keys.arm_status).newest(t),
            gripper=self._track(keys.gripper_state).newest(t),
            state=self._track(keys.supervisor_state).newest(t),
            path=self._track(keys.planned_path).newest(t),
            frames=frames,
            detections=self._perceived(keys.detections, "belt", t),
            hands=self._perceived(keys.hands, "person", t),
            events=tuple(e for e in said if e is not None),
        )

    def curves(self) -> Curves:
        p = self._past
        a, b = np.searchsorted(p.t, (self.t - SPAN, self.t + _SAME_TIME))
        return Curves(p.t[a:b], p.belief[a:b], p.cap[a:b], p.speed[a:b])

    def close(self) -> None:
        """Nothing is open."""

    # -- parts ----------------------------------------------------------------------------------------

    def _track(self, key: str) -> Track:
        return self._tracks[f"/{key}"]

    def _topics(self, camera: str) -> tuple[str, str]:
        color, depth = (f"/{self._keys.camera(camera, what)}" for what in ("color", "depth"))
        return color + pictures.COLOR_SUFFIX, depth + pictures.DEPTH_SUFFIX

    def _frame(self, camera: str, t: float) -> Frame | None:
        """The newest whole frame at t [s]."""
        color, depth = (self._tracks[topic] for topic in self._topics(camera))
        i = color.index(t)
        if i < 0:
            return None
        j = depth.index(color.times[i])
        first, second = color.at(i), depth.at(j)
        if first is None or second is None or abs(color.times[i] - depth.times[j]) > _SAME_TIME:
            return None
        try:
            return join(i, first, second)
        except DecodeError:
            return None

    def _perceived(self, key: str, camera: str, t: float) -> Any:
        """The newest thing perceived whose frame was kept, with that frame."""
        track = self._track(key)
        times = self._tracks[self._topics(camera)[0]].times
        for i in range(track.index(t), max(-1, track.index(t) - 8), -1):
            near = bisect_right(times, track.times[i] + _SAME_TIME) - 1
            if near >= 0 and abs(times[near] - track.times[i]) < 1e-4:
                found, frame = track.at(i), self._frame(camera, track.times[i])
                if found is not None and frame is not None:
                    return found, frame
        return None

    def _curves(self) -> Curves:
        states, joints = self._track(self._keys.supervisor_state), self._track(self._keys.joint_states)
        length, rows = self.config.gripper.length, []
        for i, t in enumerate(states.times):
            state, moved = states.at(i), joints.newest(t)
            if state is not None and moved is not None:
                rows.append((t, state.belief, state.speed_cap, tool_speed(moved, length)))
        return Curves(*np.array(rows).reshape(-1, 4).T)


def _configuration(recording: Recording) -> CellConfig:
    """The cell as it was recorded; the shipped one where the recording does not say."""
    import json

    from mcap.records import Attachment

    for item in recording.items(frozenset()):
        if isinstance(item, Attachment) and item.name == CONFIG_FILE:
            try:
                return from_dict(json.loads(item.data[:_JSON_LIMIT]), f"{recording.path}, {CONFIG_FILE}")
            except (ValueError, RecursionError):
                raise DecodeError(f"{recording.path}: {CONFIG_FILE} is garbled") from None
            except CellError as error:
                raise DecodeError(f"{recording.path}: its cell is refused today: {error}") from None
    return load()
