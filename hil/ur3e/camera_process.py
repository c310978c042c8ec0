"""`python -m hil.ur3e.camera_process`: the cameras of a real arm's cell as a process of their own.

It reads its settings as one line of JSON from standard input, then a camera's name per line for each
picture that is asked for. It publishes every frame on the cell's wire, prints "ready" when all devices
are open, and "gone NAME TEXT" for one that fails. It ends when standard input closes (the node is gone).
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from typing import Any

import msgspec

from cell.clock import WallClock
from cell.config import CellConfig, from_dict
from cell.errors import CellError, WireError
from cell.wire.session import Session
from hil.cameras import CameraSource
from hil.outbox import publish_frame
from hil.real_time import be_ordinary
from hil.ur3e.cameras import make_cameras

_LOOK = 0.002
"""How often it is looked for frames [s]."""


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the node tells its cameras.

    Attributes:
        config: the cell. choice: see `make_cameras`. offset: of the node's wall clock [s].
    """

    config: dict[str, Any]
    choice: str
    robot_ip: str
    offset: float


def main() -> int:
    """Publish until told to end; returns the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the supervisor's to handle
    be_ordinary()  # whatever the node is: pictures may wait
    cameras: dict[str, CameraSource] = {}
    try:
        settings = msgspec.json.decode(sys.stdin.buffer.readline(), type=Settings)
        config, clock = from_dict(settings.config), WallClock(settings.offset)
        with Session.connect(config) as session:
            try:
                for name, camera in make_cameras(settings.choice, config, settings.robot_ip, clock).items():
                    cameras[name] = camera
                    camera.connect()
                _say("ready")
                _serve(cameras, session, config, clock)
            finally:
                for camera in cameras.values():
                    camera.close()
    except (CellError, msgspec.MsgspecError) as error:
        _say(" ".join(str(error).split()))
        return 2
    return 0


def _serve(cameras: dict[str, CameraSource], session: Session, config: CellConfig, clock: WallClock) -> None:
    """Take and publish until standard input ends."""
    ended = threading.Event()

    def obey() -> None:
        for line in sys.stdin.buffer:
            camera = cameras.get(line.decode().strip())
            if camera is not None:
                with suppress(CellError):  # a camera that is gone shows when frames are taken
                    camera.request()
        ended.set()

    threading.Thread(target=obey, name="requests", daemon=True).start()
    living = dict(cameras)
    while not ended.is_set():
        for name, camera in list(living.items()):
            try:
                frames = camera.take()
            except CellError as error:
                del living[name]
                _say(f"gone {name} {' '.join(str(error).split())}")
                continue
            for frame in frames:
                with suppress(WireError):  # the node ends first
                    publish_frame(session, frame, camera.info())
        clock.sleep_until(clock.now() + _LOOK)


def _say(text: str) -> None:
    with suppress(OSError):  # a node that died shows on standard input
        os.write(1, text.encode() + b"\n")


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # a device's own threads must not hold the process up
