"""`python -m hil.ur3e.driver_process`: the arm's driver as a process of its own.

It reads its settings as one line of JSON from standard input, shares memory with the node by an
inherited descriptor, prints "ready" when it is connected, and afterwards a line for whatever people
should know. It brakes and ends when standard input closes (the node is gone) or on SIGTERM.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType
from typing import Annotated

import msgspec

from cell.clock import WallClock
from cell.errors import BackendError
from cell.limits import Q_MAX, QD_MAX
from hil.real_time import be_ordinary
from hil.ur3e.arm_link import UrRtde
from hil.ur3e.block import Measurements, Orders, Six, attach
from hil.ur3e.dashboard import stop_program
from hil.ur3e.servo_loop import ServoLoop


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the node tells its driver; see `cell.settings_ur3e.Ur3eConfig`.

    Attributes:
        memory: descriptor of the shared memory. offset: of the node's wall clock [s].
    """

    robot_ip: str
    memory: Annotated[int, msgspec.Meta(ge=0)]
    offset: float
    lookahead: float
    gain: float
    patience: float
    stop_deceleration: float
    payload: float
    payload_cog: tuple[float, float, float]
    tcp: Six


def main() -> int:
    """Drive until told to end; returns the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the supervisor's to handle
    be_ordinary()  # ur-rtde waits for the controller in busy loops; only its receivers are preferred
    try:
        settings = msgspec.json.decode(sys.stdin.buffer.readline(), type=Settings)
        memory = attach(settings.memory)
    except (msgspec.MsgspecError, OSError) as error:
        _say(f"the driver's settings are no use: {error}")
        return 2
    try:
        link = UrRtde(
            settings.robot_ip,
            lookahead=settings.lookahead,
            gain=settings.gain,
            deceleration=settings.stop_deceleration,
            payload=settings.payload,
            cog=settings.payload_cog,
            tcp=settings.tcp,
        )
    except BackendError as error:
        _say(str(error))
        return 2
    loop = ServoLoop(
        link,
        Orders(memory),
        Measurements(memory),
        WallClock(settings.offset),
        patience=settings.patience,
        q_max=_six(Q_MAX.tolist()),
        qd_max=_six(QD_MAX.tolist()),
        stop_program=lambda: stop_program(settings.robot_ip),
        say=_say,
    )

    def on_term(number: int, frame: FrameType | None) -> None:
        del number, frame
        loop.end()

    def watch_node() -> None:
        sys.stdin.buffer.read()
        loop.end()

    signal.signal(signal.SIGTERM, on_term)
    threading.Thread(target=watch_node, name="node", daemon=True).start()
    sys.setswitchinterval(0.0005)  # the loop must not wait for the other threads
    gc.collect()
    gc.freeze()
    gc.disable()
    _say("ready")
    loop.run()
    with suppress(RuntimeError):
        link.close()
    return 0


def _say(text: str) -> None:
    with suppress(OSError):  # a node that died shows on standard input
        os.write(1, text.encode() + b"\n")


def _six(values: list[float]) -> Six:
    a, b, c, d, e, f = values
    return a, b, c, d, e, f


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # ur-rtde's threads of a lost connection must not hold the process up
