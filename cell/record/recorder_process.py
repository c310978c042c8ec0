"""A recorder in a process of its own, so that recording takes nothing from the decision loop but its data.

The child taps the wire, compresses and writes; from here it gets only the decisions, coded by a thread.
In real time it runs at a lower priority than the loop: on a machine that is too small for both, the
recording has gaps, which are counted and told, and the loop goes on.
"""

from __future__ import annotations

import logging
import subprocess
import sys
import threading
from collections import deque
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from cell.child import WARNING, end_child
from cell.config import CellConfig, to_dict
from cell.errors import CellError, WireError
from cell.record.content import About
from cell.record.decision import Decision, code, whole_frames
from cell.record.recorder import MAX_WAITING, Counts

_log = logging.getLogger("cell.record")

LENGTH_BYTES = 4
"""Before each coded decision on the child's standard input, big-endian."""
_START_TIME, _END_TIME = 60.0, 120.0
"""How long the child may take to listen, and to write what waits [s]."""


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the child is told: one line of JSON. See `cell.record.recorder.Recorder`."""

    config: dict[str, Any]
    path: str
    about: About
    lossless: bool
    patient: bool
    max_waiting: int


class RecorderProcess:
    """Records from `begin` until `close`; use it as a context manager.

    The child is started at once and gets ready while others do; it ignores Ctrl-C, and when this process
    dies it finishes the file.

    Args:
        config: the cell. path: where to; see `cell.record.mcap_writer.check_target`.
        about: what is recorded. lossless: keep every pixel of every camera for the replay.
        patient: `decided` waits for the disk instead of dropping: for lock-step, where time can wait.
        max_waiting: bound on what waits in each of the two processes [bytes].
    """

    def __init__(
        self,
        config: CellConfig,
        path: Path,
        about: About,
        *,
        lossless: bool = False,
        patient: bool = False,
        max_waiting: int = MAX_WAITING,
    ) -> None:
        self.path, self._patient, self._max_waiting = path, patient, max_waiting
        self._whole = whole_frames(config, lossless)
        self._settings = Settings(to_dict(config), str(path), about, lossless, patient, max_waiting)
        self._queue: deque[Decision] = deque()
        self._waiting = self._undecided = 0
        self._closing = self._failed = self._warned_slow = False
        self._words: list[str] = []
        self._said: list[str] = []
        self._wake = threading.Condition()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "cell.record.recorder_child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        self._threads = {
            name: threading.Thread(target=work, name=name, daemon=True)
            for name, work in (("warnings", self._warn), ("said", self._listen), ("decisions", self._run))
        }
        for name in ("warnings", "said"):
            self._threads[name].start()

    def begin(self) -> None:
        """Return when everything that is sent from now on is heard.

        Raises:
            CellError: the file cannot be written there, or the node cannot be reached.
        """
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.write(msgspec.json.encode(self._settings) + b"\n")
            self._process.stdin.flush()
        if self._answer(_START_TIME) != "ready":
            end_child(self._process, 1.0)
            self._threads["warnings"].join(1.0)
            if self._words:
                raise CellError(self._words[-1])
            raise WireError(f"recording {self.path}: the recorder did not start within {_START_TIME:g} s")
        self._threads["decisions"].start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def decided(self, decision: Decision) -> None:
        """Take in one tick of the supervisor; only the patient recorder ever waits here."""
        with self._wake:
            while self._patient and not self._failed and self._waiting > self._max_waiting:
                self._wake.wait(1.0)
            room = self._patient or self._waiting + decision.size <= self._max_waiting
            if self._failed or not room:
                self._undecided += 1
                self._warn_slow()
                return
            self._queue.append(decision)
            self._waiting += decision.size
            self._wake.notify_all()

    def close(self) -> Counts:
        """Have everything that is under way written, the file finished, and return the counts.

        What takes longer than two minutes is given up; the file can be read all the same.
        """
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        if self._threads["decisions"].is_alive():
            self._threads["decisions"].join(_END_TIME)
        end_child(self._process, _END_TIME)
        for thread in self._threads.values():
            if thread.is_alive():
                thread.join(1.0)
        with self._wake:
            undecided = self._undecided + len(self._queue)
        try:
            counts = msgspec.json.decode(self._said[-1] if self._said else "", type=Counts)
        except msgspec.MsgspecError:
            return Counts(undecided=undecided)
        return msgspec.structs.replace(counts, undecided=counts.undecided + undecided)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- threads ----------------------------------------------------------------------------------

    def _answer(self, patience: float) -> str:
        with self._wake:
            self._wake.wait_for(lambda: self._said or not self._threads["said"].is_alive(), patience)
            return self._said.pop(0) if self._said else ""

    def _warn_slow(self) -> None:
        if not self._failed and not self._warned_slow:
            self._warned_slow = True
            _log.warning("recording %s: disk or machine is too slow; a replay will end early", self.path)

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._wake:
                self._said.append(line.decode(errors="replace").strip())
                self._wake.notify_all()
        with self._wake:
            self._wake.notify_all()

    def _warn(self) -> None:
        assert self._process.stderr is not None
        for raw in self._process.stderr:
            line = raw.decode(errors="replace").strip()
            if line.startswith(WARNING):
                _log.warning("%s", line.removeprefix(WARNING))
            elif line:
                self._words.append(line)
                del self._words[:-50]

    def _next(self) -> Decision | None:
        """What comes next, once it is there; None at the end."""
        with self._wake:
            self._wake.wait_for(lambda: self._queue or self._closing)
            if not self._queue:
                return None
            decision = self._queue.popleft()
            self._waiting -= decision.size
            self._wake.notify_all()
            return decision

    def _run(self) -> None:
        try:
            while (decision := self._next()) is not None:
                self._pass_on(decision)
        except (OSError, ValueError):  # it died, or was ended while it hung
            self._undecided += 1
            _log.warning(
                "recording %s ended: its process is gone; the file can be read as far as it goes", self.path
            )
        finally:  # nobody may wait for this thread any more
            with self._wake:
                self._failed = True
                self._undecided += len(self._queue)
                self._queue.clear()
                self._wake.notify_all()

    def _pass_on(self, decision: Decision) -> None:
        assert self._process.stdin is not None
        try:
            data = msgspec.msgpack.encode(code(decision, self._whole))
        except CellError as error:
            self._undecided += 1
            _log.warning("recording %s: tick %d is left out: %s", self.path, decision.number, error)
            return
        self._process.stdin.write(len(data).to_bytes(LENGTH_BYTES, "big") + data)
        self._process.stdin.flush()
