"""The emulated controller round a round on `--backend ur3e`, and the truth of its surroundings."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

import yaml

from cell.child import end_child
from cell.clock import WallClock
from cell.config import CellConfig, to_dict
from cell.decision.io import Inputs, Outputs
from cell.errors import BackendError, CellError
from cell.run.round import HOLDER, RoundOptions, Watcher
from cell.wire.session import Session
from cell.wire.types import Truth, TruthRequest

_LEFT_OUT = re.compile(r"; (\d+) more were left out")
_START_TIME, _END_TIME = 90.0, 8.0
_PERIOD = 0.2
"""From one look at the truth to the next [s]: it comes from a third process, in real time."""


class Emulated:
    """`cell emulate` in a process of its own, on a loopback address that nobody uses.

    Raises:
        BackendError: it did not start; with its own words.
    """

    def __init__(self, config: CellConfig, seed: int, onions: int, persona: str) -> None:
        self.address = free_address()
        self._folder = tempfile.TemporaryDirectory()
        file = Path(self._folder.name) / "cell.yaml"
        file.write_text(yaml.safe_dump(to_dict(config)))
        command = [sys.executable, "-m", "cell.cli", "emulate", "--listen", self.address, "--seed", str(seed)]
        command += ["--onions", str(onions), "--persona", persona, "--config", str(file), "--linked"]
        self._lines: list[str] = []
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            start_new_session=True,
        )  # fmt: skip
        self._ready = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)

    def __enter__(self) -> Self:
        self._reader.start()
        if not self._ready.wait(_START_TIME) or self._process.poll() is not None:
            self.close()
            raise BackendError(f"the emulated controller did not start: {' '.join(self._lines[-2:])}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def options(self, options: RoundOptions) -> RoundOptions:
        """The round's options against this controller."""
        return replace(options, robot_ip=self.address, cameras="sim")

    def sampler(self, config: CellConfig, tell: Callable[[Truth], None]) -> Sampler:
        """Asks for the truth while the round runs."""
        return Sampler(config, tell)

    def close(self) -> None:
        """End it; kill it if it does not come."""
        end_child(self._process, _END_TIME)
        self._reader.join(_END_TIME)
        self._folder.cleanup()

    @property
    def left_out(self) -> int | None:
        """Cycles of 2 ms that the emulator left out, being late; known when it has ended by itself."""
        found = _LEFT_OUT.search(self._lines[-1]) if self._lines else None
        return int(found[1]) if found else None

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.append(line.strip())
            if "emulated at" in line:
                self._ready.set()
        self._ready.set()


class Sampler:
    """A thread that asks the node for the truth, from the first tick until it is closed."""

    def __init__(self, config: CellConfig, tell: Callable[[Truth], None]) -> None:
        self._config, self._tell = config, tell
        self._over = threading.Event()
        self._now = 0.0
        self._thread: threading.Thread | None = None

    def first(self, watch: Watcher) -> Watcher:
        """A watcher that starts the thread at the first tick."""

        def both(inputs: Inputs, outputs: Outputs) -> None:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, daemon=True)
                self._thread.start()
            if outputs.done:
                self._over.set()
            self._now = inputs.t
            watch(inputs, outputs)

        return both

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        if self._thread is not None:
            self._thread.join(5.0)

    def _run(self) -> None:
        clock = WallClock()
        with contextlib.suppress(CellError), Session.connect(self._config) as session:
            while not self._over.is_set():
                due = clock.now() + _PERIOD
                with contextlib.suppress(CellError):
                    truth = session.call(session.keys.sim_truth, TruthRequest(HOLDER), Truth)
                    self._tell(_shifted(truth, self._now))
                clock.sleep_until(due)


def _shifted(truth: Truth, now: float) -> Truth:
    """The truth on the supervisor's clock: the surroundings count from their own start."""
    shift, person = now - truth.t, truth.person
    if person is not None:
        shown = tuple(
            replace(g, shown=g.shown + shift, answered=g.answered + shift if g.answered >= 0.0 else -1.0)
            for g in person.gestures
        )
        person = replace(person, gestures=shown)
    return replace(truth, t=now, person=person)


def free_address() -> str:
    """A loopback address on which nobody serves a controller's dashboard."""
    import random
    import socket

    for _ in range(50):
        address = f"127.0.{random.randrange(1, 255)}.{random.randrange(2, 255)}"
        with socket.socket() as probe:
            try:
                probe.bind((address, 29999))
            except OSError:
                continue
            return address
    raise BackendError("no free loopback address for an emulated controller was found")
