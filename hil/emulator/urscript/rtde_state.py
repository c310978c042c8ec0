"""State of ur-rtde's control script: its registers, its threads, and how far an operation has come."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from hil.emulator.interfaces import Robot
from hil.emulator.mover import Mover
from hil.emulator.urscript.program import Statement
from hil.emulator.urscript.robot import Wait, mover_of

READY, DONE = 1, 2
_WRAP = 127
_RUNNING = 1 << 15
CONTACT = 254
"""The script's own command: a contact was found."""


@dataclass(frozen=True)
class Upload:
    """What differs between two uploads of the script.

    Attributes:
        first_int, first_double: of its registers, 0 or 24.
        path: injected moves, each with the progress that is signalled before it.
    """

    first_int: int
    first_double: int
    path: tuple[tuple[int | None, Statement], ...] = ()


@dataclass
class Latest:
    """What the script's threads read anew each time round."""

    servo: tuple[list[float], float, float, float] = ([0.0] * 6, 0.002, 0.1, 300.0)
    """Joint angles [rad], time [s], look-ahead time [s], gain."""
    circle: tuple[list[float], float, float] = ([0.0] * 6, 1.2, 0.25)
    """Pose, acceleration, speed."""
    speed: tuple[bool, list[float], float, float] = (True, [0.0] * 6, 0.5, 0.5)
    """In tool space, speed, acceleration, time [s]."""
    jog: tuple[list[float], float] = ([0.0] * 6, 0.5)
    """Twist in the feature, acceleration."""
    stop_linear: bool = False
    """What a stop that is waited for does: stopj at first, stopl once one was not waited for."""


@dataclass
class Script:
    """The script as it runs on a robot."""

    robot: Robot
    upload: Upload
    latest: Latest = field(default_factory=Latest)
    threads: dict[str, Wait] = field(default_factory=dict)
    internal: int = 0
    step_back: int = 0
    watchdog: Watchdog | None = None
    _writes: int = 0
    _operation: int = 0

    @property
    def mover(self) -> Mover:
        return mover_of(self.robot)

    # -- registers --------------------------------------------------------------------------------

    def int_in(self, i: int) -> int:
        return self.robot.registers.in_int[i + self.upload.first_int]

    def double_in(self, i: int) -> float:
        return self.robot.registers.in_double[i + self.upload.first_double]

    def six_in(self, first: int) -> list[float]:
        i = first + self.upload.first_double
        return self.robot.registers.in_double[i : i + 6]

    def int_out(self, i: int, value: int) -> None:
        self.robot.registers.out_int[i + self.upload.first_int] = int(value)

    def doubles_out(self, values: Sequence[float]) -> None:
        for i, value in enumerate(values):
            self.robot.registers.out_double[i + self.upload.first_double] = float(value)

    # -- threads ------------------------------------------------------------------------------------

    def kill(self, *names: str) -> None:
        for name in names:
            self.threads.pop(name, None)

    def tick_threads(self) -> None:
        """Each once; those that are over are forgotten."""
        for name, thread in list(self.threads.items()):
            if self.threads.get(name) is not thread:
                continue  # killed by one before it
            if next(thread, "over") is not None and self.threads.get(name) is thread:
                del self.threads[name]

    # -- progress of an operation that is not waited for ------------------------------------------------

    def progress(self, value: int) -> None:
        """Signal progress; 0 starts another operation, below 0 it is finished."""
        self._writes = 0 if self._writes >= _WRAP else self._writes + 1
        if value == 0:
            self._operation = 0 if self._operation >= _WRAP else self._operation + 1
        word = self._writes << 16 | self._operation << 24
        if value >= 0:
            word |= min(value, _RUNNING - 1) | _RUNNING
        self.int_out(2, word)

    def finished(self) -> None:
        self.progress(-1)

    def stop_operation(self) -> None:
        """Kill a move that nobody waits for. The arm goes on until the next command stops it."""
        if "move" in self.threads:
            self.kill("move")
            self.finished()


class Watchdog:
    """Wants an input register to be written often enough.

    Args:
        register: number. frequency: least [Hz].
    """

    def __init__(self, robot: Robot, register: int, frequency: float) -> None:
        self._register = register
        self._longest = 1.0 / frequency
        self._seen, self._at = robot.registers.in_int_writes[register], robot.now

    def expired(self, robot: Robot) -> bool:
        """Nothing was written for too long."""
        writes = robot.registers.in_int_writes[self._register]
        if writes != self._seen:
            self._seen, self._at = writes, robot.now
        return robot.now - self._at > self._longest
