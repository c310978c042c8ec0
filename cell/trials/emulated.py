"""The emulated controller round a round on `--backend ur3e`, and the truth of its surroundings."""

from __future__ import annotations

import contextlib
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

from cell.clock import WallClock
from cell.config import CellConfig, to_dict
from cell.decision.io import Inputs, Outputs
from cell.errors import BackendError, CellError
from cell.run.round import HOLDER, RoundOptions, Watcher
from cell.wire.session import Session
from cell.wire.types import Truth, TruthRequest

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
        command += ["--onions", str(onions), "--persona", persona, "--config", str(file)]
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
        )

    def __enter__(self) -> Self:
        lines: list[str] = []
        ready = threading.Event()

        def read() -> None:
            assert self._process.stdout is not None
            for line in self._process.stdout:
                lines.append(line.strip())
                if "emulated at" in line:
                    ready.set()
            ready.set()

        threading.Thread(target=read, daemon=True).start()
        if not ready.wait(_START_TIME) or self._process.poll() is not None:
            self.close()
            raise BackendError(f"the emulated controller did not start: {' '.join(lines[-2:])}")
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
        self._process.terminate()
        try:
            self._process.wait(_END_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()


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
