"""What script functions do to the controller, shared by all kinds of programs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cell.errors import BackendError, one_of
from hil.emulator.interfaces import Robot
from hil.emulator.mover import Mover

Wait = Iterator[None]
"""Something that takes cycles: it yields once for each."""
_VOLTAGES = (0, 12, 24)
_GROUPS = {"standard": (0, 8), "configurable": (8, 8), "tool": (16, 2)}


def mover_of(robot: Robot) -> Mover:
    """The robot's mover, with the robot's TCP.

    Raises:
        BackendError: it is one of another make.
    """
    mover = robot.mover
    if not isinstance(mover, Mover):
        raise BackendError(f"script programs need the controller's own mover, got {type(mover).__name__}")
    mover.use(robot.tcp)
    return mover


def settle(mover: Mover) -> Wait:
    """Until the motion has ended."""
    while mover.busy:
        yield


def stop(mover: Mover, deceleration: float, linear: bool) -> Wait:
    """stopl or stopj, until the arm is at rest."""
    if linear:
        mover.stopl(deceleration)
    else:
        mover.stopj(deceleration)
    yield from settle(mover)


def retreat(robot: Robot, steps: int) -> Wait:
    """After a contact: stop, and back to where the tool was so many cycles ago."""
    mover = mover_of(robot)
    q = mover.memory.joints(steps)
    yield from stop(mover, 3.0, linear=True)
    mover.movel(mover.kinematics.pose(q, robot.tcp.tolist()), v=0.25, a=1.2)
    yield from settle(mover)


def joints_for(robot: Robot, pose: Sequence[float], near: Sequence[float] | None = None) -> list[float]:
    """get_inverse_kin.

    Raises:
        BackendError: out of reach.
    """
    q = mover_of(robot).ik(pose, robot.measured.q.tolist() if near is None else near)
    if q is None:
        x, y, z = pose[:3]
        raise BackendError(f"get_inverse_kin: the pose at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of reach")
    return q


def set_output(robot: Robot, group: str, n: int, high: bool) -> None:
    """A digital output of "standard", "configurable" or "tool".

    Raises:
        BackendError: there is none of this number.
    """
    first, count = _GROUPS[group]
    if not 0 <= n < count:
        raise BackendError(f"{group} digital output: {one_of(n, range(count))}")
    bit = 1 << (first + n)
    robot.io.digital_out = robot.io.digital_out | bit if high else robot.io.digital_out & ~bit


def set_payload(robot: Robot, mass: float, cog: Sequence[float] | None) -> None:
    """Mass [kg], and centre of gravity [m] unless None.

    Raises:
        BackendError: a negative mass.
    """
    if not mass >= 0.0:
        raise BackendError(f"set_payload: the mass must be at least 0 kg, got {mass:g}")
    robot.payload = mass
    if cog is not None:
        robot.cog = np.array(cog, dtype=float)


def set_tool_voltage(robot: Robot, voltage: float) -> None:
    """0, 12 or 24 V.

    Raises:
        BackendError: another voltage.
    """
    if round(voltage) not in _VOLTAGES:
        raise BackendError(f"set_tool_voltage: {one_of(voltage, _VOLTAGES)}")
    robot.io.tool_voltage = round(voltage)
