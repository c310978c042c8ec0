"""Threads that take samples and queries out of Zenoh's rings and put them to use."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import zenoh

from cell.errors import CellError, DecodeError, RefusedError
from cell.wire import codec
from cell.wire.endpoint import SMALL
from cell.wire.reader import Gaps, attached
from cell.wire.types import Reply

Q = TypeVar("Q")
Item = TypeVar("Item")

_log = logging.getLogger("cell.wire")

#: Longest reason sent with a refusal [characters].
_MAX_REASON = 1000


@dataclass(frozen=True)
class Tapped:
    """A sample as a tap sees it: undecoded.

    Attributes:
        key: channel it came on. payload: CDR bytes.
        seq: its sender's sequence number. t: source time [s].
        ros_type: e.g. "sensor_msgs/msg/Image"; empty if the sender did not say.
        missed: messages of this sender lost on this channel just before.
    """

    key: str
    payload: bytes
    seq: int
    t: float
    ros_type: str
    missed: int


def pump(
    name: str, receive: Callable[[], Item], use: Callable[[Item], None], closing: Callable[[], bool]
) -> threading.Thread:
    """Start a daemon thread that calls `use(receive())` until the ring is closed.

    Args:
        name: of the thread, and in the log when `use` raises; the thread goes on after that.
        closing: whether the session is going down, when exceptions are no news.
    """

    def run() -> None:
        while True:
            try:
                item = receive()
            except zenoh.ZError:  # the session was closed, and the ring with it
                return
            try:
                use(item)
            except Exception as error:  # one bad item must not end the service
                if not closing():
                    _log.exception("%s: %s", name, error)
            # Zenoh tells the asker that no more replies come when the query is let go.
            del item

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    return thread


def tap(callback: Callable[[Tapped], None]) -> Callable[[zenoh.Sample], None]:
    """What `Session.listen_all` does with a sample."""
    gaps: dict[str, Gaps] = {}

    def use(sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        seq, t, sender = attached(sample) or (0, 0.0, 0)
        missed = max(0, gaps.setdefault(key, Gaps()).missed(sender, seq))
        callback(Tapped(key, sample.payload.to_bytes(), seq, t, ros_type_of(sample.encoding), missed))

    return use


def answerer(key: str, request_cls: type[Q], handler: Callable[[Q], Any]) -> Callable[[zenoh.Query], None]:
    """What `Session.serve` does with a query; the asker gets an answer whatever happens."""

    def use(query: zenoh.Query) -> None:
        payload, ros_type = _answer(query, request_cls, handler)
        query.reply(
            key,
            payload,
            encoding=zenoh.Encoding.APPLICATION_CDR.with_schema(ros_type),
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=SMALL.priority,
            express=True,
        )

    return use


def ros_type_of(encoding: zenoh.Encoding) -> str:
    """The ROS type that a sample's or a reply's encoding names; empty if it names none."""
    return str(encoding).partition(";")[2]


def _answer(query: zenoh.Query, request_cls: type[Q], handler: Callable[[Q], Any]) -> tuple[bytes, str]:
    try:
        payload = b"" if query.payload is None else query.payload.to_bytes()
        reply = handler(codec.decode(request_cls, payload))
        return codec.encode(reply), codec.ros_type(type(reply))
    except DecodeError as error:
        refusal = Reply(False, "decode", str(error)[:_MAX_REASON])
    except RefusedError as error:
        refusal = Reply(False, error.code[:_MAX_REASON], error.reason[:_MAX_REASON])
    except CellError as error:
        refusal = Reply(False, "error", str(error)[:_MAX_REASON])
    except Exception as error:
        _log.exception("handler of %s", query.key_expr)
        refusal = Reply(False, "error", f"{type(error).__name__}: {error}"[:_MAX_REASON])
    return codec.encode(refusal), codec.ros_type(Reply)
