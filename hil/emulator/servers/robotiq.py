"""The gripper's socket (port 63352), as Robotiq's URCap opens it on the controller.

ASCII lines. "GET VAR" is answered "VAR n" with a newline, "SET VAR n [VAR n ...]" by the three bytes
"ack" without one: clients compare for equality. What cannot be understood is answered "?".
"""

from __future__ import annotations

import threading

from cell.clock import Clock, WallClock
from cell.errors import DecodeError
from hil.emulator.interfaces import GripperPlant
from hil.emulator.interfaces_faults import Faults, NoFaults, Server
from hil.emulator.robotiq import ALIASES, READABLE, WRITABLE, Robotiq
from hil.emulator.servers.connection import Connection
from hil.emulator.servers.server import Loop
from hil.real_time import ask_for_real_time

PORT = 63352
_PERIOD = 0.01
_PRIORITY = 1
_MAX_LINE = 1024
_JOIN_TIME = 2.0


class RobotiqServer:
    """Serves one gripper to any number of clients, on a thread of its own.

    Args:
        listen: IPv4 address. plant: the fingers. port: 0 asks for a free one.

    Attributes:
        port: as served; known after `start`.
    """

    def __init__(
        self,
        listen: str,
        plant: GripperPlant,
        faults: Faults | None = None,
        *,
        port: int = PORT,
        clock: Clock | None = None,
    ) -> None:
        self._listen, self.port = listen, port
        self._faults: Faults = faults or NoFaults()
        self._clock: Clock = clock or WallClock()
        self._gripper = Robotiq(plant)
        self._born = self._clock.now()
        self._loop: Loop | None = None
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Serve from now on; raises `BackendError` when the port cannot be had."""
        loop = Loop(self._cycle, _PERIOD, self._clock, self._faults)
        self.port = loop.listen(
            Server.GRIPPER, (self._listen, self.port), lambda connection: _Speaker(connection, self._gripper)
        )
        self._loop = loop
        self._thread = threading.Thread(target=_run, args=(loop,), name="gripper server", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Close all connections; harmless when repeated."""
        if self._loop is not None:
            self._loop.end()
        if self._thread is not None:
            self._thread.join(_JOIN_TIME)
        self._loop = self._thread = None

    def _cycle(self) -> float:
        now = self._clock.now() - self._born
        self._gripper.tick(now)
        return now


def _run(loop: Loop) -> None:
    # Without a processor while it has the interpreter's lock, this thread would hold up the controller's.
    ask_for_real_time(_PRIORITY)
    loop.run()


class _Speaker:
    """One client."""

    def __init__(self, connection: Connection, gripper: Robotiq) -> None:
        self._connection, self._gripper = connection, gripper

    def split(self, buffer: bytearray, quiet: float) -> list[bytes]:
        del quiet
        *lines, rest = bytes(buffer).split(b"\n")
        if len(rest) > _MAX_LINE or any(len(line) > _MAX_LINE for line in lines):
            raise DecodeError(f"a line of more than {_MAX_LINE} bytes")
        buffer[:] = rest
        return [line + b"\n" for line in lines]

    def message(self, message: bytes) -> None:
        words = message.decode("ascii", errors="replace").split()
        if words:
            self._connection.send(self._answer(words))

    def cycle(self) -> None:
        pass

    def closed(self) -> None:
        pass

    def _answer(self, words: list[str]) -> bytes:
        command, *rest = words
        if command == "GET" and len(rest) == 1:
            name = ALIASES.get(rest[0], rest[0])
            if name in READABLE:
                value = self._gripper.read(name)
                text = f"{value:02d}" if name == "FLT" else str(value)  # faults come as two digits
                return f"{rest[0]} {text}\n".encode()
        if command == "SET":
            values = _values(rest)
            if values:
                self._gripper.write(values)
                return b"ack"
        return b"?\n"


def _values(words: list[str]) -> dict[str, int]:
    """Pairs of a name and a number 0..255; empty when anything is wrong with them."""
    names = [ALIASES.get(name, name) for name in words[::2]]
    texts = words[1::2]
    if len(names) != len(texts) or not all(name in WRITABLE for name in names):
        return {}
    if not all(text.isascii() and text.isdigit() and len(text) <= 3 and int(text) <= 255 for text in texts):
        return {}
    return {name: int(text) for name, text in zip(names, texts, strict=True)}
