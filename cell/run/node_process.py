"""Starts the node as a child process and ends it again, whatever happens here."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from types import TracebackType
from typing import Self

from cell.child import WARNING, end_child
from cell.config import CellConfig, to_dict
from cell.errors import CellError, WireError

_START_TIME = 60.0
_END_TIME = 6.0
"""How long the node may take to serve, and to stop the arm and end [s]."""


class NodeProcess:
    """`python -m hil` as a context manager.

    The node lives in its own process group, so Ctrl-C reaches only the supervisor; it watches
    its standard input and ends by itself when this process dies.
    """

    def __init__(
        self,
        config: CellConfig,
        *,
        backend: str,
        lock_step: bool,
        seed: int,
        onions: int,
        person: str = "",
        robot_ip: str = "",
        cameras: str = "",
    ) -> None:
        command = [sys.executable, "-m", "hil", "--backend", backend]
        command += ["--seed", str(seed), "--onions", str(onions)]
        for option, value in (("--person", person), ("--robot-ip", robot_ip), ("--cameras", cameras)):
            command += [option, value] if value else []
        if lock_step:
            command.append("--lock-step")
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._errors: list[str] = []
        self._reader = threading.Thread(target=self._collect, daemon=True)
        self._reader.start()
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(to_dict(config)) + "\n")
            self._process.stdin.flush()

    @property
    def pid(self) -> int:
        return self._process.pid

    def wait_ready(self) -> None:
        """Return when the node serves; raises `CellError` with the node's own words if it fails."""
        line: list[str] = []
        assert self._process.stdout is not None
        stdout = self._process.stdout
        waiter = threading.Thread(target=lambda: line.append(stdout.readline()), daemon=True)
        waiter.start()
        waiter.join(_START_TIME)
        if line and line[0].strip() == "ready":
            return
        self.close()
        self._reader.join(1.0)
        words = [text for text in self._errors if text.strip()]
        if words:
            raise CellError(words[-1])
        raise WireError(f"the node did not start within {_START_TIME:g} s")

    def close(self) -> None:
        """Close the node's standard input and wait for its end; kill it if it does not come."""
        end_child(self._process, _END_TIME)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _collect(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if line.startswith(WARNING):
                print(f"cell: {line.rstrip()}", file=sys.stderr)
            self._errors.append(line.rstrip())
            del self._errors[:-50]
