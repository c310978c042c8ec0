"""The controller's dashboard server (port 29999): one line asked, one line answered."""

from __future__ import annotations

import socket
from types import TracebackType
from typing import Self

from cell.errors import BackendError

PORT = 29999
_LONGEST = 4096


class Dashboard:
    """A connection to the dashboard server; use it as a context manager.

    Args:
        timeout: for connecting and for each answer [s].

    Raises:
        BackendError: nobody answers there.
    """

    def __init__(self, robot_ip: str, timeout: float = 3.0, port: int = PORT) -> None:
        self._where = f"{robot_ip}:{port}"
        try:
            self._socket = socket.create_connection((robot_ip, port), timeout)
            self._socket.settimeout(timeout)
            self._file = self._socket.makefile("rb")
        except OSError as error:
            raise BackendError(f"no robot answers at {self._where} ({_why(error)})") from None
        self.banner = self._line()

    def ask(self, request: str) -> str:
        """The answer to `request`; raises `BackendError` when the connection fails."""
        try:
            self._socket.sendall(request.encode("ascii") + b"\n")
        except OSError as error:
            raise BackendError(f"the dashboard at {self._where} is gone ({_why(error)})") from None
        return self._line()

    def _line(self) -> str:
        try:
            line = self._file.readline(_LONGEST)
        except OSError as error:
            raise BackendError(f"the dashboard at {self._where} does not answer ({_why(error)})") from None
        if not line.endswith(b"\n"):
            raise BackendError(f"the dashboard at {self._where} closed the connection")
        return line.decode("utf-8", "replace").strip()

    def value(self, request: str) -> str:
        """The part of the answer behind its colon, as in "Robotmode: RUNNING"."""
        answer = self.ask(request)
        return answer.partition(":")[2].strip() or answer

    def close(self) -> None:
        self._file.close()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def stop_program(robot_ip: str) -> None:
    """End whatever program runs or is paused; raises `BackendError` when that cannot be asked."""
    with Dashboard(robot_ip, timeout=1.0) as dashboard:
        dashboard.ask("stop")


def _why(error: OSError) -> str:
    if isinstance(error, TimeoutError):
        return "no answer in time"
    return error.strerror or str(error) or type(error).__name__
