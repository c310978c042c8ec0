"""How the parts of the emulated controller meet: plant, mover, program, and what a program sees.

One cycle of `PERIOD` is: the program runs (`Program.tick`), the mover makes the next set-point
(`MoverLike.tick`), the plant follows it (`Plant.step`), the servers send what is measured then.
Everything here happens on the controller's own thread. Poses are those of the controller: UR base
frame B, position [m] and axis-angle [rad], shape (6,), of the TCP unless said otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

import numpy as np

from cell.frames import Array

PERIOD = 0.002
"""The controller's cycle [s] (500 Hz)."""


class RobotMode(IntEnum):
    """RTDE `robot_mode`."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """RTDE `safety_mode`; `safety_status` has the same numbers up to 13."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class RuntimeState(IntEnum):
    """RTDE `runtime_state` of the program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


@dataclass
class Registers:
    """The general purpose registers, which keep their values between programs and connections."""

    in_int: list[int] = field(default_factory=lambda: [0] * 48)
    in_double: list[float] = field(default_factory=lambda: [0.0] * 48)
    in_bit: list[bool] = field(default_factory=lambda: [False] * 128)
    out_int: list[int] = field(default_factory=lambda: [0] * 48)
    out_double: list[float] = field(default_factory=lambda: [0.0] * 48)
    out_bit: list[bool] = field(default_factory=lambda: [False] * 128)
    in_int_writes: list[int] = field(default_factory=lambda: [0] * 48)
    """How often each input integer was written, for the watchdog of programs."""


@dataclass
class Io:
    """Inputs and outputs. Digital bits: 0-7 standard, 8-15 configurable, 16-17 tool."""

    digital_in: int = 0
    digital_out: int = 0
    analog_in: list[float] = field(default_factory=lambda: [0.0, 0.0])
    """Standard analogue inputs 0, 1 [V] or [A]."""
    analog_out: list[float] = field(default_factory=lambda: [0.0, 0.0])
    """Standard analogue outputs 0, 1 [V] or [A], by `analog_out_type`."""
    analog_out_type: int = 3
    """Bit per output: 0 current, 1 voltage."""
    speed_slider: float = 1.0
    """`target_speed_fraction`, 0.01..1."""
    tool_voltage: int = 0


@dataclass(frozen=True)
class Measured:
    """What the plant's joints and flange sensor report.

    Attributes:
        q, qd, effort: shape (6,) [rad], [rad/s], [Nm].
        wrench: force and torque at the TCP, axes of B, shape (6,) [N], [Nm].
    """

    q: Array
    qd: Array
    effort: Array
    wrench: Array


class Plant(Protocol):
    """The arm with its gripper, at 500 Hz. The controller's set-point is followed at once: all lag
    that a client sees comes from the controller's own `servoj` filter and the joints' dynamics."""

    def step(self, q: Array, qd: Array) -> None:
        """Let `PERIOD` pass with the joints driven towards q [rad], qd [rad/s], shape (6,)."""
        ...

    def measure(self) -> Measured:
        """As after the last step."""
        ...

    def payload(self, mass: float) -> None:
        """The controller was told another payload [kg]; only a plant that models it cares."""
        ...

    def outputs(self, digital_out: int) -> None:
        """The digital outputs changed (a lamp may hang on them)."""
        ...

    def close(self) -> None: ...


class GripperPlant(Protocol):
    """The parallel gripper behind the Robotiq socket. Called from another thread than `Plant.step`:
    implementations hand the command over and read a copy."""

    stroke: float
    """[m]"""

    def command(self, width: float, speed: float, force: float) -> None:
        """Move to a width [m] at a speed [m/s] with at most a force [N]."""
        ...

    def state(self) -> tuple[float, bool, bool]:
        """(width [m], still moving, stopped on an object)."""
        ...


class Robot(Protocol):
    """What a running program sees of the controller, and may do to it."""

    registers: Registers
    io: Io
    mover: MoverLike
    measured: Measured
    """Of the last cycle."""
    tcp: Array
    """TCP offset in the flange, position and axis-angle, shape (6,). Assign to set it."""
    payload: float
    """[kg]"""
    cog: Array
    """Centre of gravity of the payload in the flange, shape (3,) [m]."""
    gravity: Array
    """shape (3,) [m/s^2], pointing against gravity: default (0, 0, 9.82)."""
    speed_scaling: float
    """Actual ratio of this cycle, 0..1: slider times ramp, 0 in pauses and stops."""
    now: float
    """Controller time since boot [s]; RTDE `timestamp`."""

    def protective_stop(self, reason: str) -> None:
        """As `protective_stop()` in URScript: stops motion and kills the program."""
        ...

    def steady(self) -> bool:
        """As `is_steady()`: joints at rest for half a second, nothing commanded."""
        ...

    def message(self, text: str, level: int = 3) -> None:
        """Text message to the clients (0 exception, 1 error, 2 warning, 3 info) and the log."""
        ...


class MoverLike(Protocol):
    """Makes set-points. All motions start from the present set-point and its speed.

    Attributes:
        q, qd, qdd: set-point of this cycle, shape (6,) [rad], [rad/s], [rad/s^2].
        moving: a commanded motion (move, servo, speed, stop, force, freedrive) is under way.
        trouble: why the last motion cannot go on (unreachable, joint limit), empty if it can; the
            controller makes a protective stop of it.
    """

    q: Array
    qd: Array
    qdd: Array
    moving: bool
    trouble: str

    def tick(self, scaling: float, measured: Measured) -> None:
        """Make the next set-point. Moves advance at `scaling` (0..1); servo and speed commands
        are not time-scaled."""
        ...

    def halt(self) -> None:
        """Brake as hard as the controller may, on the path where there is one; then hold. Used when
        a program ends or is killed, and for stops."""
        ...

    def reset(self, q: Array) -> None:
        """At rest at measured joints [rad], shape (6,): after power on, a stop, a brake release."""
        ...


class Program(Protocol):
    """A program that the controller runs natively instead of interpreting its text.

    Attributes:
        name: as in its `def` line, or of its file.
    """

    name: str

    def start(self, robot: Robot) -> None:
        """Called once, before the first tick."""
        ...

    def tick(self, robot: Robot) -> bool:
        """One cycle; False when the program has ended by itself."""
        ...

    def stop(self, robot: Robot) -> None:
        """It is being stopped or killed, by whatever; must not block. Motion is halted by the
        controller."""
        ...


ZERO6 = np.zeros(6)
ZERO6.setflags(write=False)
