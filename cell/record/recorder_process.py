"""A recorder in a process of its own, so that recording takes nothing from the decision loop but its data.

The child taps the wire, compresses and writes; from here it gets only the decisions, coded by a thread.
In real time it comes after the others: on a machine that is too small for all, samples of the wire are
missing, which is counted and told, and the loop goes on. Decisions wait here, coded, until the child
takes them, so that a replay is complete nevertheless.
"""

from __future__ import annotations

import logging
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from cell.child import WARNING, end_child
from cell.config import CellConfig, to_dict
from cell.errors import CellError, WireError
from cell.record.backlog import Backlog
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
        max_waiting: bound on the decisions that wait, on those that wait coded, and on what waits in the
            child [bytes].
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
        self.path = path
        self._whole = whole_frames(config, lossless)
        self._settings = Settings(to_dict(config), str(path), about, lossless, patient, max_waiting)
        self._decisions = Backlog[Decision](max_waiting, patient)
        self._coded = Backlog[bytes](max_waiting, patient)
        self._undecided = 0
        self._warned = False
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
        self._listeners = [_thread(self._warn), _thread(self._listen)]
        self._workers = [_thread(self._code), _thread(self._pass_on)]
        for thread in self._listeners:
            thread.start()

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
            self._listeners[0].join(1.0)
            if self._words:
                raise CellError(self._words[-1])
            raise WireError(f"recording {self.path}: the recorder did not start within {_START_TIME:g} s")
        for thread in self._workers:
            thread.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def decided(self, decision: Decision) -> None:
        """Take in one tick of the supervisor; only the patient recorder ever waits here."""
        if not self._decisions.put(decision, decision.size):
            self._fall_behind()

    def close(self) -> Counts:
        """Have everything that is under way written, the file finished, and return the counts.

        What takes longer than two minutes is given up; the file can be read all the same.
        """
        self._decisions.finish()
        for thread in self._workers:
            if thread.is_alive():
                thread.join(_END_TIME)
        end_child(self._process, _END_TIME)
        for thread in (*self._workers, *self._listeners):
            if thread.is_alive():
                thread.join(1.0)
        try:
            counts = msgspec.json.decode(self._said[-1] if self._said else "", type=Counts)
        except msgspec.MsgspecError:
            return Counts(undecided=self._undecided)
        return msgspec.structs.replace(counts, undecided=counts.undecided + self._undecided)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- threads ----------------------------------------------------------------------------------

    def _answer(self, patience: float) -> str:
        with self._wake:
            self._wake.wait_for(lambda: self._said or not self._listeners[1].is_alive(), patience)
            return self._said.pop(0) if self._said else ""

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

    def _code(self) -> None:
        try:
            while (decision := self._decisions.take()) is not None:
                try:
                    data = msgspec.msgpack.encode(code(decision, self._whole))
                except CellError as error:
                    self._lost(1)
                    _log.warning("recording %s: tick %d is left out: %s", self.path, decision.number, error)
                    continue
                if not self._coded.put(data, len(data)):
                    self._fall_behind()
            self._coded.finish()
        finally:  # nobody may wait for this thread any more
            self._lost(self._decisions.abandon())

    def _pass_on(self) -> None:
        assert self._process.stdin is not None
        try:
            while (data := self._coded.take()) is not None:
                self._process.stdin.write(len(data).to_bytes(LENGTH_BYTES, "big") + data)
                self._process.stdin.flush()
        except (OSError, ValueError):  # it died, or was ended while it hung
            self._warned = True
            _log.warning(
                "recording %s ended: its process is gone; the file can be read as far as it goes", self.path
            )
            self._lost(1)
        finally:
            self._lost(self._coded.abandon())

    def _fall_behind(self) -> None:
        self._lost(1)
        if not self._warned:
            self._warned = True
            _log.warning("recording %s: disk or machine is too slow; a replay will end early", self.path)

    def _lost(self, decisions: int) -> None:
        with self._wake:
            self._undecided += decisions


def _thread(work: Callable[[], None]) -> threading.Thread:
    return threading.Thread(target=work, daemon=True)
