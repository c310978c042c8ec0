"""The script command interface of external control: commands that take no time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cell.errors import BackendError
from hil.emulator.urscript import actions
from hil.emulator.urscript import robot as on
from hil.emulator.urscript.external_state import MULTIPLIER, Mode, Session, scaled

_INTEGERS = 28
_SUCCESS, _CANCELED = 0, 1
_AT_ONCE = 8


def serve(s: Session) -> None:
    """Carry out what has come; called once per cycle."""
    for _ in range(_AT_ONCE):
        message = s.command.integers(_INTEGERS)
        if message is None:
            return
        command = _COMMANDS.get(message[0])
        if command is None:
            s.robot.message(f"Script command {message[0]} is not emulated", 2)
            continue
        try:
            command(s, message[1:])
        except BackendError as error:
            s.robot.message(f"Script command {message[0]}: {error}", 1)


def contact_found(s: Session) -> None:
    """The tool touched something and is back where it did."""
    s.command.send_integer(_SUCCESS)
    s.robot.message("tool contact detected")


def _zero(s: Session, v: tuple[int, ...]) -> None:
    s.mover.memory.zero()


def _payload(s: Session, v: tuple[int, ...]) -> None:
    mass, *cog = scaled(v[:4])
    on.set_payload(s.robot, mass, cog)


def _voltage(s: Session, v: tuple[int, ...]) -> None:
    on.set_tool_voltage(s.robot, v[0] / MULTIPLIER)


def _force(s: Session, v: tuple[int, ...]) -> None:
    n = scaled(v)
    s.mover.force.damping, s.mover.force.gain = min(max(n[25], 0.0), 1.0), min(max(n[26], 0.0), 2.0)
    actions.start_force_mode(s.robot, n[0:6], n[6:12], n[12:18], n[18], n[19:25])


def _end_force(s: Session, v: tuple[int, ...]) -> None:
    s.mover.end_force_mode()


def _start_contact(s: Session, v: tuple[int, ...]) -> None:
    s.contact = True


def _end_contact(s: Session, v: tuple[int, ...]) -> None:
    if s.mode != Mode.TOOL_IN_CONTACT:
        s.command.send_integer(_CANCELED)
    s.contact = False


def _gravity(s: Session, v: tuple[int, ...]) -> None:
    s.robot.gravity = np.array(scaled(v[:3]))


def _tcp(s: Session, v: tuple[int, ...]) -> None:
    s.robot.tcp = np.array(scaled(v[:6]))


def _friction(s: Session, v: tuple[int, ...]) -> None:
    """Only torque control uses it, which this software version does not have."""


def _external_sensor(s: Session, v: tuple[int, ...]) -> None:
    if v[0]:
        s.robot.message("An external force sensor is not emulated; the robot's own goes on to be used", 2)


_COMMANDS: dict[int, Callable[[Session, tuple[int, ...]], None]] = {
    0: _zero,
    1: _payload,
    2: _voltage,
    3: _force,
    4: _end_force,
    5: _start_contact,
    6: _end_contact,
    7: _friction,
    8: _external_sensor,
    9: _gravity,
    10: _tcp,
    11: _friction,
    12: _payload,
}
