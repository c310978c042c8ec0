"""Modes of external control in which every message is a set-point for the arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hil.emulator.interfaces import PERIOD
from hil.emulator.urscript.external_state import Mode, Session
from hil.emulator.urscript.robot import Wait, joints_for

_ACCELERATION = 40.0
_KEPT = 2 * PERIOD


class Setpoint:
    """What the client wants last.

    Args:
        q: where the joints are [rad].
    """

    def __init__(self, q: list[float] | None = None) -> None:
        self.q = q or [0.0] * 6
        self.speed = [0.0] * 6
        self.fresh = self.started = False

    def take(self, s: Session, values: list[float]) -> None:
        """From a message: joint angles, a pose, joint speeds or a twist, by the mode."""
        if s.mode in (Mode.SPEEDJ, Mode.SPEEDL):
            self.speed = values
            return
        q = joints_for(s.robot, values, self.q) if s.mode == Mode.POSE else values
        self.fresh = self.started = True
        if s.feasible(self.q, q, PERIOD) or s.feasible(s.robot.measured.q.tolist(), q, PERIOD):
            self.q = q


def _servo(s: Session, setpoint: Setpoint) -> Wait:
    """A cycle without a message goes on at the speed that the arm has."""
    while True:
        if setpoint.started:
            if not setpoint.fresh:
                setpoint.q = [a + PERIOD * b for a, b in zip(setpoint.q, s.mover.qd.tolist(), strict=True)]
            setpoint.fresh = False
            s.mover.servoj(setpoint.q, PERIOD, s.settings.lookahead, s.settings.gain)
        yield


def _speed_joints(s: Session, setpoint: Setpoint) -> Wait:
    while True:
        s.mover.speedj(setpoint.speed, _ACCELERATION, _KEPT)
        yield


def _speed_tool(s: Session, setpoint: Setpoint) -> Wait:
    while True:
        s.mover.speedl(setpoint.speed, _ACCELERATION, _KEPT)
        yield


MOTIONS: Mapping[int, Callable[[Session, Setpoint], Wait]] = {
    Mode.SERVOJ: _servo,
    Mode.POSE: _servo,
    Mode.SPEEDJ: _speed_joints,
    Mode.SPEEDL: _speed_tool,
}
