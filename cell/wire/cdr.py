"""Reading and writing CDR, the byte format of ROS 2, with bulk data kept out of the way.

`rosbags` writes the small parts; pixels and trajectory points go in as they are, which
saves two copies of every image and makes long trajectories cheap. Everything read from
outside is checked here or by the caller before it becomes a message: every failure is a
`DecodeError` of one line.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.clock import from_stamp, to_stamp
from cell.errors import DecodeError, WireError
from cell.wire.typestore import TIME, make, store

#: CDR, little endian, no options: the only representation accepted.
ENCAPSULATION = b"\x00\x01\x00\x00"
#: Longest text in any field [bytes of UTF-8].
MAX_TEXT = 4096
#: Times end where ROS's 32-bit seconds do (year 2038) [s].
MAX_TIME = 2**31 - 1

_U32 = struct.Struct("<I")


class Writer:
    """Builds one message from parts."""

    def __init__(self) -> None:
        self._parts: list[bytes | memoryview] = [ENCAPSULATION]
        self._size = 0

    def put(self, ros_type: str, message: object) -> None:
        """Append a ROS message; its first field must not need more than 4-byte alignment
        unless it opens the stream."""
        self.align()
        msgdef = store().get_msgdef(ros_type)
        # Alignment counts from the stream's start: write at the same phase, then cut it off.
        phase = self._size % 8
        buffer = memoryview(bytearray(msgdef.getsize_cdr(phase, message, store())))
        msgdef.serialize_cdr_le(buffer, phase, message, store())
        self.raw(buffer[phase:])

    def count(self, n: int) -> None:
        """Append the length of the sequence that follows."""
        self.align()
        self.raw(_U32.pack(n))

    def raw(self, data: bytes | memoryview) -> None:
        """Append bytes as they are."""
        self._parts.append(data)
        self._size += len(data)

    def align(self) -> None:
        """Pad to a multiple of 4 bytes."""
        if self._size % 4:
            self.raw(bytes(-self._size % 4))

    @property
    def size(self) -> int:
        """Bytes written so far, from where alignment is counted."""
        return self._size

    def finish(self) -> bytes:
        """The whole message."""
        return b"".join(self._parts)


class Reader:
    """Takes one message apart; raises DecodeError on whatever does not fit.

    Args:
        data: the whole message.
        limit: most bytes a message of its type may have.
    """

    def __init__(self, data: bytes, limit: int) -> None:
        if len(data) > limit:
            raise DecodeError(f"{len(data)} bytes, at most {limit} are allowed")
        if data[:4] != ENCAPSULATION:
            start = data[:4].hex() or "nothing"
            raise DecodeError(f"not little-endian CDR: starts with {start} instead of 00010000")
        self._data = memoryview(data).toreadonly()[4:]
        self.pos = 0

    def take(self, ros_type: str) -> Any:
        """The ROS message at this place."""
        from rosbags.serde import SerdeError

        self.align()
        msgdef = store().get_msgdef(ros_type)
        try:
            message, pos = msgdef.deserialize_cdr_le(self._data, self.pos, msgdef.cls, store())
        except (SerdeError, struct.error, ValueError, IndexError, OverflowError) as error:
            raise DecodeError(f"cut short or garbled: {_line(error)}") from None
        self.raw(pos - self.pos)
        return message

    def count(self, limit: int, what: str) -> int:
        """Length of the sequence that follows, at most `limit`."""
        self.align()
        (n,) = _U32.unpack(self.raw(4))
        if n > limit:
            raise DecodeError(f"{n} {what}, at most {limit} are allowed")
        return int(n)

    def raw(self, n: int) -> memoryview:
        """The next `n` bytes."""
        left = len(self._data) - self.pos
        if n > left:
            raise DecodeError(f"cut short: {n} bytes expected at {self.pos}, {left} left")
        self.pos += n
        return self._data[self.pos - n : self.pos]

    def rewound(self, n: int) -> memoryview:
        """Everything from `n` bytes before this place."""
        return self._data[self.pos - n :]

    def align(self) -> None:
        """Skip padding to a multiple of 4 bytes."""
        self.raw(-self.pos % 4)

    def finish(self) -> None:
        """Check that nothing follows but the up to three zeros that some DDS writers pad with."""
        rest = bytes(self._data[self.pos :])
        if len(rest) > 3 or any(rest):
            raise DecodeError(f"{len(rest)} bytes too many")


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def stamp(t: float) -> Any:
    """Seconds -> ROS Time; raises WireError outside 0 .. MAX_TIME."""
    if not 0.0 <= t <= MAX_TIME:
        raise WireError(f"time {t} s cannot be sent: it must be in 0..{MAX_TIME}")
    return make(TIME)(*to_stamp(t))


def seconds(time: Any, what: str) -> float:
    """ROS Time or Duration -> seconds; raises DecodeError when negative or malformed."""
    if time.sec < 0 or time.nanosec >= 1_000_000_000:
        raise DecodeError(f"{what}: {time.sec} s {time.nanosec} ns is no time")
    return from_stamp(time.sec, time.nanosec)


def text(value: str, what: str) -> str:
    """The text itself if not too long, else DecodeError."""
    if len(value) > MAX_TEXT or len(value.encode()) > MAX_TEXT:
        raise DecodeError(f"{what} is longer than {MAX_TEXT} bytes")
    return value


def finite(value: float, what: str) -> float:
    """The number itself if finite, else DecodeError."""
    if not math.isfinite(value):
        raise DecodeError(f"{what} is {value}, not a finite number")
    return value


def vector(values: Any, n: int, what: str) -> NDArray[np.float64]:
    """Read-only copy, shape (n,), of finite numbers, else DecodeError."""
    if len(values) != n:
        raise DecodeError(f"{what} has {len(values)} values instead of {n}")
    out = np.array(values, dtype=np.float64)
    return frozen(out, what)


def frozen(array: NDArray[np.float64], what: str) -> NDArray[np.float64]:
    """`array`, made read-only, if all of it is finite, else DecodeError."""
    if not np.isfinite(array).all():
        kind = "NaN" if np.isnan(array).any() else "infinity"
        raise DecodeError(f"{what} contains {kind}; every number must be finite")
    array.setflags(write=False)
    return array
