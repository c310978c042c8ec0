"""Decisions on their way into a recording: taken in as they are, coded off the loop's thread."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from cell.config import CellConfig
from cell.decision.io import Inputs, Outputs
from cell.record import tick


@dataclass(frozen=True)
class Decision:
    """One tick of the supervisor with the searches of the hand networks in it."""

    number: int
    inputs: Inputs
    outputs: Outputs
    searches: tuple[tick.Search, ...] = ()

    @property
    def size(self) -> int:
        """Bytes that it holds, roughly."""
        return 4096 + sum(f.rgb.nbytes + f.depth.nbytes for f in self.inputs.frames)


class CodedDecision(msgspec.Struct, frozen=True, array_like=True):
    """A decision as the messages that a recording holds.

    Attributes:
        number: of the tick. t: its time [s].
        operator, inputs, outputs: CDR, see `cell.record.tick`; operator: empty without orders.
    """

    number: int
    t: float
    operator: bytes
    inputs: bytes
    outputs: bytes

    @property
    def size(self) -> int:
        """Bytes that it holds."""
        return len(self.operator) + len(self.inputs) + len(self.outputs)


def whole_frames(config: CellConfig, lossless: bool) -> frozenset[str]:
    """Cameras whose frames are kept with every pixel: the belt camera's, or all."""
    return frozenset(config.cameras) if lossless else frozenset({"belt"})


def code(d: Decision, whole: frozenset[str]) -> CodedDecision:
    """A decision as messages; raises WireError when it cannot be written down."""
    return CodedDecision(
        d.number,
        d.inputs.t,
        tick.encode_operator(d.number, d.inputs) if d.inputs.operator else b"",
        tick.encode_inputs(d.number, d.inputs, d.searches, whole),
        tick.encode_outputs(d.number, d.outputs),
    )
