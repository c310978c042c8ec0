"""Records everything on the wire into one MCAP file, without ever slowing anybody down.

A tap puts samples into a bounded queue, and so does whoever has decisions; a thread compresses and
writes them. When disk or machine cannot keep up, or the disk fails, samples are dropped and counted,
and one warning says so. `cell.record.recorder_process` runs one beside the decision loop.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec

from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import CellError
from cell.record.content import About, Content
from cell.record.decision import CodedDecision
from cell.record.mcap_writer import McapFile
from cell.wire.service import Tapped
from cell.wire.session import Session

_log = logging.getLogger("cell.record")

#: Most that may wait for the disk [bytes]; about 60 VGA RGB-D frames.
MAX_WAITING = 128 * 1024 * 1024
_FLUSH_S = 0.5
_SETTLE_S, _SETTLES = 0.2, 3


class Counts(msgspec.Struct, frozen=True):
    """What became of the samples.

    Attributes:
        written: safely in the file. dropped: given up because the disk was too slow or failed.
        missed: lost on the wire before they arrived here. unknown: of a type that has no schema.
        decisions: in the file. undecided: decisions that are not: a replay ends there.
    """

    written: int = 0
    dropped: int = 0
    missed: int = 0
    unknown: int = 0
    decisions: int = 0
    undecided: int = 0


class Recorder:
    """Records from construction until `close`; use it as a context manager.

    Topics are the wire's keys with a slash in front; log times are source times.

    Args:
        config: the cell, whose node must be running.
        path: where to; see `cell.record.mcap_writer.check_target`.
        max_waiting: bound on what waits for the disk [bytes].
        about, lossless: see `Content`.
        patient: `decided` waits for the disk instead of dropping: for lock-step, where time can wait.

    Raises:
        ConfigError: the file cannot be written there.
        WireError: the node cannot be reached.
    """

    def __init__(
        self,
        config: CellConfig,
        path: Path | str,
        max_waiting: int = MAX_WAITING,
        about: About | None = None,
        lossless: bool = False,
        patient: bool = False,
    ) -> None:
        self.path = Path(path)
        self._max_waiting, self._patient = max_waiting, patient
        self._file = McapFile(self.path)
        self._queue: deque[tuple[Tapped | CodedDecision, int]] = deque()
        self._waiting = 0
        self._written = self._dropped = self._missed = self._unknown = 0
        self._decisions = self._undecided = self._arrived = 0
        self._unflushed = [0, 0]
        """Samples and decisions since the last flush."""
        self._failed = self._closing = self._closed = self._warned_slow = False
        self._unknown_types: set[str] = set()
        self._wake = threading.Condition()
        self._clock = WallClock()
        try:
            self._content = Content(config, self._file, about, lossless)
            self._session = Session.connect(config)
        except Exception:
            self._file.close()
            raise
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()
        self._session.listen_all(self._session.keys.all, self._store)

    @property
    def counts(self) -> Counts:
        """What has become of the samples so far."""
        return Counts(
            self._written, self._dropped, self._missed, self._unknown, self._decisions, self._undecided
        )

    @property
    def failed(self) -> bool:
        """The disk refused; nothing has been recorded since."""
        return self._failed

    def decided(self, decision: CodedDecision) -> None:
        """Take in one tick of the supervisor; only the patient recorder ever waits here."""
        with self._wake:
            while self._patient and not self._failed and self._waiting > self._max_waiting:
                self._wake.wait(1.0)
            if not self._enqueue(decision, decision.size):
                self._undecided += 1

    def close(self) -> Counts:
        """Take what is still under way (0.2 to 0.6 s), finish the file, and return the counts."""
        if not self._closed:
            self._closed = True
            for _ in range(_SETTLES):
                before = self._arrived
                self._clock.sleep_until(self._clock.now() + _SETTLE_S)
                if self._arrived == before:
                    break
            self._session.close()
            with self._wake:
                self._closing = True
                self._wake.notify_all()
            self._thread.join()
        return self.counts

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _store(self, sample: Tapped) -> None:
        with self._wake:
            self._arrived += 1
            self._missed += sample.missed
            if not self._enqueue(sample, len(sample.payload)):
                self._dropped += 1

    def _enqueue(self, item: Tapped | CodedDecision, size: int) -> bool:
        """Put something into the queue, if it fits; the lock must be held."""
        if self._failed or (self._waiting + size > self._max_waiting and not self._patient):
            if not self._failed and not self._warned_slow:
                self._warned_slow = True
                _log.warning("recording %s: disk or machine is too slow; samples are dropped", self.path)
            return False
        self._queue.append((item, size))
        self._waiting += size
        self._wake.notify_all()
        return True

    def _next(self, timeout: float) -> Tapped | CodedDecision | None:
        """What comes next; None when there is nothing within `timeout` [s] or at the end."""
        with self._wake:
            if not self._queue and not self._closing:
                self._wake.wait(timeout)
            if not self._queue:
                return None
            item, size = self._queue.popleft()
            self._waiting -= size
            self._wake.notify_all()
            return item

    def _run(self) -> None:
        try:
            self._record()
        except OSError as error:
            self._file.abandon()
            self._give_up(error.strerror or str(error), self._unflushed)

    def _give_up(self, why: str, lost: list[int]) -> None:
        """Record no more. lost: samples and decisions that were written but are not in the file."""
        with self._wake:
            self._failed = True
            decisions = sum(isinstance(item, CodedDecision) for item, _ in self._queue)
            self._dropped += len(self._queue) - decisions + lost[0]
            self._undecided += decisions + lost[1]
            self._queue.clear()
            self._waiting = 0
            self._wake.notify_all()
        _log.warning("recording %s ended: %s; it can be read up to there", self.path, why)

    def _record(self) -> None:
        flush_at = self._clock.now() + _FLUSH_S
        while True:
            item = self._next(timeout=_FLUSH_S)
            if item is not None:
                self._write(item)
            elif self._closing:
                break
            if self._clock.now() >= flush_at:
                self._file.flush()
                self._flushed()
                flush_at = self._clock.now() + _FLUSH_S
                if self._file.full():
                    self._file.close()
                    self._give_up("the disk is full", [0, 0])
                    return
        self._file.close()
        self._flushed()

    def _flushed(self) -> None:
        self._written += self._unflushed[0]
        self._decisions += self._unflushed[1]
        self._unflushed = [0, 0]

    def _write(self, item: Tapped | CodedDecision) -> None:
        if isinstance(item, CodedDecision):
            self._content.decision(item)
            self._unflushed[1] += 1
            return
        self._unflushed[0] += 1
        try:
            self._content.sample(item)
        except KeyError:
            self._unflushed[0] -= 1
            self._unknown += 1
            if item.ros_type not in self._unknown_types:
                self._unknown_types.add(item.ros_type)
                _log.warning("not recorded: %s has the unknown type %r", item.key, item.ros_type)
        except CellError as error:
            self._unflushed[0] -= 1
            self._unknown += 1
            _log.warning("not recorded: %s: %s", item.key, error)
