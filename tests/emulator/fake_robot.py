"""A controller for mover and programs alone: cycles by hand, joints at the set-point at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cell.frames import Array
from hil.emulator.interfaces import PERIOD, ZERO6, Io, Measured, Program, Registers
from hil.emulator.models import UR3E
from hil.emulator.mover import Mover

HOME = np.array([-1.54, -1.83, -2.28, -0.59, 1.6, 0.023])


@dataclass
class FakeRobot:
    """As `hil.emulator.interfaces.Robot`. Keeps the set-points of all cycles."""

    mover: Mover = field(default_factory=lambda: Mover(UR3E))
    registers: Registers = field(default_factory=Registers)
    io: Io = field(default_factory=Io)
    tcp: Array = field(default_factory=lambda: ZERO6)
    payload: float = 0.0
    cog: Array = field(default_factory=lambda: np.zeros(3))
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, 9.82]))
    speed_scaling: float = 1.0
    now: float = 0.0
    wrench: Callable[[], Array] = lambda: ZERO6
    program: Program | None = None
    running: bool = False
    said: list[str] = field(default_factory=list)
    stops: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.mover.reset(HOME)
        self.measured = Measured(HOME, np.zeros(6), ZERO6, ZERO6)
        self.q, self.qd = [HOME.copy()], [np.zeros(6)]

    def protective_stop(self, reason: str) -> None:
        self.stops.append(reason)
        self.end()

    def steady(self) -> bool:
        return not self.mover.moving

    def message(self, text: str, level: int = 3) -> None:
        self.said.append(f"{level} {text}")

    def run(self, program: Program) -> None:
        self.program, self.running = program, True
        program.start(self)

    def end(self) -> None:
        if self.program is not None and self.running:
            self.program.stop(self)
        self.running = False
        self.mover.halt()

    def tick(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.now += PERIOD
            if self.program is not None and self.running and not self.program.tick(self):
                self.running = False
                self.mover.halt()
            self.mover.tick(self.speed_scaling, self.measured)
            if self.mover.trouble and self.running:
                self.protective_stop(self.mover.trouble)
            self.measured = Measured(self.mover.q, self.mover.qd, ZERO6, self.wrench())
            self.q.append(self.mover.q.copy())
            self.qd.append(self.mover.qd.copy())

    def until(self, condition: Callable[[], bool], limit: float = 30.0) -> float:
        """Cycle until something is true; the time it took [s]."""
        start = self.now
        while not condition():
            self.tick()
            assert self.now - start < limit, f"not within {limit} s; said {self.said[-3:]}"
        return self.now - start

    def rest(self, limit: float = 30.0) -> float:
        """Cycle until no motion is left; the time it took [s]."""
        return self.until(lambda: not self.mover.moving, limit)

    def write(self, values: list[float], command: int, *ints: int, offset: int = 0) -> None:
        """Into the registers, as a client of the control script does."""
        r = self.registers
        r.in_double[offset : offset + len(values)] = values
        for i, value in enumerate((command, *ints)):
            r.in_int[offset + i] = value
            r.in_int_writes[offset + i] += 1

    # -- what every motion must keep ------------------------------------------------------------------

    def acceleration(self) -> float:
        """Largest change of any joint's speed, per time [rad/s^2]."""
        return float(np.abs(np.diff(np.array(self.qd), axis=0)).max()) / PERIOD

    def speed(self) -> float:
        """Largest share of any joint's speed limit."""
        return float((np.abs(np.array(self.qd)) / UR3E.qd_max).max())

    def slip(self) -> float:
        """Largest difference between what the joints did in a cycle and their mean speed [rad]."""
        q, qd = np.array(self.q), np.array(self.qd)
        return float(np.abs(np.diff(q, axis=0) - 0.5 * PERIOD * (qd[1:] + qd[:-1])).max())
