"""A program of the External Control URCap: fetches its script from the client when it is played."""

from __future__ import annotations

from cell.errors import BackendError
from hil.emulator.interfaces import Robot
from hil.emulator.urscript.external_control import ExternalControl, read
from hil.emulator.urscript.link import Link
from hil.emulator.urscript.robot import Wait

EXTERNAL_CONTROL = "external_control.urp"
"""Name of a file that holds one node of the URCap and nothing else."""
PORT = 50002
"""Where the Client Library's script sender listens."""
_REQUEST = b"request_program\n"
_END = "# NODE_CONTROL_LOOP_ENDS"
_PATIENCE = 5.0
_MAX_TEXT = 1_000_000


class UrCap:
    """The program.

    Args:
        name: of its file. host, port: where the script is fetched.

    Attributes:
        name: as given.

    Raises:
        BackendError: the host is no address.
    """

    def __init__(self, name: str, host: str, port: int = PORT) -> None:
        self.name = name
        self._link = Link("script sender", host, port)
        self._address = f"{host}:{port}"
        self._fetching: Wait | None = None
        self._program: ExternalControl | None = None

    def start(self, robot: Robot) -> None:
        self._program = None
        self._fetching = self._fetch(robot)

    def tick(self, robot: Robot) -> bool:
        if self._program is not None:
            return self._program.tick(robot)
        assert self._fetching is not None
        return next(self._fetching, "over") is None or self._program is not None

    def stop(self, robot: Robot) -> None:
        self._link.close()
        if self._program is not None:
            self._program.stop(robot)

    def _fetch(self, robot: Robot) -> Wait:
        """Raises BackendError when no usable script comes."""
        since = robot.now
        while (outcome := self._link.connect()) is None:
            yield
        if not outcome:
            raise BackendError(f"{self.name}: nobody sends a script at {self._address}")
        self._link.send(_REQUEST)
        while _END not in (text := self._link.text()):
            if self._link.lost or robot.now - since > _PATIENCE or len(text) > _MAX_TEXT:
                raise BackendError(f"{self.name}: no whole script came from {self._address}")
            yield
        self._link.close()
        self._program = read(self.name, text)
        self._program.start(robot)
