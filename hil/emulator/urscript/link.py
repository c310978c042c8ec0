"""A program's own connection to a host: connects and reads without ever waiting."""

from __future__ import annotations

import errno
import select
import socket
import struct
from contextlib import suppress
from ipaddress import IPv4Address

from cell.errors import BackendError

_MAX_BUFFER = 1 << 20
_CHUNK = 65536
_UNDER_WAY = (0, errno.EINPROGRESS, errno.EALREADY, errno.EISCONN)


class Link:
    """A TCP client for big-endian 32-bit integers, or text.

    Args:
        name: for messages. host: an IPv4 address or "localhost".

    Attributes:
        connected: both ends are there. lost: they were.

    Raises:
        BackendError: the host is no address.
    """

    def __init__(self, name: str, host: str, port: int) -> None:
        try:
            address = "127.0.0.1" if host == "localhost" else str(IPv4Address(host))
        except ValueError:
            raise BackendError(f"{name}: the host must be an IPv4 address, got {host[:60]!r}") from None
        if not 0 < port < 65536:
            raise BackendError(f"{name}: the port must be 1..65535, got {port}")
        self.name, self._to = name, (address, port)
        self._sock: socket.socket | None = None
        self._buffer = bytearray()
        self.connected = self.lost = False

    def connect(self) -> bool | None:
        """Get on with connecting: True when it is, False when it failed, None while it takes time."""
        if self.connected:
            return True
        if self._sock is None:
            self._sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._sock.setblocking(False)
            with suppress(OSError):
                self._sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if self._sock.connect_ex(self._to) not in _UNDER_WAY:
                self.close()
                return False
        if not select.select([], [self._sock], [], 0)[1]:
            return None
        if self._sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self.close()
            return False
        self.connected, self.lost = True, False
        return True

    def integers(self, count: int) -> tuple[int, ...] | None:
        """A whole message of so many, if it is there."""
        size = 4 * count
        if len(self._buffer) < size:
            self._receive()
            if len(self._buffer) < size:
                return None
        message: tuple[int, ...] = struct.unpack_from(f">{count}i", self._buffer)
        del self._buffer[:size]
        return message

    def text(self) -> str:
        """All that has come so far; it stays."""
        self._receive()
        return self._buffer.decode(errors="replace")

    def send(self, data: bytes) -> None:
        """Send; what does not fit into the socket's buffer is lost with the connection."""
        if self._sock is None or not self.connected:
            return
        try:
            whole = self._sock.send(data) == len(data)
        except OSError:
            whole = False
        if not whole:
            self._drop()

    def send_integer(self, value: int) -> None:
        """As `socket_send_int`."""
        self.send(struct.pack(">i", value))

    def close(self) -> None:
        """Harmless when repeated."""
        if self._sock is not None:
            self._sock.close()
        self._sock = None
        self.connected = False
        self._buffer.clear()

    def _receive(self) -> None:
        while self._sock is not None and self.connected and len(self._buffer) < _MAX_BUFFER:
            try:
                data = self._sock.recv(_CHUNK)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                data = b""
            if not data:
                self._drop()
                return
            self._buffer += data
            if len(data) < _CHUNK:
                return

    def _drop(self) -> None:
        """What came before stays readable."""
        kept = bytes(self._buffer)
        self.close()
        self._buffer += kept
        self.lost = True
