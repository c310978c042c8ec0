"""The local state of one agent: five variables, numbered.

16 combinations of onion location, end-effector location and prediction are possible; with the own
type and the indication that makes 64 local states. One more, the sink, is where the published
environment ends an episode after an invalid action.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cell.decision.policy import states
from cell.wire.vocabulary import Action, EefLocation, OnionLocation, Prediction

ACTIONS = len(Action)


class Locals(NamedTuple):
    """Each variable by local state, shape (L,) int; the sink has -1 everywhere."""

    onion: NDArray[np.int64]
    eef: NDArray[np.int64]
    prediction: NDArray[np.int64]
    own_type: NDArray[np.int64]
    indicated: NDArray[np.int64]

    @property
    def held(self) -> NDArray[np.bool_]:
        """The agent holds an onion."""
        out: NDArray[np.bool_] = self.onion >= OnionLocation.IN_FRONT
        return out

    @property
    def idle(self) -> NDArray[np.bool_]:
        """No onion is in focus."""
        out: NDArray[np.bool_] = self.onion == OnionLocation.UNKNOWN
        return out


TRIPLES = list(dict.fromkeys((int(s.onion), int(s.eef), int(s.prediction)) for s in states(belief_bins=1)))
"""Possible (onion, eef, prediction), as in a policy table."""
_ROWS = [(*triple, own, told) for triple in TRIPLES for own in (0, 1) for told in (0, 1)]
_IDS = {row: k for k, row in enumerate(_ROWS)}
SINK = len(_ROWS)
SIZE = SINK + 1
"""Number of local states L, the sink included."""
LOCALS = Locals(*np.array([*_ROWS, (-1,) * 5]).T)


def local_id(onion: int, eef: int, prediction: int, own_type: int, indicated: int) -> int:
    """Number of a local state.

    Raises:
        KeyError: an impossible combination.
    """
    return _IDS[int(onion), int(eef), int(prediction), int(own_type), int(indicated)]


def _features() -> NDArray[np.float32]:
    """One-hot encoding (L, 15) of the five variables; the sink is all ones."""
    blocks = [
        np.eye(size)[np.maximum(values, 0)] for values, size in zip(LOCALS, (4, 4, 3, 2, 2), strict=True)
    ]
    out = np.concatenate(blocks, axis=1).astype(np.float32)
    out[SINK] = 1.0
    return out


FEATURES = _features()
START = local_id(OnionLocation.UNKNOWN, EefLocation.AT_HOME, Prediction.UNKNOWN, 0, 1)
"""The fixed start of every agent."""


def with_type(local: NDArray[np.int64], own_type: int) -> NDArray[np.int64]:
    """The same local states with another own type."""
    out: NDArray[np.int64] = local + 2 * (own_type - LOCALS.own_type[local])
    return out
