"""Records everything on the wire into one MCAP file, without ever slowing anybody down.

A tap puts samples into a bounded queue; a thread compresses and writes them. When the
disk cannot keep up, or fails, samples are dropped and counted, and one warning says so.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from cell.clock import WallClock
from cell.config import CellConfig
from cell.record.mcap_writer import McapFile
from cell.wire.service import Tapped
from cell.wire.session import Session

_log = logging.getLogger("cell.record")

#: Most that may wait for the disk [bytes]; about 60 VGA RGB-D frames.
MAX_WAITING = 128 * 1024 * 1024
_FLUSH_S = 0.5
_SETTLE_S = 0.2


@dataclass(frozen=True)
class Counts:
    """What became of the samples.

    Attributes:
        written: safely in the file. dropped: given up because the disk was too slow or failed.
        missed: lost on the wire before they arrived here. unknown: of a type that has no schema.
    """

    written: int = 0
    dropped: int = 0
    missed: int = 0
    unknown: int = 0


class Recorder:
    """Records from construction until `close`; use it as a context manager.

    Topics are the wire's keys with a slash in front; log times are source times.

    Args:
        config: the cell, whose node must be running.
        path: where to; see `cell.record.mcap_writer.check_target`.
        max_waiting: bound on what waits for the disk [bytes].

    Raises:
        ConfigError: the file cannot be written there.
        WireError: the node cannot be reached.
    """

    def __init__(self, config: CellConfig, path: Path | str, max_waiting: int = MAX_WAITING) -> None:
        self.path = Path(path)
        self._max_waiting = max_waiting
        self._file = McapFile(self.path)
        self._samples: deque[Tapped] = deque()
        self._waiting = 0
        self._written = self._dropped = self._missed = self._unknown = 0
        self._unflushed = 0
        self._failed = self._closing = self._closed = self._warned_slow = False
        self._unknown_types: set[str] = set()
        self._wake = threading.Condition()
        self._clock = WallClock()
        try:
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
        return Counts(self._written, self._dropped, self._missed, self._unknown)

    @property
    def failed(self) -> bool:
        """The disk refused; nothing has been recorded since."""
        return self._failed

    def close(self) -> Counts:
        """Take what is still under way (0.2 s), finish the file, and return the counts."""
        if not self._closed:
            self._closed = True
            self._clock.sleep_until(self._clock.now() + _SETTLE_S)
            self._session.close()
            with self._wake:
                self._closing = True
                self._wake.notify()
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
            self._missed += sample.missed
            if self._failed or self._waiting + len(sample.payload) > self._max_waiting:
                self._dropped += 1
                if not self._failed and not self._warned_slow:
                    self._warned_slow = True
                    _log.warning("recording %s: the disk is too slow; samples are being dropped", self.path)
                return
            self._samples.append(sample)
            self._waiting += len(sample.payload)
            self._wake.notify()

    def _next(self, timeout: float) -> Tapped | None:
        """The next sample; None when there is none within `timeout` [s] or at the end."""
        with self._wake:
            if not self._samples and not self._closing:
                self._wake.wait(timeout)
            if not self._samples:
                return None
            sample = self._samples.popleft()
            self._waiting -= len(sample.payload)
            return sample

    def _run(self) -> None:
        try:
            self._record()
        except OSError as error:
            self._failed = True
            self._file.abandon()
            with self._wake:
                self._dropped += len(self._samples) + self._unflushed
                self._samples.clear()
                self._waiting = 0
            why = error.strerror or str(error)
            _log.warning("recording %s ended: %s; it can be read up to there", self.path, why)

    def _record(self) -> None:
        flush_at = self._clock.now() + _FLUSH_S
        while True:
            sample = self._next(timeout=_FLUSH_S)
            if sample is not None:
                self._write(sample)
            elif self._closing:
                break
            if self._clock.now() >= flush_at:
                self._file.flush()
                self._flushed()
                flush_at = self._clock.now() + _FLUSH_S
        self._file.close()
        self._flushed()

    def _flushed(self) -> None:
        self._written += self._unflushed
        self._unflushed = 0

    def _write(self, sample: Tapped) -> None:
        self._unflushed += 1
        try:
            self._file.add(f"/{sample.key}", sample.ros_type, sample.t, sample.seq, sample.payload)
        except KeyError:
            self._unflushed -= 1
            self._unknown += 1
            if sample.ros_type not in self._unknown_types:
                self._unknown_types.add(sample.ros_type)
                _log.warning("not recorded: %s has the unknown type %r", sample.key, sample.ros_type)
