"""The emulated controller: one cycle, and everything that can be asked of it or done to it.

Servers read its state and call its methods; it knows none of them, and no wall time.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from cell.errors import CellError
from hil.emulator import watch
from hil.emulator.interfaces import (
    PERIOD,
    ZERO6,
    Io,
    MoverLike,
    Plant,
    Program,
    Registers,
    RobotMode,
    RuntimeState,
    SafetyMode,
)
from hil.emulator.models import Model
from hil.emulator.observed import Observed, Ratio
from hil.emulator.pendant import Pendant
from hil.emulator.power import Durations, Power
from hil.emulator.runtime import Runtime
from hil.emulator.safety import POWER_CUT, Safety, SafetyIo

_log = logging.getLogger("hil.emulator")
_LEVELS = (logging.CRITICAL, logging.ERROR, logging.WARNING, logging.INFO)
VERSION = (5, 22, 0, 1024)
"""Software version announced: major, minor, bugfix, build."""
MIN_SLIDER = 0.01
_JOINT_MODE = {RobotMode.RUNNING: 253, RobotMode.IDLE: 255, RobotMode.POWER_ON: 255}
_JOINT_OFF, _JOINT_FAULT = 239, 252


class Controller:
    """A robot's controller, as `hil.emulator.interfaces.Robot` for programs.

    Args:
        recognise: (text, peer "host:port") -> the program to run for it; raises CellError.
        find: (file name, client's host) -> the program in a file; raises CellError. None: no files.
        power_up: power on and release the brakes after booting.

    Attributes:
        model: which arm.
        remote_control: script and power commands from the network are taken.
        version: announced software version.
        execution_time: of the last cycle [s]; set by whoever runs the cycle.
        observed: what follows from the measurements.
        listeners: told (text, level) of every message.
        cycles: since boot.
    """

    def __init__(
        self,
        model: Model,
        plant: Plant,
        mover: MoverLike,
        recognise: Callable[[str, str], Program],
        *,
        durations: Durations | None = None,
        safety_io: SafetyIo | None = None,
        find: Callable[[str, str], Program] | None = None,
        power_up: bool = False,
    ) -> None:
        self._durations = durations or Durations()
        self._plant, self._recognise, self._find = plant, recognise, find
        self.model, self.mover = model, mover
        self.registers, self.io = Registers(), Io()
        self.power = Power(self._durations)
        self.safety = Safety(safety_io or SafetyIo(), self._durations.unlock)
        self.runtime = Runtime(self, self._durations.program_start)
        self.measured = plant.measure()
        self.observed, self.ratio = Observed(self.measured), Ratio()
        self.mover.reset(self.measured.q)
        self.tcp, self.payload, self.cog = ZERO6, 0.0, np.zeros(3)
        self.inertia = ZERO6
        self.gravity = np.array([0.0, 0.0, 9.82])
        self.external_wrench = ZERO6
        self.speed_scaling = 0.0
        self.now, self.cycles, self.execution_time = 0.0, 0, 0.0
        self.remote_control, self.version = True, VERSION
        self.loaded, self._loaded_for, self.pendant = "", "", Pendant()
        self.listeners: list[Callable[[str, int], None]] = []
        self._power_up = power_up
        self._safety_before, self._mode_before = self.safety.mode, self.power.mode
        self._paused_by_safeguard = False
        self._cut_at: float | None = None
        self._told_payload, self._told_outputs = self.payload, self.io.digital_out

    # -- state ------------------------------------------------------------------------------------

    @property
    def robot_mode(self) -> RobotMode:
        return self.power.mode

    @property
    def safety_mode(self) -> SafetyMode:
        return self.safety.mode

    @property
    def runtime_state(self) -> RuntimeState:
        return self.runtime.state

    @property
    def joint_mode(self) -> int:
        """RTDE `joint_mode`, the same for all joints."""
        if self.safety.mode in (SafetyMode.VIOLATION, SafetyMode.FAULT):
            return _JOINT_FAULT
        return _JOINT_MODE.get(self.power.mode, _JOINT_OFF)

    @property
    def robot_status_bits(self) -> int:
        """Bit 0 power on, 1 program running."""
        running = self.runtime.active and self.runtime.state is not RuntimeState.PAUSED
        return int(self.power.on) | int(running) << 1

    @property
    def safety_status_bits(self) -> int:
        return self.safety.bits

    def steady(self) -> bool:
        return self.observed.steady(self.now)

    # -- the cycle --------------------------------------------------------------------------------

    def tick(self) -> None:
        """Let `PERIOD` pass."""
        self.cycles += 1
        self.now = self.cycles * PERIOD
        self.safety.listen(self.io.digital_in)
        self._react()
        self._change_power()
        self._change_ratio()
        self.runtime.tick(self.ratio.held)
        if self.power.mode is RobotMode.RUNNING:
            self.mover.tick(self.ratio.motion, self.measured)
            if not self.safety.stopped:
                self._check()
            self._plant.step(self.mover.q, self.mover.qd)
        else:
            self._plant.step(self.mover.q, ZERO6)
        self.measured = self._plant.measure()
        self.observed.take(self.measured, self.mover.moving, self.now)
        self._tell_plant()

    def _change_power(self) -> None:
        if self._cut_at is not None and (self.now >= self._cut_at or not self.mover.moving):
            self._cut_at = None
            self.power.power_off()
        self.power.tick(self.now)
        mode, before = self.power.mode, self._mode_before
        if mode is before:
            return
        self._mode_before = mode
        if mode is RobotMode.RUNNING or before is RobotMode.RUNNING:
            self.mover.reset(self.measured.q)
        if mode is RobotMode.POWER_OFF and self._power_up:
            self._power_up = False
            self.power.power_on(self.now, release=True)
        self.message(f"Robot mode is {mode.name}")

    def _change_ratio(self) -> None:
        """Slider and pauses act as ramps; `speed_scaling` says 0 at once in a stop."""
        guarded = self.safety.mode is SafetyMode.SAFEGUARD_STOP
        self.ratio.tick(self.io.speed_slider, self.runtime.holding or guarded)
        stopped = self.safety.stopped and not guarded
        runs = self.power.mode is RobotMode.RUNNING and not stopped
        self.speed_scaling = self.ratio.motion if runs else 0.0

    def _check(self) -> None:
        objection = watch.objection(self.mover, self.measured, self.model)
        if objection:
            self.protective_stop(objection)
        if not bool(np.isfinite(self.mover.q).all() and np.isfinite(self.mover.qd).all()):
            self.mover.reset(self.measured.q)

    def _tell_plant(self) -> None:
        if self.payload != self._told_payload:
            self._told_payload = self.payload
            self._plant.payload(self.payload)
        if self.io.digital_out != self._told_outputs:
            self._told_outputs = self.io.digital_out
            self._plant.outputs(self.io.digital_out)

    # -- safety -----------------------------------------------------------------------------------

    def protective_stop(self, reason: str) -> None:
        """Stop motion and kill the program; see `unlock_protective_stop`."""
        if self.safety.mode is not SafetyMode.PROTECTIVE_STOP:
            self.message(f"Protective stop: {reason}", 1)
        self.safety.protective_stop(self.now, reason)
        self._react()

    def emergency_stop(self, pressed: bool) -> None:
        self.safety.button(pressed)
        self._react()

    def safeguard_stop(self, open_: bool) -> None:
        self.safety.gate(open_)
        self._react()

    def violation(self, reason: str) -> None:
        self.safety.violation(reason)
        self._react()

    def fault(self, reason: str) -> None:
        """Like a violation, but called a fault."""
        self.safety.fault(reason)
        self._react()

    def unlock_protective_stop(self) -> str:
        """Lift it; why not, or nothing. Motion needs a fresh upload."""
        was = self.safety.mode
        refusal = self.safety.unlock(self.now)
        if was is SafetyMode.PROTECTIVE_STOP and not refusal:
            self.mover.reset(self.measured.q)
        self._react()
        return refusal

    def restart_safety(self) -> None:
        """After a violation or fault: boots, and ends powered off."""
        self.runtime.stop()
        self.safety.restart()
        self.power.reboot(self.now)
        self._cut_at = None
        self._react()

    def _react(self) -> None:
        """What a change of safety mode does to program, motion and power."""
        mode, before = self.safety.mode, self._safety_before
        if mode is before:
            return
        self._safety_before = mode
        if mode in POWER_CUT or mode is SafetyMode.PROTECTIVE_STOP:
            self._paused_by_safeguard = False
            self.runtime.stop()
            self.mover.halt()
            if mode in POWER_CUT and self.power.mode is not RobotMode.BOOTING:
                self._cut_at = self.now + self._durations.brake
        elif mode is SafetyMode.SAFEGUARD_STOP:
            self._paused_by_safeguard = self.runtime.state is RuntimeState.PLAYING
            self.runtime.pause()
        elif self._paused_by_safeguard:
            self._paused_by_safeguard = False
            self.runtime.resume()
        self.message(f"Safety mode is {mode.name}", 3 if not self.safety.stopped else 2)

    # -- power ------------------------------------------------------------------------------------

    def power_on(self) -> bool:
        """False while a stop forbids it."""
        if self.safety.mode in POWER_CUT:
            return False
        self.power.power_on(self.now)
        return True

    def power_off(self) -> None:
        self.runtime.stop()
        self.mover.halt()
        self._cut_at = self.now + self._durations.brake

    def brake_release(self) -> bool:
        """Powers on first, if need be. False while a stop forbids it."""
        if self.safety.mode in POWER_CUT:
            return False
        self.power.brake_release(self.now)
        return True

    # -- programs ---------------------------------------------------------------------------------

    def upload(self, text: str, peer: str) -> bool:
        """Run this script instead of what runs now; False, and a message, if that cannot be."""
        return self._run(lambda: self._recognise(text, peer))

    def load(self, name: str, host: str) -> bool:
        """Choose the file that `play` runs, for a client at `host`; False if there is none."""
        try:
            found = self._find is not None and bool(self._find(name, host).name)
        except CellError as error:
            return self._refuse(str(error))
        if found:
            self.runtime.stop()
            self.loaded, self._loaded_for = name, host
        return found

    def play(self) -> bool:
        """Resume a paused program, or start the loaded one."""
        if self.runtime.holding and not self.safety.stopped:
            return self.runtime.resume()
        find = self._find
        return (
            bool(self.loaded) and find is not None and self._run(lambda: find(self.loaded, self._loaded_for))
        )

    def _run(self, make: Callable[[], Program]) -> bool:
        if not self.remote_control:
            return self._refuse("it is not in remote control")
        if self.power.mode is not RobotMode.RUNNING:
            return self._refuse(f"its mode is {self.power.mode.name}, RUNNING is needed")
        if self.safety.stopped:
            return self._refuse(f"its safety mode is {self.safety.mode.name}")
        try:
            self.runtime.load(make())
        except CellError as error:
            return self._refuse(str(error))
        return True

    def _refuse(self, why: str) -> bool:
        self.message(f"Program refused: {why}", 1)
        return False

    # -- terminals and messages -------------------------------------------------------------------

    def digital_input(self, bit: int, high: bool) -> None:
        """Set an input terminal. Bits 0-7 standard, 8-15 configurable, 16-17 tool."""
        self.io.digital_in = self.io.digital_in & ~(1 << bit) | int(high) << bit

    def message(self, text: str, level: int = 3) -> None:
        """Text message to the clients (0 exception, 1 error, 2 warning, 3 info) and the log."""
        _log.log(_LEVELS[max(0, min(3, level))], "%s", text)
        for listener in self.listeners:
            listener(text, level)
