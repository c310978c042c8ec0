"""Primary, secondary and realtime interface, ports 30001-30003: state out, script text in."""

from __future__ import annotations

from collections.abc import Callable

from hil.emulator.controller import Controller
from hil.emulator.interfaces_faults import Faults
from hil.emulator.outputs import Outputs
from hil.emulator.servers import packets
from hil.emulator.servers.connection import Connection
from hil.emulator.servers.scripts import split_script, take_script

_STATE_CYCLES = 50
"""Cycles between two states: 10 Hz."""
_DATE = "12-03-2025, 00:00:00"
_EXCEPTION, _ERROR = 0, 1


class Primary:
    """State at 10 Hz and messages on 30001; the secondary interface has the state only.

    Args:
        messages: send messages, too.
    """

    def __init__(self, controller: Controller, outputs: Outputs, faults: Faults, *, messages: bool) -> None:
        self._c, self._outputs, self._faults, self._messages = controller, outputs, faults, messages
        self._cached: tuple[int, bytes] = (-1, b"")
        self._speakers: set[ScriptSpeaker] = set()
        if messages:
            controller.listeners.append(self._tell)
            controller.pendant.listeners.append(self._show)
            controller.runtime.listeners.append(self._tell_program)

    def welcome(self, connection: Connection) -> ScriptSpeaker:
        """A new client's speaker. It gets the version, then a state at once."""
        speaker = ScriptSpeaker(self._c, connection, self._state, _STATE_CYCLES, self._speakers.discard)
        self._speakers.add(speaker)
        version = self._faults.version() or self._c.version
        connection.send(packets.version_message(self._c, version, _DATE))
        connection.send(self._state())
        return speaker

    def _state(self) -> bytes:
        """Built once a cycle for all."""
        if self._cached[0] != self._c.cycles:
            self._cached = (self._c.cycles, packets.state_message(self._c, self._outputs))
        return self._cached[1]

    def _tell(self, text: str, level: int) -> None:
        if level == _EXCEPTION:
            packet = packets.exception_message(self._c, text)
        elif level == _ERROR:
            packet = packets.error_message(self._c, 0, 3, text)
        else:
            packet = packets.text_message(self._c, text)
        self._send(packet)

    def _tell_program(self, name: str, started: bool) -> None:
        title = "PROGRAM_XXX_STARTED" if started else "PROGRAM_XXX_STOPPED"
        self._send(packets.key_message(self._c, title, name))

    def _show(self, text: str) -> None:
        self._send(packets.popup_message(self._c, "Popup", text))

    def _send(self, packet: bytes) -> None:
        for speaker in self._speakers:
            speaker.send(packet)


class Realtime:
    """State in every cycle on 30003. Many clients only write here: what they leave no room for is skipped."""

    def __init__(self, controller: Controller, outputs: Outputs) -> None:
        self._c, self._outputs = controller, outputs
        self._cached: tuple[int, bytes] = (-1, b"")

    def welcome(self, connection: Connection) -> ScriptSpeaker:
        """A new client's speaker."""
        return ScriptSpeaker(self._c, connection, self._state, 1, lambda _: None)

    def _state(self) -> bytes:
        if self._cached[0] != self._c.cycles:
            self._cached = (self._c.cycles, packets.realtime_packet(self._outputs))
        return self._cached[1]


class ScriptSpeaker:
    """One client: its script text goes to the controller, a state comes every few cycles."""

    def __init__(
        self,
        controller: Controller,
        connection: Connection,
        state: Callable[[], bytes],
        every: int,
        forget: Callable[[ScriptSpeaker], None],
    ) -> None:
        self._c, self._connection, self._state, self._every = controller, connection, state, every
        self._forget = forget
        self._cycles = 0

    def split(self, buffer: bytearray, quiet: float) -> list[bytes]:
        return split_script(buffer, quiet)

    def message(self, message: bytes) -> None:
        take_script(message.decode("utf-8", "replace"), self._connection.peer, self._c)

    def cycle(self) -> None:
        self._cycles += 1
        if self._cycles % self._every == 0 and self._connection.room:
            self._connection.send(self._state())

    def send(self, packet: bytes) -> None:
        """Something besides the state."""
        self._connection.send(packet)

    def closed(self) -> None:
        self._forget(self)
