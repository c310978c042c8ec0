"""A queue between two threads that is bounded by the bytes in it."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Backlog(Generic[T]):
    """What waits for a slower thread.

    Args:
        most: bytes that may wait.
        patient: `put` waits while more do, instead of refusing; one thing always fits.
    """

    def __init__(self, most: int, patient: bool) -> None:
        self._most, self._patient = most, patient
        self._items: deque[tuple[T, int]] = deque()
        self._waiting = 0
        self._finished = self._abandoned = False
        self._wake = threading.Condition()

    def put(self, item: T, size: int) -> bool:
        """Append something of `size` bytes; False: it did not fit, or nobody takes anything any more."""
        with self._wake:
            if self._patient:
                self._wake.wait_for(lambda: self._waiting <= self._most or self._abandoned)
            elif self._waiting + size > self._most:
                return False
            if self._abandoned:
                return False
            self._items.append((item, size))
            self._waiting += size
            self._wake.notify_all()
            return True

    def take(self) -> T | None:
        """The oldest, as soon as there is one; None when no more will come."""
        with self._wake:
            self._wake.wait_for(lambda: self._items or self._finished or self._abandoned)
            if not self._items:
                return None
            item, size = self._items.popleft()
            self._waiting -= size
            self._wake.notify_all()
            return item

    def finish(self) -> None:
        """No more will be put; what waits can still be taken."""
        with self._wake:
            self._finished = True
            self._wake.notify_all()

    def abandon(self) -> int:
        """Throw away what waits, and refuse what comes; how many things that were."""
        with self._wake:
            self._abandoned = True
            lost = len(self._items)
            self._items.clear()
            self._waiting = 0
            self._wake.notify_all()
            return lost
