"""What all real cameras share: a grabbing thread, and which of its pictures are wanted."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from cell.clock import Clock
from cell.errors import BackendError, CellError
from cell.wire.types import Frame

_KEPT = 8
"""Most frames that wait to be taken; the oldest are dropped."""
SILENCE = 3.0
"""A camera that has sent nothing for so long counts as gone [s]."""


class Shutter:
    """Picks from a stream of exposures those that were asked for, and those that are due.

    Args:
        rate: of the free-running stream [Hz]; 0: on request only.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._due = 0.0
        self._asked: deque[float] = deque(maxlen=_KEPT)

    def ask(self, now: float) -> None:
        """The next exposure from `now` [s] on is wanted."""
        self._asked.append(now)

    def wants(self, exposed: float) -> bool:
        """Whether the exposure at `exposed` [s] is one of them; asks once per exposure."""
        asked = False
        while self._asked and self._asked[0] <= exposed:
            self._asked.popleft()
            asked = True
        if self._rate > 0.0 and exposed >= self._due:
            self._due = max(self._due + 1.0 / self._rate, exposed + 0.5 / self._rate)
            return True
        return asked


class Grabber:
    """Runs `grab` in a thread until it is closed, or until the camera is gone.

    Args:
        name: of the camera.
        grab: waits a little for a picture; None when none came, or none is wanted. Returns whether the
            device lives, and the frame.
    """

    def __init__(self, name: str, grab: Callable[[], tuple[bool, Frame | None]], clock: Clock) -> None:
        self._name, self._grab, self._clock = name, grab, clock
        self._frames: deque[Frame] = deque(maxlen=_KEPT)
        self._problem = ""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"camera {name}", daemon=True)
        self._thread.start()

    def take(self) -> list[Frame]:
        """Frames since the last call; raises `BackendError` when the camera is gone."""
        out = []
        while self._frames:
            out.append(self._frames.popleft())
        if not out and self._problem:
            raise BackendError(self._problem)
        return out

    def close(self) -> None:
        """End the thread; it finishes the picture it is at."""
        self._ended.set()
        self._thread.join(3.0)

    def _work(self) -> None:
        heard = self._clock.now()
        try:
            while not self._ended.is_set():
                lives, frame = self._grab()
                now = self._clock.now()
                heard = now if lives else heard
                if frame is not None:
                    self._frames.append(frame)
                if now - heard > SILENCE:
                    self._problem = f"no picture for {SILENCE:g} s; look at its cable"
                    return
        except (CellError, RuntimeError, OSError) as error:
            self._problem = " ".join(str(error).split()) or type(error).__name__
