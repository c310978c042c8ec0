"""Safety mode of the emulated controller: what stopped it, and what must be done to go on.

This imitates how a controller reports stops. It protects nobody.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.emulator.interfaces import SafetyMode

_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.REDUCED: 1 << 1,
    SafetyMode.PROTECTIVE_STOP: 1 << 2,
    SafetyMode.RECOVERY: 1 << 3,
    SafetyMode.SAFEGUARD_STOP: 1 << 4,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 1 << 5 | 1 << 7,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7,
    SafetyMode.VIOLATION: 1 << 8,
    SafetyMode.FAULT: 1 << 9,
}
_STOPPED = 1 << 10
_GOES_ON = (SafetyMode.NORMAL, SafetyMode.REDUCED, SafetyMode.RECOVERY)
POWER_CUT = (
    SafetyMode.SYSTEM_EMERGENCY_STOP,
    SafetyMode.ROBOT_EMERGENCY_STOP,
    SafetyMode.VIOLATION,
    SafetyMode.FAULT,
)
"""Stops that end powered off."""


@dataclass(frozen=True)
class SafetyIo:
    """Which digital inputs are safety inputs (bits 8-15 are the configurable terminals).

    Attributes:
        emergency: system emergency stop while one of these is low.
        safeguard: safeguard stop while one of these is low.
        reset: with a reset input a safeguard stop stays until a rising edge on it while the
            safeguard is closed; without one (None) it ends by itself.
        reduced: reduced mode while one of these is low.
    """

    emergency: tuple[int, ...] = ()
    safeguard: tuple[int, ...] = ()
    reset: int | None = None
    reduced: tuple[int, ...] = ()


class Safety:
    """Everything that may stop the arm.

    Attributes:
        mode: the gravest of what is the case.
        reason: of the last protective stop, violation or fault.
    """

    def __init__(self, inputs: SafetyIo, unlock_after: float) -> None:
        self._inputs, self._unlock_after = inputs, unlock_after
        self._button = self._terminal = False
        self._gate = False
        """Opened by `safeguard`, not by a terminal."""
        self._safeguard = self._reduced = False
        self._reset_was_high = True
        self._violated = self._faulted = False
        self._protective_since: float | None = None
        self.mode = SafetyMode.NORMAL
        self.reason = ""

    @property
    def bits(self) -> int:
        """RTDE `safety_status_bits`."""
        return _BITS[self.mode] | (0 if self.mode in _GOES_ON else _STOPPED)

    @property
    def stopped(self) -> bool:
        return self.mode not in _GOES_ON

    # -- causes -------------------------------------------------------------------------------------

    def button(self, pressed: bool) -> None:
        """Emergency stop button on the pendant."""
        self._button = pressed
        self._judge()

    def gate(self, open_: bool) -> None:
        """Safeguard, as if by a terminal."""
        self._gate = open_
        self._safeguard = self._safeguard or open_
        self._judge()

    def protective_stop(self, now: float, reason: str) -> None:
        """Latched until `unlock`; a new one while latched starts its time again."""
        self._protective_since, self.reason = now, reason
        self._judge()

    def violation(self, reason: str) -> None:
        """Latched until `restart`."""
        self._violated, self.reason = True, reason
        self._judge()

    def fault(self, reason: str) -> None:
        """Latched until `restart`."""
        self._faulted, self.reason = True, reason
        self._judge()

    def listen(self, digital_in: int) -> None:
        """Look at the terminals; once a cycle."""
        low = ~digital_in
        inputs = self._inputs
        self._terminal = any(low >> bit & 1 for bit in inputs.emergency)
        self._reduced = any(low >> bit & 1 for bit in inputs.reduced)
        opened = self._gate or any(low >> bit & 1 for bit in inputs.safeguard)
        if inputs.reset is None:
            self._safeguard = opened
        else:
            high = bool(digital_in >> inputs.reset & 1)
            rose, self._reset_was_high = high and not self._reset_was_high, high
            self._safeguard = opened or (self._safeguard and not rose)
        self._judge()

    # -- recovery -----------------------------------------------------------------------------------

    def unlock(self, now: float) -> str:
        """Lift a protective stop; why not, or nothing if it is lifted or there was none."""
        if self._protective_since is None:
            return ""
        if now - self._protective_since < self._unlock_after:
            return (
                f"Cannot unlock protective stop until {self._unlock_after:.0f}s after occurrence. "
                "Always inspect cause of protective stop before unlocking"
            )
        self._protective_since = None
        self._judge()
        return ""

    def restart(self) -> None:
        """Restart the safety system: lifts violation, fault and protective stop."""
        self._violated = self._faulted = False
        self._protective_since = None
        self._judge()

    def _judge(self) -> None:
        causes = (
            (self._faulted, SafetyMode.FAULT),
            (self._violated, SafetyMode.VIOLATION),
            (self._button, SafetyMode.ROBOT_EMERGENCY_STOP),
            (self._terminal, SafetyMode.SYSTEM_EMERGENCY_STOP),
            (self._protective_since is not None, SafetyMode.PROTECTIVE_STOP),
            (self._safeguard, SafetyMode.SAFEGUARD_STOP),
            (self._reduced, SafetyMode.REDUCED),
        )
        self.mode = next((mode for is_so, mode in causes if is_so), SafetyMode.NORMAL)
