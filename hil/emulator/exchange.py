"""What the plant and the process with the surroundings tell each other, over a pair of sockets.

The plant reports where everything is; the surroundings answer with what the person's hand holds and
with new batches of onions. Nothing ever waits: what does not fit into the socket's buffer is dropped,
and the next report says it all again. Only the two processes of one emulator speak this.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from cell.errors import DecodeError
from cell.wire.vocabulary import SIGNALS

MAX_ONIONS = 100
_MAX_BYTES = 65536
_MAX_LINE = 400

Pose7 = tuple[float, ...]
"""Position [m] and quaternion (x, y, z, w) in the world: seven numbers."""


@dataclass(frozen=True)
class Snapshot:
    """Where everything is.

    Attributes:
        t: wall clock of this moment [s].
        batch: number of the batch that lies there, from 1.
        signal: what the lamp shows, one of `SIGNALS`.
        holding: the gripper is stopped on an object.
        contacts: control periods in which the robot touched a fixed part.
        q: joint angles (6,) [rad]. fingers: positions of the two finger joints [m].
        onions: pose of each.
    """

    t: float
    batch: int
    signal: str
    holding: bool
    contacts: int
    q: tuple[float, ...]
    fingers: tuple[float, float]
    onions: tuple[Pose7, ...]


@dataclass(frozen=True)
class Hand:
    """What the person holds.

    Attributes:
        t: wall clock [s]. batch: of the onion. onion: its number, -1: nothing.
        pose: of the onion. velocity: of the hand (3,) [m/s].
    """

    t: float
    batch: int
    onion: int
    pose: Pose7
    velocity: tuple[float, ...]


@dataclass(frozen=True)
class Ball:
    """An onion as the physics sees it: mass [kg], radius [m], and where it lies."""

    mass: float
    radius: float
    pose: Pose7


@dataclass(frozen=True)
class Batch:
    """A new batch, which replaces the old one. number: from 1."""

    number: int
    balls: tuple[Ball, ...]


@dataclass(frozen=True)
class Touch:
    """The robot touches a fixed part of the cell: a line for the log."""

    text: str


Message = Snapshot | Hand | Batch | Touch

_SNAPSHOT = struct.Struct("<dIBBIB8d")
_HAND = struct.Struct("<dIi10d")
_BATCH = struct.Struct("<IB")
_POSE = struct.Struct("<7d")
_BALL = struct.Struct("<9d")


def encode(message: Message) -> bytes:
    """One datagram."""
    if isinstance(message, Snapshot):
        m = message
        head = _SNAPSHOT.pack(
            m.t, m.batch, SIGNALS.index(m.signal), m.holding, m.contacts, len(m.onions), *m.q, *m.fingers
        )
        return b"S" + head + b"".join(_POSE.pack(*pose) for pose in m.onions)
    if isinstance(message, Hand):
        return b"H" + _HAND.pack(
            message.t, message.batch, message.onion, *message.pose, *message.velocity
        )  # fmt: skip
    if isinstance(message, Batch):
        balls = b"".join(_BALL.pack(b.mass, b.radius, *b.pose) for b in message.balls)
        return b"B" + _BATCH.pack(message.number, len(message.balls)) + balls
    return b"T" + message.text.encode()[:_MAX_LINE]


def decode(data: bytes) -> Message:
    """The message of a datagram; raises `DecodeError`."""
    kind, body = data[:1], data[1:]
    try:
        if kind == b"S":
            return _snapshot(body)
        if kind == b"H":
            t, batch, onion, *rest = _HAND.unpack(body)
            return Hand(t, batch, onion, tuple(rest[:7]), tuple(rest[7:]))
        if kind == b"B":
            number, count = _BATCH.unpack_from(body)
            values = _items(_BALL, body[_BATCH.size :], count)
            return Batch(number, tuple(Ball(mass, radius, tuple(p)) for mass, radius, *p in values))
        if kind == b"T":
            return Touch(body.decode(errors="replace"))
    except (struct.error, IndexError) as error:
        raise DecodeError(f"message {kind!r} of {len(data)} bytes: {error}") from None
    raise DecodeError(f"message of an unknown kind {kind!r}")


def _snapshot(body: bytes) -> Snapshot:
    t, batch, signal, holding, contacts, count, *rest = _SNAPSHOT.unpack_from(body)
    onions = _items(_POSE, body[_SNAPSHOT.size :], count)
    fingers = (rest[6], rest[7])
    return Snapshot(t, batch, SIGNALS[signal], bool(holding), contacts, tuple(rest[:6]), fingers, onions)


def _items(layout: struct.Struct, body: bytes, count: int) -> tuple[tuple[float, ...], ...]:
    if count > MAX_ONIONS or len(body) != count * layout.size:
        raise DecodeError(f"{count} onions do not fit {len(body)} bytes")
    return tuple(layout.iter_unpack(body))


class Exchange:
    """One end of the pair.

    Args:
        sock: of a `socket.socketpair` with `SOCK_SEQPACKET`.

    Attributes:
        open: the other end is there. dropped: messages that did not fit.
    """

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        self._sock = sock
        self.open = True
        self.dropped = 0

    @staticmethod
    def pair() -> tuple[socket.socket, socket.socket]:
        """Two sockets for two ends."""
        return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def fileno(self) -> int:
        """For `select`."""
        return self._sock.fileno()

    def send(self, message: Message) -> bool:
        """Send if there is room; True when it was."""
        if not self.open:
            return False
        try:
            self._sock.send(encode(message))
        except BlockingIOError:
            self.dropped += 1
            return False
        except OSError:
            self.open = False
            return False
        return True

    def receive(self, most: int = 64) -> Sequence[Message]:
        """What has arrived, oldest first, at most so many."""
        out: list[Message] = []
        while self.open and len(out) < most:
            try:
                data = self._sock.recv(_MAX_BYTES)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self.open = False
                break
            out.append(decode(data))
        return out

    def close(self) -> None:
        """Harmless when repeated."""
        self.open = False
        with suppress(OSError):
            self._sock.close()
