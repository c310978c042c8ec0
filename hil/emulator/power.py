"""Robot mode: booting, power and brakes, with the time each step takes."""

from __future__ import annotations

from dataclasses import dataclass

from hil.emulator.interfaces import RobotMode


@dataclass(frozen=True)
class Durations:
    """How long things take [s]. A real controller takes longer to boot and to power on.

    Attributes:
        boot, power_on, brake_release: until the next mode.
        unlock: a protective stop cannot be lifted sooner after it happened.
        program_start: from the end of an upload to its first cycle.
        brake: longest time a stop may take before the brakes are applied.
    """

    boot: float = 0.5
    power_on: float = 0.5
    brake_release: float = 0.3
    unlock: float = 5.0
    program_start: float = 0.01
    brake: float = 0.5


class Power:
    """The arm's power and brakes.

    Attributes:
        mode: present robot mode.
    """

    def __init__(self, durations: Durations) -> None:
        self._durations = durations
        self._due = durations.boot
        self._release = False
        self.mode = RobotMode.BOOTING

    @property
    def on(self) -> bool:
        """There is power on the arm."""
        return self.mode in (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING, RobotMode.BACKDRIVE)

    def power_on(self, now: float, release: bool = False) -> None:
        """Power on, if it is off. release: and then release the brakes."""
        if self.mode is RobotMode.POWER_OFF:
            self.mode, self._due, self._release = (
                RobotMode.POWER_ON,
                now + self._durations.power_on,
                release,
            )

    def brake_release(self, now: float) -> None:
        """Release the brakes; powers on first if need be."""
        self.power_on(now)
        if self.mode is RobotMode.IDLE and not self._release:
            self._due = now + self._durations.brake_release
        self._release = True

    def power_off(self) -> None:
        """At once; the brakes hold the arm."""
        self._release = False
        if self.mode is not RobotMode.BOOTING:
            self.mode = RobotMode.POWER_OFF

    def reboot(self, now: float) -> None:
        """As after the safety system was restarted: boots, then is powered off."""
        self.mode, self._due, self._release = RobotMode.BOOTING, now + self._durations.boot, False

    def tick(self, now: float) -> None:
        """Go on to the next mode when its time has come."""
        if now < self._due:
            return
        if self.mode is RobotMode.BOOTING:
            self.mode = RobotMode.POWER_OFF
        elif self.mode is RobotMode.POWER_ON:
            self.mode, self._due = RobotMode.IDLE, now + self._durations.brake_release
        elif self.mode is RobotMode.IDLE and self._release:
            self.mode, self._release = RobotMode.RUNNING, False
