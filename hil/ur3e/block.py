"""Memory that two processes share: one writes, the other reads the newest, and neither ever waits.

A block has two slots that are written in turn. Each carries a count and a checksum, so a reader
that meets a slot being written (or whose writer died over it) takes the other one, which is whole.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from collections.abc import Sequence
from dataclasses import astuple, dataclass

_HEAD = struct.Struct("<QI4x")
_SLOTS = 2

Six = tuple[float, float, float, float, float, float]
_ZERO: Six = (0.0,) * 6


@dataclass(frozen=True)
class Order:
    """What the node wants of the arm's driver.

    Attributes:
        arm: the driver should be ready to follow set-points of this epoch; 0: of none.
        follow: epoch of the set-point below; the driver follows it only while it is armed with the
            same one.
        lamp: standard digital outputs 0..7 as bits.
        t: when the set-point is to be reached [s], wall clock of the node.
        q, qd: the set-point [rad], [rad/s].
    """

    arm: int = 0
    follow: int = 0
    lamp: int = 0
    t: float = 0.0
    q: Six = _ZERO
    qd: Six = _ZERO


@dataclass(frozen=True)
class Measured:
    """What the driver knows of the arm, and of itself.

    Attributes:
        beat: when the driver wrote this [s]; t: when the controller measured the joints [s]; both on
            the node's wall clock. heard: when the last packet came in [s].
        stamp: the controller's own time [s].
        q, qd: measured joints [rad], [rad/s]. effort: torque that the controller's model expects [Nm].
        robot_mode, safety_mode, safety_bits, runtime: as RTDE numbers them.
        scaling: ratio 0..1 at which the controller wants trajectories followed.
        armed: epoch of the set-points the driver follows; 0: none. failed: last epoch that it could
            not be armed with. cause: why it stopped following, a `hil.ur3e.conditions.Cause`.
        cycles, late: the driver's own cycles, and those that began more than half a period late.
        lost, delayed: packets that never came, and cycles in which no new packet was there.
        worst: longest delay of a cycle so far [s].
    """

    beat: float = 0.0
    t: float = 0.0
    heard: float = 0.0
    stamp: float = 0.0
    q: Six = _ZERO
    qd: Six = _ZERO
    effort: Six = _ZERO
    robot_mode: int = -1
    safety_mode: int = 0
    safety_bits: int = 0
    runtime: int = 0
    scaling: float = 0.0
    armed: int = 0
    failed: int = 0
    cause: int = 0
    cycles: int = 0
    late: int = 0
    lost: int = 0
    delayed: int = 0
    worst: float = 0.0


ORDER = struct.Struct("<IIId6d6d")
MEASURED = struct.Struct("<dddd6d6d6diiIidIIIQQQQd")


class Block:
    """Values of one fixed layout in shared memory.

    Args:
        memory: of both processes. offset: where in it. layout: of the values.
    """

    def __init__(self, memory: mmap.mmap, offset: int, layout: struct.Struct) -> None:
        self._memory, self._offset, self._layout = memory, offset, layout
        self._slot = _HEAD.size + layout.size
        self._count = 0
        self._last: tuple[int, tuple[float, ...]] | None = None

    @staticmethod
    def size(layout: struct.Struct) -> int:
        """Bytes that a block of this layout takes."""
        return _SLOTS * (_HEAD.size + layout.size)

    def write(self, values: Sequence[float | int]) -> None:
        """Put new values; only one process may do so."""
        self._count += 1
        at = self._at(self._count)
        data = self._layout.pack(*values)
        body = at + _HEAD.size
        self._memory[body : body + self._layout.size] = data
        _HEAD.pack_into(self._memory, at, self._count, _check(self._count, data))

    def read(self) -> tuple[int, tuple[float, ...]] | None:
        """(count, values) of the newest whole slot, never older than before; None while there is none."""
        best: tuple[int, bytes] | None = None
        for slot in range(_SLOTS):
            at = self._at(slot)
            count, check = _HEAD.unpack_from(self._memory, at)
            data = self._memory[at + _HEAD.size : at + self._slot]
            if count and check == _check(count, data) and (best is None or count > best[0]):
                best = count, data
        if best is not None and (self._last is None or best[0] > self._last[0]):
            self._last = best[0], self._layout.unpack(best[1])
        return self._last

    def _at(self, count: int) -> int:
        return self._offset + (count % _SLOTS) * self._slot


class Orders:
    """The block of `Order`s."""

    def __init__(self, memory: mmap.mmap) -> None:
        self._block = Block(memory, 0, ORDER)

    def write(self, order: Order) -> None:
        self._block.write([*_flat(order)])

    def read(self) -> tuple[int, Order] | None:
        """(count, newest order); None before the first."""
        found = self._block.read()
        if found is None:
            return None
        count, v = found
        return count, Order(int(v[0]), int(v[1]), int(v[2]), v[3], _six(v, 4), _six(v, 10))


class Measurements:
    """The block of `Measured`."""

    def __init__(self, memory: mmap.mmap) -> None:
        self._block = Block(memory, Block.size(ORDER), MEASURED)

    def write(self, measured: Measured) -> None:
        self._block.write([*_flat(measured)])

    def read(self) -> Measured | None:
        """The newest; None before the first."""
        found = self._block.read()
        if found is None:
            return None
        v = found[1]
        return Measured(
            beat=v[0],
            t=v[1],
            heard=v[2],
            stamp=v[3],
            q=_six(v, 4),
            qd=_six(v, 10),
            effort=_six(v, 16),
            robot_mode=int(v[22]),
            safety_mode=int(v[23]),
            safety_bits=int(v[24]),
            runtime=int(v[25]),
            scaling=v[26],
            armed=int(v[27]),
            failed=int(v[28]),
            cause=int(v[29]),
            cycles=int(v[30]),
            late=int(v[31]),
            lost=int(v[32]),
            delayed=int(v[33]),
            worst=v[34],
        )


def shared_memory() -> tuple[int, mmap.mmap]:
    """(file descriptor, memory) for both blocks; it has no name and goes with its last process."""
    size = Block.size(ORDER) + Block.size(MEASURED)
    descriptor = os.memfd_create("arm", 0)
    os.ftruncate(descriptor, size)
    return descriptor, mmap.mmap(descriptor, size)


def attach(descriptor: int) -> mmap.mmap:
    """The other process's end; raises OSError for a descriptor that is no such memory."""
    return mmap.mmap(descriptor, Block.size(ORDER) + Block.size(MEASURED))


def _flat(message: Order | Measured) -> list[float | int]:
    out: list[float | int] = []
    for value in astuple(message):
        if isinstance(value, tuple):
            out += value
        else:
            out.append(value)
    return out


def _six(v: tuple[float, ...], at: int) -> Six:
    return v[at], v[at + 1], v[at + 2], v[at + 3], v[at + 4], v[at + 5]


def _check(count: int, data: bytes) -> int:
    return zlib.crc32(data, zlib.crc32(count.to_bytes(8, "little")))
