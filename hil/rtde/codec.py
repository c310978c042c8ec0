"""Real-Time Data Exchange, protocol version 2: frames, messages and data packets as bytes.

A frame is: uint16 size with these three bytes, uint8 kind, payload; everything is big endian.
Source: Universal Robots, "Real-Time Data Exchange (RTDE) guide".
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import IntEnum

from cell.errors import DecodeError
from hil.rtde.fields import FORMATS, FieldType

PROTOCOL = 2
_HEADER = struct.Struct(">HB")
MAX_FRAME = 0xFFFF
_MAX_NAMES = 512
"""Fields in one recipe; there are some 420 in all."""
_MAX_TEXT = 255

Value = bool | int | float | tuple[float, ...] | tuple[int, ...]


class Kind(IntEnum):
    """Kinds of frames."""

    VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


def frame(kind: int, payload: bytes = b"") -> bytes:
    """One frame.

    Raises:
        ValueError: the payload is too long for one.
    """
    size = _HEADER.size + len(payload)
    if size > MAX_FRAME:
        raise ValueError(f"a frame holds at most {MAX_FRAME} bytes, this one has {size}")
    return _HEADER.pack(size, kind) + payload


def take_frames(buffer: bytearray) -> list[tuple[int, bytes]]:
    """Take the whole frames off the front of a buffer, as (kind, payload).

    Raises:
        DecodeError: this is no stream of frames.
    """
    taken, at = [], 0
    while len(buffer) - at >= _HEADER.size:
        size, kind = _HEADER.unpack_from(buffer, at)
        if size < _HEADER.size:
            raise DecodeError(f"RTDE frame: its size must be at least {_HEADER.size}, it says {size}")
        if len(buffer) - at < size:
            break
        taken.append((kind, bytes(buffer[at + _HEADER.size : at + size])))
        at += size
    del buffer[:at]
    return taken


# -- names and small answers --------------------------------------------------------------------


def encode_names(names: Sequence[str]) -> bytes:
    return ",".join(names).encode("ascii")


def decode_names(payload: bytes) -> tuple[str, ...]:
    """A comma list. Some clients end it with a comma.

    Raises:
        DecodeError: no ASCII, or too many.
    """
    try:
        names = tuple(name for name in payload.decode("ascii").split(",") if name)
    except UnicodeDecodeError as error:
        raise DecodeError(f"RTDE names must be ASCII: {error}") from error
    if len(names) > _MAX_NAMES:
        raise DecodeError(f"an RTDE recipe has at most {_MAX_NAMES} fields, this one {len(names)}")
    return names


def encode_outputs(frequency: float, names: Sequence[str]) -> bytes:
    """Payload that asks for an output recipe. frequency: [Hz]."""
    return struct.pack(">d", frequency) + encode_names(names)


def decode_outputs(payload: bytes) -> tuple[float, tuple[str, ...]]:
    """(frequency [Hz], names).

    Raises:
        DecodeError: too short.
    """
    if len(payload) < 8:
        raise DecodeError(f"an RTDE output recipe starts with 8 bytes of frequency, got {len(payload)}")
    return struct.unpack_from(">d", payload)[0], decode_names(payload[8:])


def encode_recipe(number: int, types: Sequence[str]) -> bytes:
    """The controller's answer to a recipe: its number (0: refused), and a type per field."""
    return struct.pack(">B", number) + encode_names(types)


def decode_recipe(payload: bytes) -> tuple[int, tuple[str, ...]]:
    """(number, types).

    Raises:
        DecodeError: empty.
    """
    if not payload:
        raise DecodeError("the answer to an RTDE recipe is empty")
    return payload[0], decode_names(payload[1:])


def encode_version(version: tuple[int, int, int, int]) -> bytes:
    """Payload of the controller's version: major, minor, bugfix, build."""
    return struct.pack(">4I", *version)


def decode_version(payload: bytes) -> tuple[int, int, int, int]:
    """Raises:
    DecodeError: it is not four numbers.
    """
    if len(payload) != 16:
        raise DecodeError(f"the controller's version has 16 bytes, got {len(payload)}")
    major, minor, bugfix, build = struct.unpack(">4I", payload)
    return major, minor, bugfix, build


def encode_text(text: str, source: str, level: int) -> bytes:
    """Payload of a text message; what is longer than 255 bytes is cut."""
    parts = []
    for part in (text, source):
        data = part.encode("utf-8")[:_MAX_TEXT]
        parts.append(struct.pack(">B", len(data)) + data)
    return b"".join(parts) + struct.pack(">B", level)


def decode_text(payload: bytes) -> tuple[str, str, int]:
    """(text, source, level): 0 exception, 1 error, 2 warning, 3 info.

    Raises:
        DecodeError: it is shorter than it says.
    """
    parts, at = [], 0
    for _ in range(2):
        if at >= len(payload) or at + 1 + payload[at] > len(payload):
            raise DecodeError("an RTDE text message is shorter than it says")
        end = at + 1 + payload[at]
        parts.append(payload[at + 1 : end].decode("utf-8", "replace"))
        at = end
    if at >= len(payload):
        raise DecodeError("an RTDE text message has no level")
    return parts[0], parts[1], payload[at]


# -- data packets -------------------------------------------------------------------------------


class Layout:
    """How the fields of one recipe lie in a data packet.

    Attributes:
        size: of all values together [bytes].
    """

    def __init__(self, types: Sequence[FieldType]) -> None:
        self.types = tuple(types)
        chars = "".join(char * count for char, count in (FORMATS[kind] for kind in self.types))
        self._values = struct.Struct(">" + chars)
        self._packet = struct.Struct(">HBB" + chars)
        self._counts = [FORMATS[kind][1] for kind in self.types]
        self.size = self._values.size

    def packet(self, number: int, values: Sequence[float]) -> bytes:
        """A whole frame.

        Args:
            values: of all fields, vectors flattened.

        Raises:
            struct.error: they do not fit the types.
        """
        return self._packet.pack(self._packet.size, Kind.DATA, number, *values)

    def unpack(self, data: bytes) -> list[Value]:
        """The values of the fields that are there in whole; more bytes than asked for are ignored.

        Clients do send packets that are shorter or longer than their recipe.
        """
        if len(data) < self._values.size:
            return self._unpack_some(data)
        flat = self._values.unpack_from(data)
        if len(flat) == len(self._counts):
            return list(flat)
        values: list[Value] = []
        at = 0
        for count in self._counts:
            values.append(flat[at] if count == 1 else flat[at : at + count])
            at += count
        return values

    def _unpack_some(self, data: bytes) -> list[Value]:
        values: list[Value] = []
        at = 0
        for kind in self.types:
            char, count = FORMATS[kind]
            part = struct.Struct(f">{count}{char}")
            if at + part.size > len(data):
                break
            flat = part.unpack_from(data, at)
            values.append(flat[0] if count == 1 else flat)
            at += part.size
        return values
