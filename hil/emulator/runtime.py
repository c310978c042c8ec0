"""The program's life: uploaded, played, paused, resumed, stopped, killed."""

from __future__ import annotations

import logging
from collections.abc import Callable

from cell.errors import CellError
from hil.emulator.interfaces import Program, Robot, RuntimeState

_log = logging.getLogger("hil.emulator")
_LONGEST_STOP = 3.0
"""A mover that never comes to rest does not keep a program from being called stopped [s]."""
_SETTLING = 3
"""Cycles in which a move that is held has come to rest."""
_AT_REST = 1e-6
"""[rad/s]"""


class Runtime:
    """Runs at most one program, on a robot.

    Attributes:
        state: RTDE `runtime_state`.
        program: the one that runs, or ran last.
        listeners: told (name, True) when a program starts, (name, False) when it has ended.
    """

    def __init__(self, robot: Robot, start_delay: float) -> None:
        self._robot, self._start_delay = robot, start_delay
        self._next: Program | None = None
        self._start_at = 0.0
        self._stopping_since = 0.0
        self._held = 0
        """Cycles in which a pause has held motion entirely."""
        self.state = RuntimeState.STOPPED
        self.program: Program | None = None
        self.listeners: list[Callable[[str, bool], None]] = []

    @property
    def active(self) -> bool:
        """There is a program that has not ended, running or paused."""
        return self.state in (
            RuntimeState.PLAYING,
            RuntimeState.PAUSING,
            RuntimeState.PAUSED,
            RuntimeState.RESUMING,
        )

    @property
    def holding(self) -> bool:
        """Motion is to stand still on its path."""
        return self.state in (RuntimeState.PAUSING, RuntimeState.PAUSED)

    def load(self, program: Program) -> None:
        """Take the place of whatever runs, once the arm is at rest; a secondary program runs beside it."""
        if getattr(program, "secondary", False):
            self._beside(program)
            return
        self.stop()
        self._next, self._start_at = program, self._robot.now + self._start_delay

    def stop(self) -> None:
        """Stop or kill the program, and motion with it."""
        self._next = None
        if self.active:
            if self.program is not None:
                self._guarded(self.program)
            self._end()

    def pause(self) -> bool:
        """Stand still on the path; False if nothing runs."""
        if self.state in (RuntimeState.PLAYING, RuntimeState.RESUMING):
            self.state, self._held = RuntimeState.PAUSING, 0
        return self.holding

    def resume(self) -> bool:
        """Go on; False if nothing is paused."""
        if not self.holding:
            return False
        self.state = RuntimeState.RESUMING
        return True

    def tick(self, held: float) -> None:
        """One cycle.

        Args:
            held: how far motion is held back: 1 it stands still, 0 it runs free.
        """
        robot = self._robot
        if self.state is RuntimeState.STOPPING and self._rests():
            self.state = RuntimeState.STOPPED
            self._tell(False)
        if self.state is RuntimeState.STOPPED and self._next is not None and robot.now >= self._start_at:
            self.program, self._next = self._next, None
            self.state = RuntimeState.PLAYING
            self._tell(True)
            self._run(self.program, first=True)
        elif self.state is RuntimeState.PAUSING and held >= 1.0:
            self._held += 1
            if self._held >= _SETTLING and self._moves():
                robot.mover.halt()  # servo and speed commands are not slowed down by the ratio
            if self._held >= _SETTLING or not self._moves():
                self.state = RuntimeState.PAUSED
        elif self.state is RuntimeState.RESUMING and held <= 0.0:
            self.state = RuntimeState.PLAYING
        if self.state is RuntimeState.PLAYING and self.program is not None:
            self._run(self.program, first=False)

    def _run(self, program: Program, first: bool) -> None:
        """A program that fails ends; the controller does not."""
        try:
            if first:
                program.start(self._robot)
            elif not program.tick(self._robot):
                self._end()
        except Exception as error:
            if not isinstance(error, CellError):
                _log.exception("program %s failed", program.name)
            self._robot.message(f"Runtime exception in {program.name}: {error}", 0)
            self.stop()

    def _beside(self, program: Program) -> None:
        """A secondary program takes no time: it is over at once, and what else runs goes on."""
        try:
            program.start(self._robot)
            if program.tick(self._robot):
                self._robot.message(f"Secondary program {program.name} ended: it may take no time", 1)
                self._guarded(program)
        except CellError as error:
            self._robot.message(f"Runtime exception in {program.name}: {error}", 0)

    def _guarded(self, program: Program) -> None:
        try:
            program.stop(self._robot)
        except Exception:
            _log.exception("program %s did not stop in order", program.name)

    def _end(self) -> None:
        self.state, self._stopping_since = RuntimeState.STOPPING, self._robot.now
        self._robot.mover.halt()

    def _tell(self, started: bool) -> None:
        for listener in self.listeners:
            listener(self.program.name if self.program is not None else "", started)

    def _moves(self) -> bool:
        return float(abs(self._robot.mover.qd).max()) > _AT_REST

    def _rests(self) -> bool:
        if self._robot.now - self._stopping_since > _LONGEST_STOP:
            return True
        return not (self._robot.mover.moving or self._moves())
