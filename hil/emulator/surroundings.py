"""Starts the process with the cameras, the person and the truth, and ends it again."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

from cell.clock import perf_s
from cell.config import CellConfig, to_dict
from cell.errors import BackendError, CellError
from hil.emulator.exchange import Exchange
from hil.emulator.mirror import check_surroundings

_START_TIME = 60.0
_END_TIME = 0.7
"""How long the process may take to serve, and to end before it is killed [s]."""
_WARNING = "warning: "


class Surroundings:
    """`python -m hil.emulator.eyes` as a child of this process, in a process group of its own.

    Args:
        listen: address of the side channel, "host" or "host:port".
        seed, onions, persona: the first batch and person; persona "": nobody.

    Attributes:
        exchange: this end of the link, for `WorldPlant`.

    Raises:
        ConfigError: impossible batch or unknown persona.
    """

    def __init__(self, config: CellConfig, listen: str, seed: int, onions: int, persona: str) -> None:
        check_surroundings(seed, onions, persona)
        ours, theirs = Exchange.pair()
        self.exchange = Exchange(ours)
        command = [sys.executable, "-m", "hil.emulator.eyes", "--link", str(theirs.fileno())]
        command += ["--listen", listen, "--seed", str(seed), "--onions", str(onions), "--persona", persona]
        with theirs:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                text=True, start_new_session=True, pass_fds=[theirs.fileno()],
            )  # fmt: skip
        self._errors: list[str] = []
        self._ready = threading.Event()
        self._readers = [
            threading.Thread(target=read, daemon=True) for read in (self._await_ready, self._collect)
        ]
        for reader in self._readers:
            reader.start()
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(to_dict(config)) + "\n")
            self._process.stdin.flush()

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def alive(self) -> bool:
        """The process runs."""
        return self._process.poll() is None

    def wait_ready(self, given_up: Callable[[], bool] = lambda: False) -> None:
        """Return when cameras and truth are served, or when that is given up.

        Raises:
            CellError: the process failed, in its own words.
        """
        end = perf_s() + _START_TIME
        while not self._ready.wait(0.05):
            if given_up():
                return
            if not self.alive:
                break
            if perf_s() > end:
                self.close()
                raise BackendError(f"the simulated surroundings did not start within {_START_TIME:g} s")
        else:
            return
        for reader in self._readers:
            reader.join(1.0)
        if self._ready.is_set():
            return
        raise CellError(self.last_words())

    def last_words(self) -> str:
        """Why the process ended, as far as it said."""
        words = [text for text in self._errors if text.strip() and not text.startswith(_WARNING)]
        return words[-1] if words else "the simulated surroundings ended without a word"

    def close(self) -> None:
        """Close the link and wait for the end; kill the process if it does not come. Repeatable."""
        self.exchange.close()
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(_END_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _await_ready(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.strip() == "ready":
                self._ready.set()

    def _collect(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if line.startswith(_WARNING):
                print(f"cell: {line.rstrip()}", file=sys.stderr)
            self._errors.append(line.rstrip())
            del self._errors[:-50]
