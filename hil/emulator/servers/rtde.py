"""Real-Time Data Exchange, port 30004: recipes, data packets at each client's rate, inputs."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence

from cell.errors import DecodeError
from hil.emulator.controller import Controller
from hil.emulator.inputs import Inputs
from hil.emulator.interfaces import PERIOD
from hil.emulator.interfaces_faults import Faults
from hil.emulator.outputs import Getter, Outputs
from hil.emulator.servers.connection import Connection
from hil.rtde import codec
from hil.rtde.codec import Kind, Layout, Value
from hil.rtde.fields import IN_USE, NOT_FOUND, FieldType, fields

_log = logging.getLogger("hil.emulator")
_MAX_RATE = 1.0 / PERIOD
_MAX_RECIPES = 255
_SOURCE = "Controller"
_ERROR = 1


class RtdeServer:
    """What the connections share: values, and who owns which input."""

    def __init__(self, controller: Controller, outputs: Outputs, faults: Faults) -> None:
        self.controller, self.faults = controller, faults
        self.getters = outputs.getters
        self.inputs = Inputs(controller)
        self._owners: dict[str, RtdeSpeaker] = {}
        self._speakers: set[RtdeSpeaker] = set()
        controller.listeners.append(self._tell)

    def welcome(self, connection: Connection) -> RtdeSpeaker:
        """A new client's speaker."""
        speaker = RtdeSpeaker(self, connection)
        self._speakers.add(speaker)
        return speaker

    @property
    def version(self) -> tuple[int, int, int, int]:
        """As announced."""
        return self.faults.version() or self.controller.version

    def input_type(self, name: str, asker: RtdeSpeaker) -> str:
        """Type of an input, or why the asker cannot have it."""
        field = fields().get(name)
        if field is None or not field.input:
            return NOT_FOUND
        if self._owners.get(name, asker) is not asker or self.faults.in_use(name):
            return IN_USE
        return field.type

    def output_type(self, name: str) -> str:
        """Type of an output, or why there is none."""
        if name not in self.getters or fields()[name].since > self.version[:2]:
            return NOT_FOUND
        return fields()[name].type

    def own(self, names: Sequence[str], owner: RtdeSpeaker) -> None:
        """These inputs belong to it until it disconnects."""
        for name in names:
            self._owners[name] = owner

    def forget(self, speaker: RtdeSpeaker) -> None:
        """A client is gone; its inputs are free, and keep their values."""
        self._speakers.discard(speaker)
        self._owners = {name: owner for name, owner in self._owners.items() if owner is not speaker}

    def _tell(self, text: str, level: int) -> None:
        """Errors, to those who receive data: during its set-up a client expects answers, and later data."""
        for speaker in self._speakers:
            if speaker.started and level <= _ERROR:
                speaker.tell(text, level)


class RtdeSpeaker:
    """One client.

    Attributes:
        started: it gets data packets.
    """

    def __init__(self, server: RtdeServer, connection: Connection) -> None:
        self._server, self._connection = server, connection
        self.started = False
        self._layout: Layout | None = None
        self._getters: list[Getter] = []
        self._share = 1.0
        """Of the cycles in which this client gets a packet."""
        self._phase = 0.0
        self._takers: list[tuple[Layout, Callable[[Sequence[Value]], None]]] = []
        self._answers: dict[int, Callable[[bytes], bytes]] = {
            Kind.VERSION: self._accept_version,
            Kind.CONTROLLER_VERSION: lambda _: codec.encode_version(server.version),
            Kind.OUTPUTS: self._set_outputs,
            Kind.INPUTS: self._set_inputs,
            Kind.START: self._start,
            Kind.PAUSE: self._pause,
        }

    def split(self, buffer: bytearray, quiet: float) -> list[bytes]:
        del quiet
        return [codec.frame(kind, payload) for kind, payload in codec.take_frames(buffer)]

    def message(self, message: bytes) -> None:
        frames = codec.take_frames(bytearray(message))
        if not frames:
            raise DecodeError("RTDE: a frame was cut short")
        for kind, payload in frames:
            if kind == Kind.DATA:
                self._take(payload)
            elif kind == Kind.TEXT:
                text, source, _ = codec.decode_text(payload)
                _log.info("RTDE client %s says: %s (%s)", self._connection.peer, text, source)
            elif kind in self._answers:
                self._connection.send(codec.frame(kind, self._answers[kind](payload)))
            else:
                self.tell(f"RTDE knows no package of type {kind}", 1)

    def cycle(self) -> None:
        """Send a packet if it is due. At most one: what a late cycle missed is not made up for."""
        if not self.started or self._layout is None:
            return
        self._phase += self._share
        if self._phase < 1.0 - 1e-9:
            return
        self._phase = max(0.0, self._phase - 1.0)
        values: list[float] = []
        for getter in self._getters:
            values += getter()
        self._connection.send(self._layout.packet(1, values))

    def closed(self) -> None:
        self._server.forget(self)

    def tell(self, text: str, level: int) -> None:
        """A text message to this client."""
        self._connection.send(codec.frame(Kind.TEXT, codec.encode_text(text, _SOURCE, level)))

    # -- requests ---------------------------------------------------------------------------------

    def _accept_version(self, payload: bytes) -> bytes:
        accepted = payload == codec.PROTOCOL.to_bytes(2, "big")
        if not accepted:
            self.tell(f"RTDE: only protocol version {codec.PROTOCOL} is spoken here", 1)
        return bytes([accepted])

    def _set_outputs(self, payload: bytes) -> bytes:
        """A new output recipe takes the place of the old one; packets wait for the next start."""
        rate, names = codec.decode_outputs(payload)
        types = [self._server.output_type(name) for name in names]
        if not names or NOT_FOUND in types or not (math.isfinite(rate) and rate > 0.0):
            return codec.encode_recipe(0, types)
        self.started = False
        self._layout = Layout([FieldType(kind) for kind in types])
        self._getters = [self._server.getters[name] for name in names]
        self._share = min(rate, _MAX_RATE) / _MAX_RATE
        self._phase = 1.0 - self._share
        return codec.encode_recipe(1, types)

    def _set_inputs(self, payload: bytes) -> bytes:
        names = codec.decode_names(payload)
        types = [self._server.input_type(name, self) for name in names]
        if not names or NOT_FOUND in types or IN_USE in types or len(self._takers) >= _MAX_RECIPES:
            return codec.encode_recipe(0, types)
        self._server.own(names, self)
        self._takers.append((Layout([FieldType(kind) for kind in types]), self._server.inputs.taker(names)))
        return codec.encode_recipe(len(self._takers), types)

    def _start(self, payload: bytes) -> bytes:
        del payload
        self.started = self._layout is not None
        return bytes([self.started or bool(self._takers)])

    def _pause(self, payload: bytes) -> bytes:
        del payload
        self.started = False
        return b"\x01"

    def _take(self, payload: bytes) -> None:
        """Inputs are taken before the start, too; there is no answer."""
        number = payload[0] if payload else 0
        if not 1 <= number <= len(self._takers):
            self.tell(f"RTDE: there is no input recipe {number}", 1)
            return
        layout, take = self._takers[number - 1]
        take(layout.unpack(payload[1:]))
