"""Brings commands from the wire's threads onto the loop's thread and their answers back."""

from __future__ import annotations

import queue
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any

from cell.errors import CellError, RefusedError
from cell.limits import RefusalCode
from cell.wire.types import Reply

_ANSWER_TIME = 30.0
"""Longest time a command may wait for the loop [s]."""


class Inbox:
    """Jobs wait here until the one thread that drives the backend takes them.

    Args:
        on_refusal: told about every refused command, on the wire's thread.
    """

    def __init__(self, on_refusal: Callable[[RefusedError], None]) -> None:
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None] = queue.SimpleQueue()
        self._on_refusal = on_refusal

    def wrap(self, handler: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """The handler as the wire's threads may call it: queue it, wait, answer."""

        def ask(request: Any) -> Any:
            future: Future[Any] = Future()
            self._jobs.put((lambda: handler(request), future))
            try:
                return future.result(_ANSWER_TIME)
            except FutureTimeout:
                return Reply(False, "busy", "the node's loop did not answer in time")
            except RefusedError as error:
                refused = error
            except CellError as error:
                refused = RefusedError(RefusalCode.BACKEND.value, str(error))
            self._on_refusal(refused)
            return Reply(False, refused.code, refused.reason)

        return ask

    def wake(self) -> None:
        """Let a waiting `work` return."""
        self._jobs.put(None)

    def work(self) -> None:
        """Wait for one job and do it."""
        self._do(self._jobs.get())

    def drain(self) -> None:
        """Do every job that waits now."""
        while True:
            try:
                item = self._jobs.get_nowait()
            except queue.Empty:
                return
            self._do(item)

    @staticmethod
    def _do(item: tuple[Callable[[], Any], Future[Any]] | None) -> None:
        if item is None:
            return
        job, future = item
        try:
            future.set_result(job())
        except Exception as error:
            future.set_exception(error)
