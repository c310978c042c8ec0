"""A small blocking RTDE client: who answers, and what it reports. It commands nothing."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from cell.clock import Clock, WallClock
from cell.errors import BackendError, DecodeError
from hil.rtde import codec
from hil.rtde.codec import Kind, Layout, Value
from hil.rtde.fields import IN_USE, NOT_FOUND, FieldType

PORT = 30004
_CHUNK = 65_536


class RtdeClient:
    """A connection; use it as a context manager.

    Args:
        timeout: for connecting and for each answer [s].

    Raises:
        BackendError: nobody answers there, or not in this protocol.
    """

    def __init__(self, host: str, port: int = PORT, timeout: float = 2.0, clock: Clock | None = None) -> None:
        self._where, self._timeout = f"{host}:{port}", timeout
        self._clock: Clock = clock or WallClock()
        self._buffer = bytearray()
        self._frames: list[tuple[int, bytes]] = []
        self._names: tuple[str, ...] = ()
        self._layout: Layout | None = None
        self._input_layouts: list[Layout] = []
        try:
            self._socket = socket.create_connection((host, port), timeout)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise BackendError(f"no robot answers at {self._where} ({error.strerror or error})") from None
        try:
            accepted = self._ask(Kind.VERSION, codec.PROTOCOL.to_bytes(2, "big")) == b"\x01"
            if not accepted:
                raise BackendError(f"{self._where} does not speak RTDE protocol version {codec.PROTOCOL}")
        except BackendError:
            self.close()
            raise

    def version(self) -> tuple[int, int, int, int]:
        """Controller software: major, minor, bugfix, build."""
        return codec.decode_version(self._ask(Kind.CONTROLLER_VERSION))

    def subscribe(self, names: Sequence[str], rate: float = 125.0) -> None:
        """Have these outputs sent from now on. rate: [Hz].

        Raises:
            BackendError: the controller does not know one of them.
        """
        number, types = codec.decode_recipe(self._ask(Kind.OUTPUTS, codec.encode_outputs(rate, names)))
        self._layout = Layout(self._types(number, names, types))
        self._names = tuple(names)
        if self._ask(Kind.START) != b"\x01":
            raise BackendError(f"{self._where} refuses to start sending")

    def read(self) -> dict[str, Value]:
        """The next data packet.

        Raises:
            BackendError: none came in time.
        """
        if self._layout is None:
            raise BackendError("subscribe first")
        payload = self._next(Kind.DATA)
        return dict(zip(self._names, self._layout.unpack(payload[1:]), strict=False))

    def claim(self, names: Sequence[str]) -> int:
        """Become the one who writes these inputs; the recipe's number.

        Raises:
            BackendError: the controller does not know one of them, or somebody else writes it.
        """
        number, types = codec.decode_recipe(self._ask(Kind.INPUTS, codec.encode_names(names)))
        self._input_layouts.append(Layout(self._types(number, names, types)))
        return number

    def write(self, number: int, values: Sequence[float]) -> None:
        """Send the inputs of a recipe, vectors flattened. There is no answer."""
        self._send(self._input_layouts[number - 1].packet(number, values))

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # -- internals --------------------------------------------------------------------------------

    def _types(self, number: int, names: Sequence[str], types: Sequence[str]) -> list[FieldType]:
        wrong = [f"{name} {kind}" for name, kind in zip(names, types, strict=False) if kind in _WRONG]
        if number == 0 or len(types) != len(names) or wrong:
            raise BackendError(f"{self._where} refuses these fields: {', '.join(wrong) or 'no reason given'}")
        try:
            return [FieldType(kind) for kind in types]
        except ValueError as error:
            raise BackendError(f"{self._where} answers with an unknown type: {error}") from None

    def _ask(self, kind: Kind, payload: bytes = b"") -> bytes:
        self._send(codec.frame(kind, payload))
        return self._next(kind)

    def _send(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise BackendError(f"{self._where} is gone ({error.strerror or error})") from None

    def _next(self, wanted: Kind) -> bytes:
        """The next frame of a kind; others before it are dropped."""
        end = self._clock.now() + self._timeout
        while True:
            while self._frames:
                kind, payload = self._frames.pop(0)
                if kind == wanted:
                    return payload
            left = end - self._clock.now()
            if left <= 0.0:
                raise BackendError(f"{self._where} does not answer in RTDE within {self._timeout:g} s")
            self._receive(left)

    def _receive(self, patience: float) -> None:
        self._socket.settimeout(patience)
        try:
            data = self._socket.recv(_CHUNK)
        except TimeoutError:
            return
        except OSError as error:
            raise BackendError(f"{self._where} is gone ({error.strerror or error})") from None
        if not data:
            raise BackendError(f"{self._where} closed the connection")
        self._buffer += data
        try:
            self._frames = codec.take_frames(self._buffer)
        except DecodeError as error:
            raise BackendError(f"{self._where} does not speak RTDE: {error}") from None


_WRONG = (NOT_FOUND, IN_USE)
