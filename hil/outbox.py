"""Publishes frames from a thread of its own, so that half a megabyte never holds up a control loop."""

from __future__ import annotations

import threading
from collections import deque
from contextlib import suppress
from dataclasses import replace

from cell.errors import WireError
from cell.wire.session import Session
from cell.wire.types import CameraInfo, Frame

_WAITING = 6
"""Most frames that may wait; older ones are dropped, and show on the wire as lost."""


def publish_frame(session: Session, frame: Frame, info: CameraInfo) -> None:
    """A frame and the intrinsics that belong to it."""
    session.publish_frame(frame)
    session.publish(session.keys.camera(frame.camera, "camera_info"), replace(info, t=frame.t))


class Outbox:
    """Frames on their way out."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._waiting: deque[tuple[Frame, CameraInfo]] = deque(maxlen=_WAITING)
        self._due = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._work, name="frames", daemon=True)
        self._thread.start()

    def put(self, frame: Frame, info: CameraInfo) -> None:
        """Hand a frame over; returns at once."""
        self._waiting.append((frame, info))
        self._due.set()

    def close(self) -> None:
        """Let the thread end after the frame it is at."""
        self._ended = True
        self._due.set()
        self._thread.join(2.0)

    def _work(self) -> None:
        while True:
            self._due.wait()
            self._due.clear()
            while self._waiting and not self._ended:
                frame, info = self._waiting.popleft()
                with suppress(WireError):  # the session ends before this thread does
                    publish_frame(self._session, frame, info)
            if self._ended:
                return
