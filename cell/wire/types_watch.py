"""Messages for and from those who watch and operate the cell; see `cell.wire.types`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Event:
    """A line for people: level 10 debug, 20 info, 30 warn, 40 error."""

    t: float
    level: int
    name: str
    text: str


@dataclass(frozen=True)
class PlannedPath:
    """Where the tool is to go: p_WT, shape (N, 3) [m], of the trajectory that was sent at `t` [s]."""

    t: float
    p_WT: Array


@dataclass(frozen=True)
class OperatorCommand:
    """What an operator asks the supervisor for in this round.

    Attributes:
        holder: who asks.
        order: one of `vocabulary.ORDERS`.
        value: "cap": the tool is to be no faster than this [m/s]; 0 otherwise.
    """

    holder: str
    order: str
    value: float = 0.0


@dataclass(frozen=True)
class NextRound:
    """Another batch of `onions`, drawn from `seed`, is to follow this round, with this policy."""

    holder: str
    policy: str
    onions: int
    seed: int
