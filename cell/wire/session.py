"""A process's connection to the cell: publish, read the newest, tap, serve and call.

Zenoh's Python callbacks run on threads that the interpreter waits for when it exits, so a
session left open would hang the process. No callbacks are used here: samples wait in
rings, and the threads that serve queries or feed taps are daemons of our own. Sessions
still open at exit are closed then, because a thread that is inside Zenoh when the
interpreter goes down would abort the process.
"""

from __future__ import annotations

import atexit
import logging
import secrets
import threading
import weakref
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self, TypeVar

import zenoh

from cell.config import CellConfig
from cell.errors import WireError
from cell.wire import codec
from cell.wire.endpoint import ATTACHMENT, BULK, SMALL, first_line, open_client, open_listener
from cell.wire.keys import Keys
from cell.wire.reader import Latest, LatestFrame
from cell.wire.service import Tapped, answerer, pump, ros_type_of, tap
from cell.wire.types import Frame, Image, Reply

__all__ = ["Session", "Tapped"]

M = TypeVar("M")
Q = TypeVar("Q")

_log = logging.getLogger("cell.wire")

#: Samples or queries that wait for a slow reader before the oldest is dropped.
_RING_SMALL, _RING_IMAGES, _RING_TAP, _RING_QUERIES = 256, 8, 2048, 64
_JOIN_S = 1.0


class _Channel:
    """A declared publisher with its counter; the lock keeps numbers and sending in order."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self.publisher = publisher
        self.lock = threading.Lock()
        self.seq = 0


class Session:
    """One end of the wire; make it with `listen` or `connect`.

    Use it as a context manager, or call `close`. Every method may be called from any thread.

    Args:
        patient: `publish` waits for receivers instead of dropping, so that nothing is lost. For
            lock-step, where simulated time can wait; in real time a control loop cannot.

    Attributes:
        keys: the cell's channel names.
    """

    def __init__(self, session: zenoh.Session, config: CellConfig, *, patient: bool = False) -> None:
        self.keys = Keys(config.name)
        self._session = session
        self._congestion = zenoh.CongestionControl.BLOCK if patient else zenoh.CongestionControl.DROP
        self._sender = secrets.randbits(63)
        self._lock = threading.Lock()
        self._closed = False
        self._channels: dict[str, _Channel] = {}
        self._declared: list[zenoh.Subscriber[Any] | zenoh.Queryable[Any]] = []
        self._threads: list[threading.Thread] = []
        _open_sessions.add(self)

    @classmethod
    def listen(cls, config: CellConfig, *, patient: bool = False) -> Session:
        """The node's end, on tcp/127.0.0.1:{config.port}; raises WireError if the port is in use."""
        codec.warm_up()
        return cls(open_listener(config), config, patient=patient)

    @classmethod
    def connect(cls, config: CellConfig, timeout: float = 5.0, *, patient: bool = False) -> Session:
        """Everybody else's end. Reconnects by itself when the node goes and comes back.

        Args:
            timeout: how long to wait for the node [s].

        Raises:
            WireError: nobody listens there.
        """
        codec.warm_up()
        return cls(open_client(config, timeout), config, patient=patient)

    def publish(self, key: str, message: Any) -> None:
        """Send `message` to all who read `key`; `message.t` becomes its source time.

        Unless the session is patient, never waits for a receiver longer than a few milliseconds:
        when a link is congested the message is dropped, and its readers count it as lost.

        Raises:
            WireError: the message cannot be encoded, or the session is closed.
        """
        payload = codec.encode(message)
        if not hasattr(message, "t"):
            raise WireError(
                f"{type(message).__name__} carries no time: it is for queries, not for publishing"
            )
        channel = self._channel(key, type(message))
        t_ns = round(message.t * 1e9)
        try:
            with channel.lock:
                channel.seq += 1
                channel.publisher.put(payload, attachment=ATTACHMENT.pack(channel.seq, t_ns, self._sender))
        except zenoh.ZError as error:
            raise WireError(f"cannot publish on {key}: {first_line(error)}") from None

    def publish_frame(self, frame: Frame) -> None:
        """Send a frame as two images, on the camera's color and depth channels."""
        for what, pixels in (("color", frame.rgb), ("depth", frame.depth)):
            self.publish(self.keys.camera(frame.camera, what), Image(frame.t, frame.camera, pixels))

    def _channel(self, key: str, cls: type[Any]) -> _Channel:
        with self._lock:
            channel = self._channels.get(key)
            if channel is None:
                quality = BULK if cls in (Image, Frame) else SMALL
                encoding = zenoh.Encoding.APPLICATION_CDR.with_schema(codec.ros_type(cls))
                try:
                    publisher = self._open().declare_publisher(
                        key,
                        encoding=encoding,
                        congestion_control=self._congestion,
                        priority=quality.priority,
                        express=quality.express,
                    )
                except zenoh.ZError as error:
                    raise WireError(f"cannot publish on {key}: {first_line(error)}") from None
                channel = self._channels[key] = _Channel(publisher)
            return channel

    def latest(self, key: str, cls: type[M]) -> Latest[M]:
        """Reader of the newest message of class `cls` on `key`."""
        ring = _RING_IMAGES if cls in (Image, Frame) else _RING_SMALL
        return Latest(key, cls, self._subscribe(key, ring))

    def latest_frame(self, camera: str) -> LatestFrame:
        """Reader of the newest frame of a camera."""
        color = self.latest(self.keys.camera(camera, "color"), Image)
        return LatestFrame(color, self.latest(self.keys.camera(camera, "depth"), Image))

    def listen_all(self, key_expr: str, callback: Callable[[Tapped], None]) -> None:
        """Call `callback` for every sample on matching keys, from one thread of this session.

        The callback should only store: while it runs, samples wait in a ring of 2048.
        """
        subscriber = self._subscribe(key_expr, _RING_TAP)
        self._pump(f"tap {key_expr}", subscriber.handler.recv, tap(callback))

    def serve(self, key: str, request_cls: type[Q], handler: Callable[[Q], Any]) -> None:
        """Answer queries on `key` with the message that `handler(request)` returns.

        Handlers of one key run one after the other, on a thread of their own. A request that
        cannot be decoded is answered `Reply(False, "decode", why)`; a RefusedError from the
        handler with its code and reason, any other exception with the code "error".
        """
        try:
            with self._lock:
                queryable = self._open().declare_queryable(key, zenoh.handlers.RingChannel(_RING_QUERIES))
                self._declared.append(queryable)
        except zenoh.ZError as error:
            raise WireError(f"cannot serve {key}: {first_line(error)}") from None

        self._pump(f"serve {key}", queryable.handler.recv, answerer(key, request_cls, handler))

    def call(self, key: str, request: Any, reply_cls: type[M], timeout: float = 2.0) -> M:
        """Query `key` and return the decoded answer.

        Args:
            timeout: how long to wait for it [s].

        Raises:
            WireError: nobody serves the key, no answer in time, or (when `reply_cls` is not
                `Reply`) a refusal; the text then ends in its code and reason.
            DecodeError: the answer is not a valid `reply_cls`.
        """
        try:
            replies = self._open().get(
                key,
                payload=codec.encode(request),
                timeout=timeout,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
                priority=SMALL.priority,
                express=True,
            )
            reply = replies.recv()
        except zenoh.ZError as error:
            if "closed" in str(error) and not self._closed:
                raise WireError(f"nobody answers {key}: is the cell's node running?") from None
            raise WireError(f"cannot call {key}: {first_line(error)}") from None
        if reply.ok is None:
            raise WireError(f"no answer to {key} within {timeout:g} s")
        payload = reply.ok.payload.to_bytes()
        if reply_cls is not Reply and ros_type_of(reply.ok.encoding) == codec.ros_type(Reply):
            refusal = codec.decode(Reply, payload)
            raise WireError(f"{key} refused: {refusal.code}: {refusal.reason}")
        return codec.decode(reply_cls, payload)

    def close(self) -> None:
        """End everything; may be called more than once, and from any thread."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        try:
            untyped: Any = self._session
            untyped.close()  # ends every ring, and with it the threads that wait on one
        except zenoh.ZError as error:
            _log.warning("closing the session: %s", first_line(error))
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(_JOIN_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _open(self) -> zenoh.Session:
        if self._closed:
            raise WireError("the session is closed")
        return self._session

    def _subscribe(self, key_expr: str, ring: int) -> zenoh.Subscriber[Any]:
        try:
            with self._lock:
                subscriber = self._open().declare_subscriber(key_expr, zenoh.handlers.RingChannel(ring))
                self._declared.append(subscriber)
                return subscriber
        except zenoh.ZError as error:
            raise WireError(f"cannot read {key_expr}: {first_line(error)}") from None

    def _pump(self, name: str, receive: Callable[[], Any], use: Callable[[Any], None]) -> None:
        self._threads.append(pump(name, receive, use, lambda: self._closed))


_open_sessions: weakref.WeakSet[Session] = weakref.WeakSet()


@atexit.register
def _close_all() -> None:
    for session in list(_open_sessions):
        session.close()
