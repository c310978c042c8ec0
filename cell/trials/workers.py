"""Who runs the rounds: one after the other, processes of this machine, or Dask on several.

Each round is a process of its own, so that what one leaves behind cannot reach another. Workers get
and give plain data; a round whose process was killed is run again.
"""

from __future__ import annotations

import secrets
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from cell.errors import ConfigError
from cell.trials.one_round import EVENTS, RESULT, TICKS, Job

TRIES = 3
"""So often a round is started that ends without a result."""
_PASSING = ("in use", "did not start within", "no answer to")
"""What a round says that another try may not: a port was taken, the machine was too busy."""
_END_TIME = 10.0
Done = tuple[Job, "dict[str, bytes] | str"]
"""A job with its files by ending, or the line that says why there are none."""


class Workers(Protocol):
    """Runs jobs."""

    def run(self, jobs: Sequence[Job]) -> Iterator[Done]:
        """Every job with its outcome, in the order in which they are done."""
        ...


class Running:
    """Child processes that can be ended together."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._children: set[subprocess.Popen[str]] = set()
        self._over = False

    def one(self, text: str) -> dict[str, bytes] | str:
        """Run one job in a process of its own; its files, or the last line of what it said."""
        words = "the round's process was not started"
        for _ in range(TRIES):
            if self._over:
                return "interrupted"
            with tempfile.TemporaryDirectory() as name:
                code, words = self._start(text, name)
                folder = Path(name)
                if code == 0:
                    return {e: (folder / f"round.{e}").read_bytes() for e in (EVENTS, TICKS, RESULT)}
                if code > 0 and not any(hint in words for hint in _PASSING):
                    return words
        return words

    def end(self) -> None:
        """End all of them, and start no more."""
        self._over = True
        with self._lock:
            for child in self._children:
                if child.stdin is not None:
                    child.stdin.close()

    def _start(self, text: str, folder: str) -> tuple[int, str]:
        child = subprocess.Popen(
            [sys.executable, "-m", "cell.trials.child", folder],
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            start_new_session=True,
        )  # fmt: skip
        with self._lock:
            self._children.add(child)
        try:
            assert child.stdin is not None and child.stderr is not None
            child.stdin.write(text + "\n")
            child.stdin.flush()
            said = [line.strip() for line in child.stderr if line.strip()]
            return child.wait(), said[-1].removeprefix("cell: ") if said else "the round's process was killed"
        except (OSError, ValueError):  # its pipe was closed: by `end`, or it died at once
            child.wait(_END_TIME)
            return 3, "the round's process ended early"
        finally:
            with self._lock:
                self._children.discard(child)


def run_text(text: str) -> dict[str, bytes] | str:
    """Run one job given as JSON; what a Dask worker is asked to do."""
    return Running().one(text)


class Local:
    """`workers` rounds at a time on this machine; 1 runs them one after the other."""

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def run(self, jobs: Sequence[Job]) -> Iterator[Done]:
        running, pool = Running(), ThreadPoolExecutor(self._workers)
        futures: dict[Future[Any], Job] = {pool.submit(running.one, job.to_json()): job for job in jobs}
        try:
            waiting = set(futures)
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    yield futures[future], future.result()
        finally:
            running.end()
            pool.shutdown(cancel_futures=True)


class Cluster:
    """Workers of a Dask scheduler; a lost worker's round is run by another.

    Args:
        address: of the scheduler, as tcp://host:8786. patience: how long it may take to answer [s].

    Raises:
        ConfigError: Dask is not installed, or nobody answers there.
    """

    def __init__(self, address: str, patience: float = 10.0) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError:
            raise ConfigError("--scheduler needs Dask: pip install 'sorting-cell[dask]'") from None
        try:
            self._client = distributed.Client(address, timeout=patience, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise ConfigError(f"--scheduler {address}: {error or 'nobody answers'}") from None
        self._as_completed = distributed.as_completed

    def run(self, jobs: Sequence[Job]) -> Iterator[Done]:
        token = secrets.token_hex(4)  # two campaigns may share a scheduler
        futures = {
            self._client.submit(run_text, job.to_json(), key=f"{job.spec.id}-{token}", retries=TRIES): job
            for job in jobs
        }
        try:
            for future in self._as_completed(list(futures), loop=self._client.loop):
                error = future.exception()
                yield (
                    futures[future],
                    future.result() if error is None else f"{type(error).__name__}: {error}",
                )
        finally:
            self._client.cancel(list(futures))
            self._client.close()
