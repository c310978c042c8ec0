"""The Robotiq 2F-85 behind its URCap: a text socket on the controller, port 63352.

"GET VAR" is answered by "VAR n", "SET VAR n ..." by "ack". One thread talks to it, so that a slow
answer holds up nobody; it takes the newest command and reads the fingers some thirty times a second.
When the connection is lost the thread connects again, but forgets the command it had: fingers move
only on a fresh one.
"""

from __future__ import annotations

import re
import socket
import threading
from collections import deque
from contextlib import suppress

import numpy as np

from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import BackendError
from cell.wire.types import GripperState

_TIMEOUT = 1.0
_POLL = 0.03
_RECONNECT = 1.0
_ACTIVATION = 10.0
_ACTIVE = 3
_ANSWER = re.compile(rb"([A-Z]{3}) (-?\d+)")


class Wire:
    """The socket and its two requests.

    Raises:
        BackendError: it cannot be reached, or does not answer as it should.
    """

    def __init__(self, host: str, port: int) -> None:
        self._where = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), _TIMEOUT)
            self._socket.settimeout(_TIMEOUT)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise BackendError(
                f"no gripper answers at {self._where} ({error.strerror or error}); is the Robotiq URCap "
                "installed and the gripper connected?"
            ) from None

    def get(self, variable: str) -> int:
        """Value of a variable."""
        answer = self._exchange(f"GET {variable}\n")
        found = _ANSWER.match(answer)
        if found is None or found[1].decode() != variable:
            raise BackendError(f"gripper at {self._where}: asked for {variable}, got {answer[:40]!r}")
        return int(found[2])

    def set(self, **values: int) -> None:
        """Set variables in the order given."""
        words = " ".join(f"{name} {value}" for name, value in values.items())
        answer = self._exchange(f"SET {words}\n")
        if answer.strip() != b"ack":
            raise BackendError(f"gripper at {self._where}: {words} was answered by {answer[:40]!r}")

    def _exchange(self, request: str) -> bytes:
        try:
            self._socket.sendall(request.encode("ascii"))
            answer = self._socket.recv(1024)
        except OSError as error:
            raise BackendError(f"gripper at {self._where}: {error.strerror or error}") from None
        if not answer:
            raise BackendError(f"gripper at {self._where}: the connection was closed")
        return answer

    def close(self) -> None:
        self._socket.close()


class Counts:
    """The device's units, 0..255, and ours.

    Args:
        config: the cell; speed and force ranges are the gripper's, ends of travel the arm's section's.
    """

    def __init__(self, config: CellConfig) -> None:
        self._gripper = config.gripper
        self._open, self._closed = config.ur3e.gripper_counts

    def clip(self, width: float, speed: float, force: float) -> tuple[float, float, float]:
        """What the device can do of it: [m], [m/s], [N]."""
        g = self._gripper
        return (
            float(np.clip(width, 0.0, g.stroke)),
            float(np.clip(speed, g.min_speed, g.max_speed)),
            float(np.clip(force, g.min_force, g.max_force)),
        )

    def position(self, width: float) -> int:
        share = 1.0 - width / self._gripper.stroke
        return int(np.clip(round(self._open + (self._closed - self._open) * share), 0, 255))

    def width(self, position: int) -> float:
        """[m]"""
        share = (position - self._open) / (self._closed - self._open)
        return float(np.clip((1.0 - share) * self._gripper.stroke, 0.0, self._gripper.stroke))

    def speed(self, speed: float) -> int:
        g = self._gripper
        return round(255 * (speed - g.min_speed) / max(g.max_speed - g.min_speed, 1e-9))

    def force(self, force: float) -> int:
        g = self._gripper
        return round(255 * (force - g.min_force) / max(g.max_force - g.min_force, 1e-9))


class Gripper:
    """The gripper as a backend uses it: `command` and `state` never wait.

    Args:
        host: of the controller. clock: of the node.
    """

    def __init__(self, config: CellConfig, host: str, clock: WallClock) -> None:
        self._host, self._port, self._clock = host, config.ur3e.gripper_port, clock
        self._counts = Counts(config)
        self._wire: Wire | None = None
        self._lock = threading.Lock()
        self._wanted: tuple[float, float, float] | None = None
        self._state: GripperState | None = None
        self._target = config.gripper.stroke
        self._echo: int | None = None
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._news: deque[str] = deque(maxlen=20)

    def connect(self) -> None:
        """Open the connection and activate the gripper, which moves its fingers, unless it is active.

        Raises:
            BackendError: no gripper, or it cannot be activated.
        """
        if self._thread is not None:
            return
        self._ended.clear()
        self._wire = Wire(self._host, self._port)
        self._activate(self._wire)
        self._target = self._counts.width(self._wire.get("POS"))
        self._read(self._wire)
        self._thread = threading.Thread(target=self._work, name="gripper", daemon=True)
        self._thread.start()

    def command(self, width: float, speed: float, force: float) -> tuple[float, float, float]:
        """Move to a width [m] at [m/s] with at most [N]; returns what is really sent."""
        sent = self._counts.clip(width, speed, force)
        with self._lock:
            self._wanted, self._target = sent, sent[0]
            if self._state is not None:
                s = self._state
                self._state = GripperState(s.t, s.width, sent[0], True, False)
        return sent

    def state(self) -> GripperState:
        """As last read; its time says how old it is. Raises `BackendError` before `connect`."""
        with self._lock:
            if self._state is None:
                raise BackendError("the gripper is not connected; call connect() first")
            return self._state

    def news(self) -> list[str]:
        """What happened to the connection since the last call."""
        out = []
        while self._news:
            out.append(self._news.popleft())
        return out

    def close(self) -> None:
        """End the thread; the fingers stay as they are."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(3.0)
            self._thread = None
        if self._wire is not None:
            self._wire.close()
            self._wire = None
        self._state = None

    # -- the thread -----------------------------------------------------------------------------

    def _work(self) -> None:
        while not self._ended.wait(_POLL):
            try:
                if self._wire is None:
                    wire = Wire(self._host, self._port)
                    self._activate(wire)
                    self._wire = wire
                    self._news.append("gripper: connected again")
                self._exchange(self._wire)
            except BackendError as error:
                if self._wire is not None:
                    self._news.append(f"{error}; trying to connect again")
                    self._wire.close()
                    self._wire = None
                with self._lock:
                    self._wanted = None
                self._ended.wait(_RECONNECT)

    def _exchange(self, wire: Wire) -> None:
        with self._lock:
            wanted, self._wanted = self._wanted, None
        if wanted is not None:
            width, speed, force = wanted
            counts = self._counts
            self._echo = counts.position(width)
            wire.set(POS=self._echo, SPE=counts.speed(speed), FOR=counts.force(force), GTO=1)
        self._read(wire)

    def _read(self, wire: Wire) -> None:
        """Fingers, and whether they met something; not while a command waits to be sent."""
        echo, stopped, position = wire.get("PRE"), wire.get("OBJ"), wire.get("POS")
        with self._lock:
            if self._wanted is not None:
                return
            moving = self._echo is not None and (stopped == 0 or echo != self._echo)
            holding = not moving and stopped in (1, 2)
            self._state = GripperState(
                self._clock.now(), self._counts.width(position), self._target, moving, holding
            )

    def _activate(self, wire: Wire) -> None:
        """Bring it to its active state; raises `BackendError` when it does not get there."""
        if wire.get("STA") == _ACTIVE and wire.get("ACT") == 1:
            return
        wire.set(ACT=0, ATR=0)
        self._wait_for(wire, 0)
        self._clock.sleep_until(self._clock.now() + 0.5)  # the device needs it between the two
        wire.set(ACT=1)
        self._wait_for(wire, _ACTIVE)

    def _wait_for(self, wire: Wire, status: int) -> None:
        end = self._clock.now() + _ACTIVATION
        while (now := wire.get("STA")) != status:
            if self._clock.now() > end:
                fault: object = "?"
                with suppress(BackendError):
                    fault = wire.get("FLT")
                raise BackendError(
                    f"the gripper cannot be activated (status {now}, fault {fault}); look at its cable"
                )
            self._clock.sleep_until(self._clock.now() + 0.05)
