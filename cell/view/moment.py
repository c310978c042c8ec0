"""What the page shows at one moment, wherever it comes from: a running cell or a recording."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from cell.frames import Array
from cell.wire.types import (
    ArmStatus,
    Detections,
    Event,
    Frame,
    GripperState,
    Hands,
    JointState,
    PlannedPath,
    SupervisorState,
    Truth,
)

SPAN = 60.0
"""The plots show so much of the past [s]."""
_KEPT = 900


@dataclass(frozen=True)
class Moment:
    """Everything known at `t` [s] of the node's clock; what has not come yet is None or missing.

    Attributes:
        fresh: samples are arriving.
        frames: newest frame of each camera. detections, hands: with the frame that they belong to.
        events: the last few, oldest first.
        truth: of the simulation, where it was asked for.
    """

    t: float = 0.0
    fresh: bool = False
    joints: JointState | None = None
    arm: ArmStatus | None = None
    gripper: GripperState | None = None
    state: SupervisorState | None = None
    path: PlannedPath | None = None
    frames: dict[str, Frame] = field(default_factory=dict)
    detections: tuple[Detections, Frame] | None = None
    hands: tuple[Hands, Frame] | None = None
    events: tuple[Event, ...] = ()
    truth: Truth | None = None


@dataclass(frozen=True)
class Curves:
    """The past for the plots, shape (N,) each: t [s], belief, cap [m/s], speed of the tool [m/s]."""

    t: Array
    belief: Array
    cap: Array
    speed: Array


class Source(Protocol):
    """Where moments come from."""

    def moment(self) -> Moment: ...

    def curves(self) -> Curves: ...

    def close(self) -> None: ...


class Past:
    """Collects curves while time goes on; starts afresh when the clock is set back."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, float, float, float]] = deque(maxlen=_KEPT)

    def note(self, t: float, belief: float, cap: float, speed: float) -> None:
        if self._rows and t < self._rows[-1][0]:
            self._rows.clear()
        if not self._rows or t > self._rows[-1][0]:
            self._rows.append((t, belief, cap, speed))

    def curves(self) -> Curves:
        rows = np.array([r for r in self._rows if r[0] >= self._rows[-1][0] - SPAN]).reshape(-1, 4)
        return Curves(*rows.T)
