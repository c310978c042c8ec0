"""A process's connection to the cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self, TypeVar

from cell.config import CellConfig
from cell.wire.keys import Keys
from cell.wire.reader import Latest, LatestFrame
from cell.wire.types import Frame

M = TypeVar("M")
Q = TypeVar("Q")


@dataclass(frozen=True)
class Tapped:
    """A sample as a tap sees it: undecoded. t [s]; ros_type e.g. "sensor_msgs/msg/Image"."""

    key: str
    payload: bytes
    seq: int
    t: float
    ros_type: str


class Session:
    """Use as a context manager, or call `close`; every method is thread-safe."""

    keys: Keys

    @classmethod
    def listen(cls, config: CellConfig) -> Session:
        """The node's side: listen on tcp/127.0.0.1:{config.port}. WireError if the port is in use."""
        raise NotImplementedError

    @classmethod
    def connect(cls, config: CellConfig, timeout: float = 5.0) -> Session:
        """Everybody else's side. WireError if nobody listens there within `timeout` [s]."""
        raise NotImplementedError

    def publish(self, key: str, message: Any) -> None:
        """Send `message` (needs attribute t) to all who listen; never waits for them."""
        raise NotImplementedError

    def publish_frame(self, frame: Frame) -> None:
        """Send a frame as two images on camera/<name>/color and depth."""
        raise NotImplementedError

    def latest(self, key: str, cls: type[M]) -> Latest[M]:
        """Reader of the newest message on `key`."""
        raise NotImplementedError

    def latest_frame(self, camera: str) -> LatestFrame:
        """Reader of the newest frame of a camera."""
        raise NotImplementedError

    def listen_all(self, key_expr: str, callback: Callable[[Tapped], None]) -> None:
        """Call `callback` for every sample on matching keys, from one thread of this session."""
        raise NotImplementedError

    def serve(self, key: str, request_cls: type[Q], handler: Callable[[Q], Any]) -> None:
        """Answer queries on `key` with what `handler(request)` returns (a message).

        One thread per key. A request that cannot be decoded is answered Reply(False, "decode", why);
        an exception in the handler Reply(False, its RefusedError code or "error", why).
        """
        raise NotImplementedError

    def call(self, key: str, request: Any, reply_cls: type[M], timeout: float = 2.0) -> M:
        """Query `key`; returns the decoded reply.

        Raises:
            WireError: nobody answered in time, or (when reply_cls is not Reply) the answer was
                a refusal; the text then holds code and reason.
        """
        raise NotImplementedError

    def close(self) -> None:
        """End everything; idempotent."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
