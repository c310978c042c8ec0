"""Stand-ins for a controller: the link under the driver's loop, and line servers byte by byte."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Self

from cell.clock import StepClock
from cell.config import load
from hil.ur3e.arm_link import PERIOD, Packet
from hil.ur3e.block import Measurements, Order, Orders, Six, shared_memory
from hil.ur3e.servo_loop import ServoLoop
from tests.wire_helpers import until

HOME: Six = load().arm.home
ZERO: Six = (0.0,) * 6


class FakeLink:
    """An arm that is at once where it is told to be; see `hil.ur3e.arm_link.ArmLink`.

    Attributes:
        packet: what `read` gives; tests change it. calls: what was asked of it, in order.
        servos: set-points taken. refuse: `servo` says no. broken: everything raises.
        start_problem: what `start` answers.
    """

    def __init__(self) -> None:
        self.packet = Packet(100.0, HOME, ZERO, ZERO, 7, 1, 1, 2, 1.0)
        self.calls: list[str] = []
        self.servos: list[Six] = []
        self.lamp = 0
        self.kicks = 0
        self.refuse = self.broken = False
        self.start_problem = ""

    def read(self) -> Packet:
        if self.broken:
            raise RuntimeError("end of file")
        return self.packet

    def servo(self, q: Six) -> bool:
        if self.broken:
            raise RuntimeError("broken pipe")
        if self.refuse:
            return False
        self.servos.append(q)
        self.packet = replace(self.packet, q=q)
        return True

    def kick(self) -> None:
        self.kicks += 1

    def outputs(self, bits: int, mask: int) -> None:
        self.lamp = bits & mask

    def start(self) -> str:
        self.calls.append("start")
        if not self.start_problem:
            self.packet = replace(self.packet, runtime=2)
        return self.start_problem

    def brake(self) -> None:
        self.calls.append("brake")
        self.packet = replace(self.packet, runtime=1)

    def close(self) -> None:
        self.calls.append("close")


class Bench:
    """A driver's loop on a fake link, moved cycle by cycle in simulated time."""

    def __init__(self) -> None:
        self.link = FakeLink()
        descriptor, memory = shared_memory()
        os.close(descriptor)
        self.orders, self.measurements = Orders(memory), Measurements(memory)
        self.clock = StepClock(PERIOD)
        self.clock.tick = 500
        self.said: list[str] = []
        self.stopped_programs = 0
        self.loop = ServoLoop(
            self.link,
            self.orders,
            self.measurements,
            self.clock,
            patience=0.024,
            q_max=(6.28, 6.28, 3.14, 6.28, 6.28, 6.28),
            qd_max=(3.14, 3.14, 3.14, 6.28, 6.28, 6.28),
            stop_program=self._stop_program,
            say=self.said.append,
        )

    def _stop_program(self) -> None:
        self.stopped_programs += 1

    def cycles(self, count: int = 1, *, packets: bool = True) -> None:
        for _ in range(count):
            self.clock.advance()
            if packets:
                self.link.packet = replace(self.link.packet, stamp=self.link.packet.stamp + PERIOD)
            self.loop.cycle(self.clock.now())

    def arm(self, epoch: int = 1) -> None:
        """Order it armed, and wait for the worker."""
        self.orders.write(Order(arm=epoch))
        self.cycles()
        until(lambda: self.loop._armed == epoch or self.loop._failed == epoch)
        self.cycles()

    def follow(self, q: Six, qd: Six = ZERO, epoch: int = 1, ahead: float = 0.008) -> None:
        self.orders.write(Order(arm=epoch, follow=epoch, t=self.clock.now() + ahead, q=q, qd=qd))

    def drive(self, periods: int, speed: float = 0.0, epoch: int = 1) -> None:
        """Set-points at 125 Hz from where the arm is, all joints at a speed [rad/s]."""
        start = self.link.packet.q
        for k in range(periods):
            step = speed * 0.008 * (k + 1)
            self.follow(tuple(x + step for x in start), (speed,) * 6, epoch)  # type: ignore[arg-type]
            self.cycles(4)


class LineServer:
    """A TCP server that answers requests with bytes.

    Args:
        answer: request (bytes as they came) -> reply; None closes the connection.
        banner: sent to every client first.
    """

    def __init__(self, answer: Callable[[bytes], bytes | None], banner: bytes = b"", port: int = 0) -> None:
        self._answer, self._banner = answer, banner
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port: int = self._listener.getsockname()[1]
        self.requests: list[bytes] = []
        self._clients: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            self._clients.append(client)
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        try:
            client.sendall(self._banner)
            while data := client.recv(1024):
                self.requests.append(data)
                reply = self._answer(data)
                if reply is None:
                    break
                client.sendall(reply)
        except OSError:
            pass
        client.close()

    def cut(self) -> None:
        """Close all connections; new ones are accepted."""
        for client in self._clients:
            client.close()
        self._clients.clear()

    def close(self) -> None:
        self._listener.close()
        self.cut()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
