"""The cameras of a real arm's backend, in its own process or in one of their own.

Encoding and sending a picture of a megabyte holds Python's interpreter lock, and a congested wire holds it
for longer still; the node's loop must not wait for that. So the node lets a process of their own
(`hil.ur3e.camera_process`) publish the frames; whoever uses the backend without a wire takes them here.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections import deque
from contextlib import suppress
from dataclasses import replace
from typing import Protocol

from cell.cameras import camera_pinhole
from cell.child import end_child
from cell.clock import WallClock
from cell.config import CellConfig, to_dict
from cell.errors import BackendError, CellError, one_of
from cell.wire.types import CameraInfo, Frame
from hil.cameras import CameraSource
from hil.ur3e.cameras import make_cameras

_START, _END = 30.0, 4.0
"""How long the process may take to open its devices, and to close them [s]."""
_NEWS_KEPT = 50


class Cameras(Protocol):
    """All cameras of a cell."""

    def connect(self) -> None:
        """Open the devices. Raises `CellError` with what to do when one is absent."""
        ...

    def info(self, name: str) -> CameraInfo:
        """Intrinsics of a camera; known from `connect` on."""
        ...

    def request(self, name: str) -> None:
        """Expose one frame now; raises `BackendError` for a camera that is not there (any more)."""
        ...

    def take(self) -> list[Frame]:
        """Frames that arrived and are not published elsewhere, each once; never blocks."""
        ...

    def news(self) -> list[str]:
        """What people should know since the last call."""
        ...

    def close(self) -> None:
        """Harmless when repeated."""
        ...


class CameraSet:
    """Cameras in this process; see `Cameras`.

    Args:
        choice: "real", "sim" or a recording; see `hil.ur3e.cameras.make_cameras`.
    """

    def __init__(self, choice: str, config: CellConfig, robot_ip: str, clock: WallClock) -> None:
        self._made = (choice, config, robot_ip, clock)
        self._cameras: dict[str, CameraSource] = {}
        self._dead: set[str] = set()
        self._news: list[str] = []

    def connect(self) -> None:
        for name, camera in make_cameras(*self._made).items():
            self._cameras[name] = camera
            camera.connect()

    def info(self, name: str) -> CameraInfo:
        return self._camera(name).info()

    def request(self, name: str) -> None:
        camera = self._camera(name)
        if name in self._dead:
            raise gone(name)
        camera.request()

    def take(self) -> list[Frame]:
        frames: list[Frame] = []
        for name, camera in self._cameras.items():
            if name in self._dead:
                continue
            try:
                frames += camera.take()
            except CellError as error:
                self._dead.add(name)
                self._news.append(f"camera {name} is gone: {error}")
        return frames

    def news(self) -> list[str]:
        out, self._news = self._news, []
        return out

    def close(self) -> None:
        for camera in self._cameras.values():
            camera.close()
        self._cameras.clear()
        self._dead.clear()

    def _camera(self, name: str) -> CameraSource:
        if name not in self._cameras:
            raise BackendError(f"camera: {one_of(name, self._cameras)}")
        return self._cameras[name]


class CamerasApart:
    """Cameras in a process of their own, which publishes their frames on the cell's wire; see `Cameras`.

    The node's end of the wire must be open before `connect`. Arguments as for `CameraSet`.
    """

    def __init__(self, choice: str, config: CellConfig, robot_ip: str, clock: WallClock) -> None:
        self._choice, self._config, self._robot_ip, self._clock = choice, config, robot_ip, clock
        self._process: subprocess.Popen[bytes] | None = None
        self._words: deque[str] = deque(maxlen=_NEWS_KEPT)
        self._dead: set[str] = set()
        self._answered = threading.Event()
        self._ready = False

    def connect(self) -> None:
        settings = {
            "config": to_dict(self._config),
            "choice": self._choice,
            "robot_ip": self._robot_ip,
            "offset": self._clock.offset,
        }
        process = self._process = subprocess.Popen(
            [sys.executable, "-m", "hil.ur3e.camera_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        threading.Thread(target=self._listen, args=(process,), name="cameras", daemon=True).start()
        self._tell(json.dumps(settings))
        if not self._answered.wait(_START) or not self._ready:
            words = self.news()
            self.close()
            raise BackendError(words[-1] if words else f"the cameras did not start within {_START:g} s")

    def info(self, name: str) -> CameraInfo:
        camera = self._config.cameras.get(name)
        if camera is None:
            raise BackendError(f"camera: {one_of(name, self._config.cameras)}")
        p = camera_pinhole(camera)
        info = CameraInfo(0.0, f"camera_{name}", p.width, p.height, p.fx, p.fy, p.cx, p.cy)
        return replace(info, t=self._clock.now())

    def request(self, name: str) -> None:
        self.info(name)  # raises for a name that is none
        if name in self._dead or self._process is None or self._process.poll() is not None:
            raise gone(name)
        self._tell(name)

    def take(self) -> list[Frame]:
        return []

    def news(self) -> list[str]:
        out = []
        while self._words:
            out.append(self._words.popleft())
        return out

    def close(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            end_child(process, _END)

    def _tell(self, line: str) -> None:
        assert self._process is not None and self._process.stdin is not None
        with suppress(OSError):  # a process that died shows in its last words
            self._process.stdin.write(line.encode() + b"\n")
            self._process.stdin.flush()

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        """The process says "ready", "gone NAME TEXT", or one line of why it ends."""
        assert process.stdout is not None
        for line in process.stdout:
            text = line.decode("utf-8", "replace").strip()
            if text == "ready":
                self._ready = True
                self._answered.set()
            elif text.startswith("gone "):
                _, name, why = text.split(" ", 2)
                self._dead.add(name)
                self._words.append(f"camera {name} is gone: {why}")
            else:
                self._words.append(text)
        if self._ready and self._process is process:
            self._dead.update(self._config.cameras)
            self._words.append("the cameras' process ended: no camera is there any more")
        self._answered.set()


def gone(name: str) -> BackendError:
    """For a request to a camera that was there once."""
    return BackendError(f"camera {name} is gone; see the events")
