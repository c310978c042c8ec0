"""ur-rtde's control script, run natively: commands in registers, answers in registers.

The script itself is recognised by its first line and not interpreted; only what differs between two
uploads is read from it, the offsets of its registers and the moves of a path.
"""

from __future__ import annotations

import re

from cell.errors import BackendError
from hil.emulator.interfaces import Robot
from hil.emulator.urscript.program import Statement, statement
from hil.emulator.urscript.robot import Wait
from hil.emulator.urscript.rtde_answers import ANSWERS
from hil.emulator.urscript.rtde_motion import MOTION
from hil.emulator.urscript.rtde_state import DONE, READY, Script, Upload

HEAD = re.compile(r"^def rtde_control\(\):\s*$", re.MULTILINE)
_OFFSETS = (0, 24)
_STOP = 255
_SERVED_AT_ONCE = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""The script's own list: carried out in every cycle, and ready again at once."""
_SIGNAL = re.compile(r"^signal_async_progress\((\d{1,6})\)$")
_COMMANDS = {**MOTION, **ANSWERS}
"""Ids that are missing here do nothing in the script either, but count as done."""


class RtdeControl:
    """The program.

    Attributes:
        name: of its `def` line.
        upload: what this upload has of its own.
    """

    name = "rtde_control"

    def __init__(self, upload: Upload) -> None:
        self.upload = upload
        self._script: Script | None = None
        self._main: Wait | None = None

    def start(self, robot: Robot) -> None:
        script = Script(robot, self.upload)
        self._script, self._main = script, _loop(script)
        force = script.mover.force
        force.gain, force.damping = 0.5, 0.025
        script.finished()
        script.int_out(0, READY)

    def tick(self, robot: Robot) -> bool:
        assert self._script is not None and self._main is not None
        watchdog = self._script.watchdog
        if watchdog is not None and watchdog.expired(robot):
            robot.message("RTDE watchdog: the input register was not written in time; the program stops", 1)
            return False
        if next(self._main, "over") is not None:
            return False
        self._script.tick_threads()
        return True

    def stop(self, robot: Robot) -> None:
        pass


def _loop(s: Script) -> Wait:
    executed = False
    while True:
        command = s.int_in(0)
        if command == 0:
            command, s.internal = s.internal, 0
        if command in _SERVED_AT_ONCE:
            yield from _carry_out(s, command)
            s.int_out(0, READY)
        elif command == 0:
            executed = False
            s.int_out(0, READY)
        elif not executed:
            if command == _STOP:
                return
            yield from _carry_out(s, command)
            s.int_out(0, DONE)
            executed = True
        yield


def _carry_out(s: Script, command: int) -> Wait:
    function = _COMMANDS.get(command)
    if function is not None and (waiting := function(s)) is not None:
        yield from waiting


def read(text: str) -> RtdeControl:
    """The program of an uploaded script.

    Raises:
        BackendError: it is not as ur-rtde 1.6 writes it.
    """
    return RtdeControl(Upload(_offset(text, "int"), _offset(text, "float"), tuple(_path(text))))


def _offset(text: str, kind: str) -> int:
    found = re.search(rf"# {kind} register offset\s*\n\s*(\d+)", text)
    if not found or int(found[1]) not in _OFFSETS:
        raise BackendError(
            f"rtde_control: no {kind} register offset of 0 or 24 in the script; ur-rtde 1.6 writes it "
            f"behind the comment '# {kind} register offset'"
        )
    return int(found[1])


def _path(text: str) -> list[tuple[int | None, Statement]]:
    """Moves between the comment and the end of its function."""
    out: list[tuple[int | None, Statement]] = []
    progress: int | None = None
    lines = iter(text.partition("# inject move path")[2].splitlines())
    for line in map(str.strip, lines):
        if line == "end":
            break
        if not line:
            continue
        if signal := _SIGNAL.match(line):
            progress = int(signal[1])
            continue
        move = statement(line)
        if not move.move:
            raise BackendError(f"rtde_control: {line[:80]!r} in its path is no movej, movel or movep")
        out.append((progress, move))
        progress = None
    return out
