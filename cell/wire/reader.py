"""The newest sample of a channel, with its age, and a count of those that never came.

Zenoh keeps the last few samples in a ring that its own threads fill; a reader looks into
the ring when it is asked. No Python runs when a message arrives, so nothing here can
delay reception, and nothing can hang when the interpreter exits.
"""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections import deque
from typing import Any, Generic, TypeVar

import zenoh

from cell.clock import WallClock
from cell.errors import DecodeError, StaleError
from cell.wire.codec import decode
from cell.wire.endpoint import ATTACHMENT
from cell.wire.layouts_image import join
from cell.wire.types import Frame, Image

M = TypeVar("M")

_WAIT_STEP = 0.001
#: Images that wait for their other half.
_RING_HALVES = 8


class Gaps:
    """Counts missing sequence numbers of one channel, separately for each sender."""

    def __init__(self) -> None:
        self._last: dict[int, int] = {}

    def missed(self, sender: int, seq: int) -> int:
        """Messages missing before this one; -1 for one that is late or doubled."""
        last = self._last.get(sender)
        if last is not None and seq <= last:
            return -1
        self._last[sender] = seq
        return 0 if last is None else seq - last - 1


def attached(sample: zenoh.Sample) -> tuple[int, float, int] | None:
    """(sequence number, source time [s], sender) of a sample; None if it does not carry them."""
    data = b"" if sample.attachment is None else sample.attachment.to_bytes()
    if len(data) != ATTACHMENT.size:
        return None
    seq, ns, sender = ATTACHMENT.unpack(data)
    return seq, ns / 1_000_000_000, sender


class Newest(ABC, Generic[M]):
    """What all readers share. Thread-safe; `wait` alone ever blocks.

    Attributes:
        key: the channel, for messages to people.
    """

    def __init__(self, key: str) -> None:
        self.key = key
        self._lock = threading.Lock()
        self._message: M | None = None
        self._t = -math.inf
        self._fresh: deque[M] = deque(maxlen=256)

    @abstractmethod
    def _poll(self) -> None:
        """Take over what has arrived (called with the lock held)."""

    def _accept(self, message: M, t: float) -> None:
        self._message, self._t = message, t
        self._fresh.append(message)

    def get(self, now: float, max_age: float) -> M:
        """The newest message.

        Args:
            now: present time on the sender's clock [s].
            max_age: oldest acceptable age [s].

        Raises:
            StaleError: none yet, older than `max_age`, or further than that in the future
                (the sender's clock was set back).
        """
        with self._lock:
            self._poll()
            message, age = self._message, now - self._t
        if message is None:
            raise StaleError(f"{self.key}: no message has arrived yet")
        if age > max_age:
            raise StaleError(f"{self.key}: newest message is {age:.3f} s old, accepted are {max_age:.3f} s")
        if age < -max_age:
            raise StaleError(f"{self.key}: newest message is {-age:.3f} s ahead; was the clock reset?")
        return message

    def peek(self) -> M | None:
        """The newest message whatever its age; None before the first."""
        with self._lock:
            self._poll()
            return self._message

    def age(self, now: float) -> float:
        """`now` minus the newest message's source time [s]; infinity before the first."""
        with self._lock:
            self._poll()
            return now - self._t

    def take(self) -> M | None:
        """The newest message if it came after the last `take` or `take_all`, else None."""
        messages = self.take_all()
        return messages[-1] if messages else None

    def take_all(self) -> list[M]:
        """All messages since the last `take` or `take_all`, oldest first, at most 256."""
        with self._lock:
            self._poll()
            messages = list(self._fresh)
            self._fresh.clear()
            return messages

    def wait(self, timeout: float) -> M:
        """The next message not yet taken, waiting for it up to `timeout` [s] of wall time.

        Raises:
            StaleError: none came.
        """
        clock = WallClock()
        end = clock.now() + timeout
        while True:
            message = self.take()
            if message is not None:
                return message
            if clock.now() >= end:
                raise StaleError(f"{self.key}: no message within {timeout:g} s")
            clock.sleep_until(clock.now() + _WAIT_STEP)


class Latest(Newest[M]):
    """Reader of one channel.

    Attributes:
        received: messages that arrived.
        lost: messages that did not, including those overwritten in the ring (256 small
            messages or 8 images) because nobody looked in time.
        malformed: messages that arrived and were not valid.
        last_error: why the last malformed one was refused, empty if none was.
    """

    def __init__(self, key: str, cls: type[M], subscriber: zenoh.Subscriber[Any]) -> None:
        super().__init__(key)
        self._cls = cls
        self._subscriber = subscriber
        self._gaps = Gaps()
        self.received = 0
        self.lost = 0
        self.malformed = 0
        self.last_error = ""

    def _poll(self) -> None:
        while (sample := self._next()) is not None:
            self.received += 1
            origin = attached(sample)
            if origin is None:
                self._refuse("no sequence number and source time attached")
                continue
            seq, t, sender = origin
            missed = self._gaps.missed(sender, seq)
            if missed < 0:
                continue
            self.lost += missed
            try:
                self._accept(decode(self._cls, sample.payload.to_bytes()), t)
            except DecodeError as error:
                self._refuse(str(error))

    def _next(self) -> zenoh.Sample | None:
        try:
            sample: zenoh.Sample | None = self._subscriber.handler.try_recv()
            return sample
        except zenoh.ZError:  # the session was closed: the message held last stays readable
            return None

    def _refuse(self, why: str) -> None:
        self.malformed += 1
        self.last_error = f"{self.key}: {why}"


class LatestFrame(Newest[Frame]):
    """Joins a camera's colour and depth images of one exposure into a `Frame`.

    Attributes:
        color, depth: readers of the two channels, with their counts.
    """

    def __init__(self, color: Latest[Image], depth: Latest[Image]) -> None:
        super().__init__(f"{color.key.removesuffix('/color')}/{{color,depth}}")
        self.color = color
        self.depth = depth
        self._halves: tuple[dict[float, Image], dict[float, Image]] = ({}, {})
        self._count = 0

    def _poll(self) -> None:
        colors, depths = self._halves
        for waiting, reader in ((colors, self.color), (depths, self.depth)):
            waiting.update((image.t, image) for image in reader.take_all())
            for t in list(waiting)[:-_RING_HALVES]:
                del waiting[t]  # its other half was lost
        for t in [t for t in depths if t in colors]:
            self._join(colors.pop(t), depths.pop(t))

    def _join(self, color: Image, depth: Image) -> None:
        self._count += 1
        try:
            frame = join(self._count, color, depth)
        except DecodeError as error:
            self.color.malformed += 1
            self.color.last_error = f"{self.key}: {error}"
        else:
            self._accept(frame, frame.t)
