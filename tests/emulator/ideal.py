"""A tiny arm, mover and program: all that the controller's own tests need."""

from __future__ import annotations

import numpy as np

from cell.errors import DecodeError
from cell.frames import Array
from hil.emulator.interfaces import PERIOD, ZERO6, Measured, Robot
from hil.emulator.power import Durations

HOME = np.array([0.0, -1.6, -1.6, -1.6, 1.6, 0.0])
QUICK = Durations(boot=0.01, power_on=0.01, brake_release=0.01, brake=0.1)
BRAKING = 20.0
"""[rad/s^2]"""


class IdealPlant:
    """At the set-point at once."""

    def __init__(self) -> None:
        self.q, self.qd, self.wrench = HOME.copy(), np.zeros(6), ZERO6
        self.masses: list[float] = []
        self.lamps: list[int] = []
        self.closed = False
        self.blocked = False
        """The arm does not follow."""

    def step(self, q: Array, qd: Array) -> None:
        if not self.blocked:
            self.q, self.qd = q.copy(), qd.copy()

    def measure(self) -> Measured:
        return Measured(self.q, self.qd, ZERO6, self.wrench)

    def payload(self, mass: float) -> None:
        self.masses.append(mass)

    def outputs(self, digital_out: int) -> None:
        self.lamps.append(digital_out)

    def close(self) -> None:
        self.closed = True


class IdealMover:
    """Joint speeds that are scaled like a move (`jog`), or not at all (`push`)."""

    def __init__(self) -> None:
        self.q, self.qd, self.qdd = HOME.copy(), np.zeros(6), np.zeros(6)
        self.moving, self.trouble = False, ""
        self._wanted, self._scaled, self._halting = np.zeros(6), True, False

    def jog(self, qd: Array) -> None:
        self._wanted, self._scaled, self.moving, self._halting = np.array(qd, float), True, True, False

    def push(self, qd: Array) -> None:
        self.jog(qd)
        self._scaled = False

    def tick(self, scaling: float, measured: Measured) -> None:
        if self._halting:
            step = BRAKING * PERIOD
            self.qd = np.sign(self.qd) * np.maximum(0.0, np.abs(self.qd) - step)
            self.moving = self._halting = bool(np.any(self.qd))
        elif self.moving:
            self.qd = self._wanted * (scaling if self._scaled else 1.0)
        self.q = self.q + self.qd * PERIOD

    def halt(self) -> None:
        self._halting = bool(np.any(self.qd))
        self.moving = self._halting

    def reset(self, q: Array) -> None:
        self.q, self.qd = q.copy(), np.zeros(6)
        self.moving = self._halting = False
        self.trouble = ""


class Sweep:
    """Turns joint 1 until told otherwise; "def count" counts in an output register besides."""

    def __init__(self, text: str) -> None:
        self.name = text.split()[1].split("(")[0]
        self.stopped = False
        self.ticks = 0

    def start(self, robot: Robot) -> None:
        if self.name == "sweep":
            robot.mover.jog(np.array([0.5, 0, 0, 0, 0, 0]))  # type: ignore[attr-defined]

    def tick(self, robot: Robot) -> bool:
        self.ticks += 1
        robot.registers.out_int[0] = self.ticks
        if self.name == "fails":
            raise RuntimeError("division by zero")
        return self.name != "short" or self.ticks < 5

    def stop(self, robot: Robot) -> None:
        del robot
        self.stopped = True


def recognise(text: str, peer: str) -> Sweep:
    del peer
    if not text.startswith("def ") or not text.rstrip().endswith("end"):
        raise DecodeError("this text is no program that can be run here")
    return Sweep(text)


SWEEP = "def sweep():\n  speedj([0.5,0,0,0,0,0])\nend\n"
