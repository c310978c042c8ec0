"""Brings commands from the wire's threads onto the loop's thread and their answers back."""

from __future__ import annotations

import logging
import queue
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass
from typing import Any

from cell.errors import CellError, RefusedError
from cell.limits import RefusalCode
from cell.wire.types import Reply

_log = logging.getLogger("hil")


@dataclass(frozen=True)
class _Job:
    handler: Callable[[Any], Any]
    request: Any
    answer: Future[Any]


class Inbox:
    """Jobs wait here until the one thread that drives the backend takes them.

    A command that waited too long is not done later: its sender has been told so.

    Args:
        on_refusal: told the code and reason of every refused command, on the loop's thread.
        patience: longest time a command may wait for the loop [s].
    """

    def __init__(self, on_refusal: Callable[[str, str], None], patience: float) -> None:
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._on_refusal = on_refusal
        self._patience = patience
        self._closed = False

    def wrap(self, handler: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """The handler as the wire's threads may call it: queue it, wait, answer."""

        def ask(request: Any) -> Any:
            job = _Job(handler, request, Future())
            self._jobs.put(job)
            if self._closed:
                self._refuse_waiting()
            try:
                return job.answer.result(self._patience)
            except FutureTimeout:
                if job.answer.cancel():
                    return Reply(False, RefusalCode.BUSY.value, "the node's loop did not answer in time")
                return job.answer.result()

        return ask

    def wake(self) -> None:
        """Let a waiting `work` return. May be called from a signal handler."""
        self._jobs.put(None)

    @property
    def empty(self) -> bool:
        """Nothing waits to be done."""
        return self._jobs.empty()

    def work(self) -> None:
        """Wait for one job and do it."""
        self._do(self._jobs.get())

    def drain(self) -> None:
        """Do every job that waits now, but not those that come meanwhile."""
        for _ in range(self._jobs.qsize()):
            try:
                job = self._jobs.get_nowait()
            except queue.Empty:
                return
            self._do(job)

    def close(self) -> None:
        """Refuse what waits and whatever comes later."""
        self._closed = True
        self._refuse_waiting()

    def _refuse_waiting(self) -> None:
        while True:
            try:
                job = self._jobs.get_nowait()
            except queue.Empty:
                return
            if job is not None and job.answer.set_running_or_notify_cancel():
                job.answer.set_result(Reply(False, RefusalCode.BUSY.value, "the node is ending"))

    def _do(self, job: _Job | None) -> None:
        if job is None or not job.answer.set_running_or_notify_cancel():
            return
        try:
            job.answer.set_result(job.handler(job.request))
        except Exception as error:  # no command may end the loop
            code, reason = _why(error)
            self._on_refusal(code, reason)
            job.answer.set_result(Reply(False, code, reason))


def _why(error: Exception) -> tuple[str, str]:
    if isinstance(error, RefusedError):
        return error.code, error.reason
    if isinstance(error, CellError):
        return RefusalCode.BACKEND.value, str(error)
    _log.error("a command failed", exc_info=error)
    return RefusalCode.BACKEND.value, f"{type(error).__name__}: {error}"
