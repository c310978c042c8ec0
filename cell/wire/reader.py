"""The newest sample of a channel, with its age."""

from __future__ import annotations

from typing import Generic, TypeVar

from cell.wire.types import Frame

M = TypeVar("M")


class Latest(Generic[M]):
    """Reader of one channel. Thread-safe; never blocks.

    Attributes:
        key: the channel. lost: messages that never arrived here, from gaps in the sequence.
        received: messages that did. malformed: those of them that were no valid message.
    """

    key: str
    lost: int
    received: int
    malformed: int

    def get(self, now: float, max_age: float) -> M:
        """Newest message; raises StaleError naming key and age if none or older than max_age [s]."""
        raise NotImplementedError

    def peek(self) -> M | None:
        """Newest message whatever its age; None before the first."""
        raise NotImplementedError

    def age(self, now: float) -> float:
        """now minus the newest message's source time [s]; infinity before the first."""
        raise NotImplementedError

    def take(self) -> M | None:
        """Newest message if it was not taken before, else None."""
        raise NotImplementedError

    def wait(self, timeout: float) -> M:
        """First or next message, waiting up to `timeout` wall seconds; raises StaleError."""
        raise NotImplementedError


class LatestFrame:
    """Pairs a camera's colour and depth images of equal time into a `Frame`; same methods as Latest."""

    def get(self, now: float, max_age: float) -> Frame:
        raise NotImplementedError

    def take(self) -> Frame | None:
        raise NotImplementedError
