"""Starts the view as a child process of a round; nothing that happens to it touches the round."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

from cell.child import end_child
from cell.config import CellConfig, to_dict
from cell.errors import CellError

ADDRESS, WATCHED = "http://", "watched "
"""What the view prints: its page's address, once the port is its own; how many browsers show the page."""
_START, _END = 60.0, 3.0
"""How long it may take to get its port, and to end [s]."""


class ViewProcess:
    """`python -m cell.view` as a context manager.

    Args:
        port: of the page. tell: told the page's address once it can be opened.

    Raises:
        CellError: the port is in use, or a package is missing.
    """

    def __init__(self, config: CellConfig, port: int, tell: Callable[[str], None]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "cell.view", "--port", str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(to_dict(config)) + "\n")
            self._process.stdin.flush()
        self._tell = tell
        self._serves, self._browsers = False, 0
        self._told = threading.Event()
        self._errors: list[str] = []
        self._readers = [threading.Thread(target=f, daemon=True) for f in (self._listen, self._collect)]
        for reader in self._readers:
            reader.start()
        self._told.wait(_START)
        if not self._serves:
            self.close()
            self._readers[1].join(1.0)
            raise CellError(self._errors[-1] if self._errors else "the view did not start")

    @property
    def pid(self) -> int:
        return self._process.pid

    def watched(self) -> bool:
        """A browser shows the page."""
        return self._browsers > 0 and self._process.poll() is None

    def close(self) -> None:
        """Close its standard input and wait for its end; kill it if it does not come."""
        end_child(self._process, _END)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith(WATCHED):
                self._browsers = int(line.removeprefix(WATCHED))
            elif line.startswith(ADDRESS):
                self._tell(line.strip())
            self._serves = True
            self._told.set()
        self._told.set()

    def _collect(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if line.strip():
                self._errors.append(line.rstrip())
                del self._errors[:-20]
