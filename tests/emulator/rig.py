"""A served controller in this process, on free ports, and clients without a library."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from cell.clock import WallClock
from hil.emulator.controller import Controller
from hil.emulator.emulator import FREE_PORTS, Emulator
from hil.emulator.interfaces import RobotMode
from hil.emulator.models import UR3E
from tests.emulator.ideal import QUICK, IdealMover, IdealPlant, recognise

LATEST = 10.0
"""Patience on a loaded machine [s]."""


@contextmanager
def running(**more: Any) -> Iterator[Emulator]:
    """On, with its brakes released."""
    options: dict[str, Any] = {
        "durations": QUICK, "power_up": True, "ports": FREE_PORTS, "recognise": recognise, **more
    }  # fmt: skip
    plant = IdealPlant()
    emulator = Emulator("127.0.0.1", UR3E, plant, mover=IdealMover(), **options)
    emulator.start()
    try:
        if options["power_up"]:
            until(emulator, lambda c: c.robot_mode is RobotMode.RUNNING)
        yield emulator
    finally:
        emulator.stop()
        assert not emulator.failure and plant.closed


def until(emulator: Emulator, condition: Callable[[Controller], bool]) -> None:
    """Wait until something is true of the controller."""
    eventually(lambda: emulator.do(condition))


def eventually(condition: Callable[[], bool]) -> None:
    """Wait until something is true."""
    clock = WallClock()
    end = clock.now() + LATEST
    while not condition():
        assert clock.now() < end, "it did not happen"
        clock.sleep_until(clock.now() + 0.002)


class Lines:
    """A client of the dashboard."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), LATEST)
        self._file = self.socket.makefile("rb")
        self.banner = self.line()

    def line(self) -> str:
        return self._file.readline().decode().rstrip("\n")

    def ask(self, command: str) -> str:
        self.socket.sendall(command.encode() + b"\n")
        return self.line()

    def close(self) -> None:
        self._file.close()
        self.socket.close()


def take(sock: socket.socket, size: int) -> bytes:
    """Exactly so many bytes."""
    data = b""
    while len(data) < size:
        part = sock.recv(size - len(data))
        assert part, "the connection was closed"
        data += part
    return data
