"""Dashboard, port 29999: one line asks, one line answers."""

from __future__ import annotations

import logging
from collections.abc import Callable

from cell.errors import DecodeError
from hil.emulator.controller import Controller
from hil.emulator.interfaces import RuntimeState
from hil.emulator.interfaces_faults import Faults
from hil.emulator.servers.connection import Connection

_log = logging.getLogger("hil.emulator")
_MAX_LINE = 4096
_BANNER = "Connected: Universal Robots Dashboard Server"
_DATE = "Mar 12 2025"
_MODES = ("manual", "automatic")


class Dashboard:
    """Answers commands."""

    def __init__(self, controller: Controller, faults: Faults) -> None:
        self._c, self._faults = controller, faults
        self._plain: dict[str, Callable[[], str]] = self._power() | self._programs() | self._identity()
        self._plain |= {
            "close popup": self._close_popup,
            "savelog": lambda: "Log saved to disk",
            "get operational mode": lambda: controller.pendant.operational_mode,
            "clear operational mode": self._clear_operational_mode,
            "getuserrole": lambda: "PROGRAMMER",
        }
        self._with_argument: dict[str, Callable[[str], str]] = {
            "popup": self._popup,
            "addtolog": self._add_to_log,
            "set operational mode": self._set_operational_mode,
            "setuserrole": lambda role: f"Setting user role: {role}",
        }

    def welcome(self, connection: Connection) -> DashboardSpeaker:
        """A new client's speaker."""
        return DashboardSpeaker(self, connection)

    @property
    def remote(self) -> bool:
        """As told to clients."""
        told = self._faults.remote_control()
        return self._c.remote_control if told is None else told

    def answer(self, line: str, host: str) -> str:
        """The answer to one line of a client at `host`."""
        words = line.strip()
        command = " ".join(words.lower().split())
        if command in self._plain:
            if command in self._restricted and not self.remote:
                return f'Command is not allowed in local control: "{words}"'
            return self._plain[command]()
        if command.startswith("load "):
            return self._load(words[5:].strip(), host)
        for prefix, function in self._with_argument.items():
            if command.startswith(prefix + " "):
                return function(words[len(prefix) :].strip())
        return f"could not understand: '{words}'"

    _restricted = frozenset(("power on", "power off", "brake release", "play", "restart safety"))
    """Not taken in local control."""

    # -- power and safety -------------------------------------------------------------------------

    def _power(self) -> dict[str, Callable[[], str]]:
        c = self._c
        return {
            "power on": lambda: "Powering on" if c.power_on() else _failed("power on"),
            "power off": self._power_off,
            "brake release": lambda: "Brake releasing" if c.brake_release() else _failed("brake release"),
            "unlock protective stop": lambda: c.unlock_protective_stop() or "Protective stop releasing",
            "close safety popup": lambda: "closing safety popup",
            "restart safety": self._restart_safety,
            "robotmode": lambda: f"Robotmode: {c.robot_mode.name}",
            "safetymode": lambda: f"Safetymode: {c.safety_mode.name}",
            "safetystatus": lambda: f"Safetystatus: {c.safety_mode.name}",
        }

    def _power_off(self) -> str:
        self._c.power_off()
        return "Powering off"

    def _restart_safety(self) -> str:
        self._c.restart_safety()
        return "Restarting safety"

    # -- programs ---------------------------------------------------------------------------------

    def _programs(self) -> dict[str, Callable[[], str]]:
        c = self._c
        return {
            "play": lambda: "Starting program" if c.play() else _failed("play"),
            "pause": lambda: "Pausing program" if c.runtime.pause() else _failed("pause"),
            "stop": self._stop,
            "running": lambda: f"Program running: {_said(self._runs())}",
            "programstate": self._program_state,
            "get loaded program": lambda: f"Loaded program: {c.loaded}" if c.loaded else "No program loaded",
            "isprogramsaved": lambda: f"true {self._program_name()}",
        }

    def _stop(self) -> str:
        self._c.runtime.stop()
        return "Stopped"

    def _runs(self) -> bool:
        return self._c.runtime_state in (RuntimeState.PLAYING, RuntimeState.RESUMING, RuntimeState.PAUSING)

    def _program_state(self) -> str:
        runtime = self._c.runtime
        state = "PLAYING" if self._runs() else "PAUSED" if runtime.active else "STOPPED"
        return f"{state} {self._program_name()}"

    def _program_name(self) -> str:
        runtime = self._c.runtime
        running = runtime.program.name if runtime.active and runtime.program is not None else ""
        return running or self._c.loaded or "<unnamed>"

    def _load(self, name: str, host: str) -> str:
        return f"Loading program: {name}" if self._c.load(name, host) else f"File not found: {name}"

    # -- who it is --------------------------------------------------------------------------------

    def _identity(self) -> dict[str, Callable[[], str]]:
        return {
            "polyscopeversion": self._polyscope,
            "version": lambda: ".".join(map(str, self._version())),
            "is in remote control": lambda: _said(self.remote),
            "get serial number": lambda: self._c.model.serial,
            "get robot model": lambda: self._c.model.name,
        }

    def _version(self) -> tuple[int, int, int, int]:
        return self._faults.version() or self._c.version

    def _polyscope(self) -> str:
        return f"URSoftware {'.'.join(map(str, self._version()))} ({_DATE})"

    # -- the rest ---------------------------------------------------------------------------------

    def _popup(self, text: str) -> str:
        self._c.pendant.show(text)
        return "showing popup"

    def _close_popup(self) -> str:
        self._c.pendant.close()
        return "closing popup"

    def _add_to_log(self, text: str) -> str:
        _log.info("log entry of a client: %s", text)
        return "Added log message"

    def _set_operational_mode(self, mode: str) -> str:
        if mode.lower() not in _MODES:
            return f"could not understand: 'set operational mode {mode}'"
        self._c.pendant.operational_mode = mode.upper()
        return f"Setting operational mode: {mode.upper()}"

    def _clear_operational_mode(self) -> str:
        self._c.pendant.operational_mode = "NONE"
        return "No longer controlling the operational mode"


class DashboardSpeaker:
    """One client."""

    def __init__(self, dashboard: Dashboard, connection: Connection) -> None:
        self._dashboard, self._connection = dashboard, connection
        self._say(_BANNER)

    def split(self, buffer: bytearray, quiet: float) -> list[bytes]:
        del quiet
        *lines, rest = bytes(buffer).split(b"\n")
        if len(rest) > _MAX_LINE:
            raise DecodeError(f"a dashboard command has at most {_MAX_LINE} bytes")
        buffer[:] = rest
        return [line + b"\n" for line in lines]

    def message(self, message: bytes) -> None:
        line = message.decode("utf-8", "replace").strip()
        if line in ("quit", "shutdown"):
            self._say("Disconnected" if line == "quit" else "Shutting down")
            self._connection.close(f"the client asked to {line}")
        elif line:
            self._say(self._dashboard.answer(line, self._connection.peer.rpartition(":")[0]))

    def cycle(self) -> None:
        pass

    def closed(self) -> None:
        pass

    def _say(self, line: str) -> None:
        self._connection.send(line.encode() + b"\n")


def _failed(command: str) -> str:
    return f"Failed to execute: {command}"


def _said(value: bool) -> str:
    return "true" if value else "false"
