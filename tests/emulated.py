"""An emulated controller for tests: one process, started when it is first needed, ended with its module."""

from __future__ import annotations

import atexit
import subprocess
import sys
import threading
from functools import cache
from typing import IO

import msgspec

from cell.config import CellConfig
from hil.backend import Backend, make_backend

_START = 60.0


class Emulated:
    """`cell emulate` as a child process.

    Args:
        address: where; its ports are the true ones. options: of `cell emulate`.
    """

    def __init__(self, address: str, *options: str) -> None:
        self.address = address
        command = [sys.executable, "-m", "cell.cli", "emulate", "--listen", address, *options]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.lines: list[str] = []
        self._ready = threading.Event()
        assert self._process.stdout is not None
        threading.Thread(target=self._listen, args=(self._process.stdout,), daemon=True).start()
        atexit.register(self.close)
        if not self._ready.wait(_START) or self._process.poll() is not None:
            self.close()
            raise RuntimeError(f"the emulator did not start: {self.lines[-3:]}")

    @property
    def pid(self) -> int:
        return self._process.pid

    def close(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _listen(self, stream: IO[str]) -> None:
        for line in stream:
            self.lines.append(line.strip())
            if "Ctrl-C ends it" in line:
                self._ready.set()
        self._ready.set()


@cache
def with_cell() -> Emulated:
    """One with the simulated cell around it, shared by the tests of a module."""
    return Emulated("127.0.0.51", "--onions", "1", "--persona", "none")


def end() -> None:
    """End it, if it runs: it would take a quarter of a core from all tests that follow."""
    if with_cell.cache_info().currsize:
        with_cell().close()
        with_cell.cache_clear()


def patient(config: CellConfig) -> CellConfig:
    """A busy test machine holds everybody up now and then: that is not what is tested."""
    replace = msgspec.structs.replace
    ur3e = replace(config.ur3e, patience=0.3)
    return replace(config, ur3e=ur3e, supervisor=replace(config.supervisor, heartbeat_deadline=1.0))


def emulated_backend(config: CellConfig) -> Backend:
    """The real arm's backend on an emulated controller."""
    return make_backend(
        "ur3e", patient(config), seed=3, onions=1, robot_ip=with_cell().address, cameras="sim"
    )
