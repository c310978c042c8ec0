"""The node's end of the arm's driver: starts the process, hands over set-points, reads the arm."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections import deque
from contextlib import suppress

from cell.child import end_child
from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import BackendError
from cell.frames import Array
from hil.ur3e.block import Measured, Measurements, Order, Orders, Six, shared_memory

_START = 20.0
_END = 4.0
"""How long the driver may take to connect, and to brake and end [s]."""
_NEWS_KEPT = 50


class Driver:
    """The driver's process; one of these per start.

    Args:
        clock: the node's; the driver's times are its.
    """

    def __init__(self, config: CellConfig, robot_ip: str, clock: WallClock) -> None:
        self._config, self._robot_ip, self._clock = config, robot_ip, clock
        self._process: subprocess.Popen[bytes] | None = None
        self._news: deque[str] = deque(maxlen=_NEWS_KEPT)
        self._answered = threading.Event()
        self._ready = False
        self._order = Order()
        self._orders: Orders | None = None
        self._measurements: Measurements | None = None

    def start(self) -> None:
        """Start the process and wait until it is connected to the robot.

        Raises:
            BackendError: with the driver's own words.
        """
        descriptor, memory = shared_memory()
        self._orders, self._measurements = Orders(memory), Measurements(memory)
        ur3e = self._config.ur3e
        settings = {
            "robot_ip": self._robot_ip,
            "memory": descriptor,
            "offset": self._clock.offset,
            "lookahead": ur3e.lookahead,
            "gain": ur3e.gain,
            "patience": ur3e.patience,
            "stop_deceleration": ur3e.stop_deceleration,
            "payload": ur3e.payload,
            "payload_cog": ur3e.payload_cog,
            "tcp": (0.0, 0.0, self._config.gripper.length, 0.0, 0.0, 0.0),
        }
        try:
            process = self._process = subprocess.Popen(
                [sys.executable, "-m", "hil.ur3e.driver_process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,  # ur-rtde talks a lot
                pass_fds=(descriptor,),
            )
        finally:
            os.close(descriptor)
        threading.Thread(target=self._listen, args=(process,), name="driver", daemon=True).start()
        assert process.stdin is not None
        with suppress(BrokenPipeError):
            process.stdin.write(json.dumps(settings).encode() + b"\n")
            process.stdin.flush()
        if not self._answered.wait(_START) or not self._ready:
            self.close()
            words = [text for text in self.news() if text]
            raise BackendError(words[-1] if words else f"the arm's driver did not start within {_START:g} s")
        while self.measured() is None:
            if process.poll() is not None:
                raise BackendError("the arm's driver ended at once")
            self._clock.sleep_until(self._clock.now() + 0.002)

    @property
    def pid(self) -> int:
        """Process id, 0 before `start`."""
        return 0 if self._process is None else self._process.pid

    def alive(self) -> bool:
        """The process runs."""
        return self._process is not None and self._process.poll() is None

    def arm(self, epoch: int) -> None:
        """Get ready to follow set-points of `epoch`; 0: let go of the arm."""
        self._write(Order(epoch, 0, self._order.lamp))

    def follow(self, epoch: int, t: float, q: Array, qd: Array) -> None:
        """Set-point q [rad], qd [rad/s], shape (6,), to be reached at `t` [s]."""
        self._write(Order(self._order.arm, epoch, self._order.lamp, t, _six(q), _six(qd)))

    def lamp(self, bits: int) -> None:
        """Standard digital outputs 0..2, as bits."""
        o = self._order
        self._write(Order(o.arm, o.follow, bits, o.t, o.q, o.qd))

    def measured(self) -> Measured | None:
        """The newest state; None before the first."""
        return None if self._measurements is None else self._measurements.read()

    def news(self) -> list[str]:
        """What the driver said since the last call."""
        out = []
        while self._news:
            out.append(self._news.popleft())
        return out

    def close(self) -> None:
        """Brake, end the control program and the process."""
        if self._process is not None:
            end_child(self._process, _END)

    def _write(self, order: Order) -> None:
        self._order = order
        if self._orders is not None:
            self._orders.write(order)

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            text = line.decode("utf-8", "replace").strip()
            if text == "ready":
                self._ready = True
                self._answered.set()
            else:
                self._news.append(text)
        self._answered.set()


def _six(values: Array) -> Six:
    a, b, c, d, e, f = values.tolist()
    return a, b, c, d, e, f
