"""The loop of the emulated controller: its 500 Hz cycle and all its sockets, on one thread.

One thread needs no locks, and nothing but the machine can hold up the cycle: sockets never block.
The schedule is absolute; missed cycles are skipped, never made up for, because a client that finds
two packets at once throws one away.
"""

from __future__ import annotations

import logging
import math
import queue
import select
import socket
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import TypeVar

from cell.clock import Clock
from cell.errors import BackendError
from hil.emulator.interfaces_faults import Faults, Server
from hil.emulator.servers.connection import Connection, Speaker

_log = logging.getLogger("hil.emulator")
_T = TypeVar("_T")
_BACKLOG = 16
_MAX_CLIENTS = 32
"""Of one server; more are turned away."""

Welcome = Callable[[Connection], Speaker]
"""Makes the speaker of a new connection."""


class _Listener:
    def __init__(self, server: Server, sock: socket.socket, welcome: Welcome, patience: float | None) -> None:
        self.server, self.sock, self.welcome, self.patience = server, sock, welcome, patience
        self.clients: set[int] = set()


class Loop:
    """Runs `cycle` every `period` and serves sockets in between.

    Args:
        cycle: one cycle of the controller; returns the time since its start [s], for the faults.
        period: [s].

    Attributes:
        cycles, skipped: how many were run, and left out because the machine was late.
        busy: time the last cycle took, with sending [s].
    """

    def __init__(self, cycle: Callable[[], float], period: float, clock: Clock, faults: Faults) -> None:
        self._cycle, self._period, self._clock, self._faults = cycle, period, clock, faults
        self._epoll = select.epoll()
        self._wake_in, self._wake_out = socket.socketpair()
        self._wake_in.setblocking(False)
        self._epoll.register(self._wake_in.fileno(), select.EPOLLIN)
        self._listeners: dict[int, _Listener] = {}
        self._connections: dict[int, tuple[_Listener, Connection]] = {}
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._ended = False
        self.cycles = self.skipped = 0
        self.busy = 0.0

    def listen(
        self, server: Server, address: tuple[str, int], welcome: Welcome, patience: float | None = None
    ) -> int:
        """Serve this address from now on; returns the port (0 asks for a free one).

        Raises:
            BackendError: it cannot be had.
        """
        sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.bind(address)
            sock.listen(_BACKLOG)
        except OSError as error:
            sock.close()
            raise BackendError(
                f"cannot serve {server} on {address[0]}:{address[1]}: {error.strerror}; "
                "another controller may be running there, choose another address"
            ) from error
        sock.setblocking(False)
        self._listeners[sock.fileno()] = _Listener(server, sock, welcome, patience)
        self._epoll.register(sock.fileno(), select.EPOLLIN)
        return int(sock.getsockname()[1])

    def clients(self, server: Server) -> int:
        """How many are connected to it."""
        return sum(len(each.clients) for each in self._listeners.values() if each.server is server)

    def call(self, function: Callable[[], _T]) -> Future[_T]:
        """Run a function on the loop's thread; callable from any other."""
        answer: Future[_T] = Future()

        def run() -> None:
            try:
                answer.set_result(function())
            except BaseException as error:
                answer.set_exception(error)

        self._calls.put(run)
        self._wake()
        return answer

    def end(self) -> None:
        """Let `run` return; callable from anywhere."""
        self._ended = True
        self._wake()

    def run(self) -> None:
        """Until `end`, or until a cycle raises. All sockets are closed then."""
        try:
            due = self._clock.now() + self._period
            while not self._ended:
                wait = due - self._clock.now()
                self._serve(max(0.0, wait))
                start = self._clock.now()
                if start < due:
                    continue
                self._after_cycle(self._cycle())
                done = self._clock.now()
                self.busy, self.cycles = done - start, self.cycles + 1
                due = self._next(due, start, done)
        finally:
            self._close()

    # -- internals --------------------------------------------------------------------------------

    def _next(self, due: float, start: float, done: float) -> float:
        """The first point of the schedule that lies half a period behind this cycle's start."""
        due += self._period
        gap = max(start + 0.5 * self._period, done) - due
        if gap > 0.0:
            left_out = math.ceil(gap / self._period)
            self.skipped += left_out
            due += left_out * self._period
        return due

    def _serve(self, wait: float) -> None:
        """Wait for the sockets, at most until the next cycle. `epoll` alone would round to 1 ms."""
        ready, _, _ = select.select([self._epoll], [], [], wait)
        if not ready:
            return
        for fd, _ in self._epoll.poll(0):
            if fd in self._connections:
                listener, connection = self._connections[fd]
                self._guarded(connection, connection.receive)
                if not connection.open:
                    self._remove(fd, listener, connection)
            elif fd in self._listeners:
                self._accept(self._listeners[fd])
            else:
                self._take_calls()

    def _take_calls(self) -> None:
        with suppress(BlockingIOError):
            self._wake_in.recv(4096)
        for _ in range(self._calls.qsize()):
            self._calls.get()()

    def _wake(self) -> None:
        with suppress(OSError):
            self._wake_out.send(b"x")

    def _accept(self, listener: _Listener) -> None:
        try:
            sock, (host, port, *_) = listener.sock.accept()
        except OSError:
            return
        peer = f"{host}:{port}"
        if len(listener.clients) >= _MAX_CLIENTS or self._faults.refuse(listener.server, peer):
            sock.close()
            return
        link = self._faults.link(listener.server, peer)
        connection = Connection(sock, peer, self._clock, link, listener.patience)
        fd = sock.fileno()
        listener.clients.add(fd)
        self._connections[fd] = (listener, connection)
        self._epoll.register(fd, select.EPOLLIN)
        _log.info("%s: %s connected", listener.server, peer)
        self._guarded(connection, lambda: connection.speak(listener.welcome(connection)))

    def _after_cycle(self, now: float) -> None:
        for fd, (listener, connection) in list(self._connections.items()):
            self._guarded(connection, partial(connection.cycle, now))
            if not connection.open:
                self._remove(fd, listener, connection)

    def _guarded(self, connection: Connection, work: Callable[[], None]) -> None:
        """No client may end the loop."""
        try:
            work()
        except Exception as error:
            _log.exception("connection of %s failed", connection.peer)
            connection.close(f"{type(error).__name__}: {error}")

    def _remove(self, fd: int, listener: _Listener, connection: Connection) -> None:
        _log.info("%s: %s gone: %s", listener.server, connection.peer, connection.why_closed)
        self._epoll.unregister(fd)
        listener.clients.discard(fd)
        del self._connections[fd]
        connection.finish()

    def _close(self) -> None:
        for fd, (listener, connection) in list(self._connections.items()):
            connection.close("the controller ends")
            self._remove(fd, listener, connection)
        for listener in self._listeners.values():
            listener.sock.close()
        while not self._calls.empty():
            self._calls.get()()
        self._epoll.close()
        self._wake_in.close()
        self._wake_out.close()
