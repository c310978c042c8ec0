"""Following a run of waypoints: movej, movel, movep, movec, and braking on their path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic

import numpy as np

from cell.frames import Array
from hil.emulator.kinematics import Kinematics, error, length, tool_speed
from hil.emulator.motion import DT, HARD, Step, Trouble
from hil.emulator.motion.path import Run, T
from hil.emulator.poses import Frame

_ROUNDS = 6
_CLOSE = 1e-5
"""A Newton step from this close is exact to rounding [m], [rad]."""
_AT_REST = 1e-9
_BLUNT = 1e-3
_FAR = 0.2
"""A joint that has to jump this far within a cycle is at a singularity [rad]."""
_TRIES = 4
_MARGIN = 0.9995
"""Of the joints' limits, where the path's speed is adjusted to them."""


class Move(Generic[T]):
    """Follows one run by a clock of its own, slowed down by the speed slider, a brake and the joints' limits.

    Args:
        tool: TCP in the flange.

    Attributes:
        leg: number of the leg under way; the next one counts from the start of its corner.
    """

    checked: bool
    linear: bool

    def __init__(self, kinematics: Kinematics, run: Run[T], tool: Frame) -> None:
        self._kinematics, self._run, self._tool = kinematics, run, tool
        self.leg = self._part = 0
        self._t = self._rate = 0.0
        self._s = self._speed = 0.0
        self._brake: float | None = None
        self._hard = False

    @property
    def acceleration(self) -> float:
        """Of its last leg, of path."""
        return self._run.acceleration

    def brake(self, deceleration: float | None) -> None:
        """Stop on the path, with a deceleration of path, or as hard as the joints may (None)."""
        self._hard = self._hard or deceleration is None
        self._brake = max(self._brake or 0.0, deceleration or 0.0)

    def per_length(self, q: Sequence[float], linear: bool) -> float:
        """Leading joint angle [rad], or with `linear` way of the TCP [m], per path length, here."""
        if linear == self.linear:
            return 1.0
        _, rate = self._at(self._s)
        _, J = self._kinematics.jacobian(q, self._tool)
        return length(tool_speed(J, rate)) if linear else max(abs(v) for v in solved(J, rate)[0])

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        rate = scaling if self._brake is None else self._braked(qd, scaling)
        t, before, part = self._t, self._rate, self._part
        out = self._moved(rate, q, qd)
        for _ in range(_TRIES):
            over = max(abs(v) / m for v, m in zip(out[1], self._kinematics.qd_max, strict=True))
            if over <= 1.0:
                break
            rate *= _MARGIN / over
            self._t, self._rate, self._part = t, before, part
            out = self._moved(rate, q, qd)
        return out

    def _moved(self, rate: float, q: list[float], qd: list[float]) -> Step:
        """After another cycle, at the end of which the clock runs at `rate`."""
        self._t += 0.5 * DT * (self._rate + rate)
        self._rate = rate
        self._s, speed = self._run.law.at(self._t)
        self._speed = speed * rate
        parts = self._run.parts
        while self._part + 1 < len(parts) and parts[self._part + 1].start <= self._s:
            self._part += 1
        self.leg = parts[self._part].leg
        if self._t >= self._run.law.duration:
            return *self._joints(self._run.end, [0.0] * 6, q, qd), False
        place, change = self._at(self._s)
        going = self._brake is None or self._speed > _AT_REST
        return *self._joints(place, [self._speed * c for c in change], q, qd), going

    def _joints(
        self, place: T, change: list[float], q: list[float], qd: list[float]
    ) -> tuple[list[float], list[float]]:
        """Joint angles and speeds for a place and its change [1/s], near the last ones."""
        raise NotImplementedError

    def _braked(self, qd: list[float], scaling: float) -> float:
        """How fast the clock runs in the next cycle so that the path speed falls as it shall."""
        b = self._brake or 0.0
        if self._hard:
            sharpest = max(abs(v) for v in qd) / self._speed if self._speed > _AT_REST else 1.0
            b = max(b, HARD / max(sharpest, _BLUNT))
        wanted = self._speed - b * DT
        if wanted <= 0.0:
            return 0.0
        rate = self._rate
        for _ in range(2):  # the speed that the law has then depends on the rate
            _, speed = self._run.law.at(self._t + 0.5 * DT * (self._rate + rate))
            rate = min(self._rate, scaling, wanted / speed) if speed > 0.0 else 0.0
        return rate

    def _at(self, s: float) -> tuple[T, list[float]]:
        part = self._run.parts[self._part]
        return part.piece.at(max(s - part.start, 0.0) + part.offset)


class JointMove(Move[list[float]]):
    """movej."""

    checked = True
    linear = False

    def _joints(
        self, place: list[float], change: list[float], q: list[float], qd: list[float]
    ) -> tuple[list[float], list[float]]:
        return list(place), change


class ToolMove(Move[Frame]):
    """movel, movep and movec."""

    checked = False
    linear = True

    def _joints(
        self, place: Frame, change: list[float], q: list[float], qd: list[float]
    ) -> tuple[list[float], list[float]]:
        guess = [a + DT * b for a, b in zip(q, qd, strict=True)]
        for _ in range(_ROUNDS):
            at, J = self._kinematics.jacobian(guess, self._tool)
            off = error(place, at)
            jump, speed = solved(J, off, change)
            if not max(abs(v) for v in jump) < _FAR:
                raise Trouble("the path runs through a singularity of the arm")
            guess = [a + b for a, b in zip(guess, jump, strict=True)]
            if max(abs(v) for v in off) < _CLOSE:
                return guess, speed
        raise Trouble("the path leaves the arm's reach")


def solved(J: Array, *twists: Sequence[float]) -> list[list[float]]:
    """Joint speeds (6,) [rad/s] that make each of these twists.

    Raises:
        Trouble: at a singularity.
    """
    try:
        out: list[list[float]] = np.linalg.solve(J, np.array(twists).T).T.tolist()
    except np.linalg.LinAlgError:
        raise Trouble("the arm is in a singularity") from None
    return out
