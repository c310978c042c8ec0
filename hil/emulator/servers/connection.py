"""One client's connection: never waited for, bounded, and disturbed where faults ask for it."""

from __future__ import annotations

import socket
from collections import deque
from typing import Protocol

from cell.clock import Clock
from cell.errors import DecodeError
from hil.emulator.interfaces_faults import Delivery, LinkFaults

_CHUNK = 65_536
_MAX_UNSENT = 65_536
"""Bytes that wait for a slow reader in here; the kernel holds some more."""
_MAX_DELAYED = 4_096
"""Messages held back by faults."""
_KERNEL_BUFFER = 65_536
_QUICKACK = getattr(socket, "TCP_QUICKACK", None)


class Speaker(Protocol):
    """The protocol spoken on one connection."""

    def split(self, buffer: bytearray, quiet: float) -> list[bytes]:
        """Take whole messages off the front of what has come in.

        Args:
            quiet: time since the last byte came [s].

        Raises:
            DecodeError: this is no stream of the protocol; the connection is dropped.
        """
        ...

    def message(self, message: bytes) -> None:
        """Act on a message.

        Raises:
            DecodeError: it is malformed; the connection is dropped.
        """
        ...

    def cycle(self) -> None:
        """After each cycle of the controller."""
        ...

    def closed(self) -> None:
        """The connection is gone."""
        ...


class Connection:
    """A socket with its speaker.

    Nagle's algorithm is off, and delayed acknowledgement again after each receive: some clients
    lose TCP_NODELAY when they reconnect and would wait 40 ms for our acknowledgement.

    Args:
        patience: drop a client that has not read for this long [s]; None: never, only skip
            messages it has no room for.
    """

    def __init__(
        self, sock: socket.socket, peer: str, clock: Clock, faults: LinkFaults | None, patience: float | None
    ) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BUFFER)
        self.sock, self.peer = sock, peer
        self.why_closed = ""
        self._clock, self._faults, self._patience = clock, faults, patience
        self._speaker: Speaker | None = None
        self._incoming, self._unsent = bytearray(), bytearray()
        self._heard = self._moved = clock.now()
        self._late_in: deque[tuple[float, bytes]] = deque()
        self._late_out: deque[tuple[float, bytes]] = deque()
        self._now = 0.0
        self._quickack()

    def speak(self, speaker: Speaker) -> None:
        """Hand over what comes in to this speaker from now on."""
        self._speaker = speaker

    @property
    def open(self) -> bool:
        return not self.why_closed

    @property
    def room(self) -> bool:
        """Nothing waits for the client to read."""
        return not self._unsent

    def close(self, why: str) -> None:
        """Close after a last attempt to send what waits; the first reason stands."""
        if self.open:
            self._flush()
            self._drop(why)

    def finish(self) -> None:
        """Free the socket. The speaker is told."""
        self.sock.close()
        if self._speaker is not None:
            self._speaker.closed()

    # -- to the client ----------------------------------------------------------------------------

    def send(self, message: bytes) -> None:
        """Send a whole message, or none of it if the client leaves no room for it."""
        if self._faults is None:
            self._write(message)
            return
        for delivery in self._faults.outgoing(message, self._now):
            if not _hold(self._late_out, delivery, self._clock.now()):
                self._write(delivery.data)

    def _write(self, data: bytes) -> None:
        if not self.open:
            return
        if self._unsent:
            if len(self._unsent) + len(data) <= _MAX_UNSENT:
                self._unsent += data
            return
        try:
            sent = self.sock.send(data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._drop(f"sending failed: {error}")
            return
        if sent < len(data):
            self._unsent += data[sent:]
            self._moved = self._clock.now()

    def _flush(self) -> None:
        try:
            sent = self.sock.send(self._unsent) if self._unsent else 0
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(f"sending failed: {error}")
            return
        if sent:
            del self._unsent[:sent]
            self._moved = self._clock.now()

    # -- from the client --------------------------------------------------------------------------

    def receive(self) -> None:
        """There is something to read."""
        try:
            data = self.sock.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(f"receiving failed: {error}")
            return
        if not data:
            self._drop("the client closed it")
            return
        self._quickack()
        self._heard = self._clock.now()
        self._incoming += data
        self._hear(0.0)

    def _hear(self, quiet: float) -> None:
        if self._speaker is None:
            return
        try:
            for message in self._speaker.split(self._incoming, quiet):
                if self._faults is None:
                    self._speaker.message(message)
                    continue
                for delivery in self._faults.incoming(message, self._now):
                    if not _hold(self._late_in, delivery, self._clock.now()):
                        self._speaker.message(delivery.data)
        except DecodeError as error:
            self._drop(str(error))

    def _quickack(self) -> None:
        if _QUICKACK is not None:
            self.sock.setsockopt(socket.IPPROTO_TCP, _QUICKACK, 1)

    # -- every cycle ------------------------------------------------------------------------------

    def cycle(self, now: float) -> None:
        """Deliver what faults held back, let the speaker speak, mind the slow reader.

        Args:
            now: time since the controller's start [s], for the faults.
        """
        self._now = now
        if self._faults is not None:
            if self._faults.cut(now):
                self._drop("cut on purpose")
                return
            self._release()
        if self._incoming:
            self._hear(self._clock.now() - self._heard)
        if self._speaker is not None and self.open:
            self._speaker.cycle()
        if self._unsent and self.open:
            self._flush()
            stalled = self._clock.now() - self._moved
            if self._unsent and self._patience is not None and stalled > self._patience:
                self._drop(f"the client has not read for {stalled:.0f} s")

    def _release(self) -> None:
        now = self._clock.now()
        while self._late_in and self._late_in[0][0] <= now and self._speaker is not None:
            try:
                self._speaker.message(self._late_in.popleft()[1])
            except DecodeError as error:
                self._drop(str(error))
                return
        while self._late_out and self._late_out[0][0] <= now:
            self._write(self._late_out.popleft()[1])

    def _drop(self, why: str) -> None:
        self.why_closed = self.why_closed or why


def _hold(late: deque[tuple[float, bytes]], delivery: Delivery, now: float) -> bool:
    """Keep a delivery for later; False when it may go at once. What would be too much is lost."""
    due = now + delivery.delay
    if not late and delivery.delay <= 0.0:
        return False
    if len(late) < _MAX_DELAYED:
        late.append((max(due, late[-1][0]) if late else due, delivery.data))
    return True
