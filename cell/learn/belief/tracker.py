"""What every belief tracker offers, and the one that needs no learning."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cell.wire.vocabulary import Action

THUMBS_UP, THUMBS_DOWN = Action.SPEED_UP, Action.SLOW_DOWN
"""A person's actions 7 and 8."""


class BeliefTracker(Protocol):
    """P(partner fatigued) from the partner's observed actions, in E environments at once."""

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        """Start new episodes: the belief before anything was observed, (E,)."""
        ...

    def update(self, observed: NDArray[np.int8]) -> NDArray[np.float32]:
        """The belief after the partner's actions (E,): (E,)."""
        ...


class LastGesture:
    """Type 1 after one announcement, type 0 after the other: what was last told.

    For a robot partner it is exact (Speed-up makes type 1, Slow-down type 0); for a person it is the
    *announced* type (thumbs-down: 1, thumbs-up: 0).
    """

    def __init__(self, to_one: int, to_zero: int, start: float = 0.0) -> None:
        self._one, self._zero, self._start = to_one, to_zero, start
        self._belief = np.zeros(0, np.float32)

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        self._belief = np.full(n_envs, self._start, np.float32)
        return self._belief

    def update(self, observed: NDArray[np.int8]) -> NDArray[np.float32]:
        told = np.where(observed == self._one, 1.0, np.where(observed == self._zero, 0.0, self._belief))
        self._belief = told.astype(np.float32)
        return self._belief


class NoBelief:
    """Knows nothing: the prior, always."""

    def __init__(self, prior: float = 0.5) -> None:
        self._prior = prior
        self._belief = np.zeros(0, np.float32)

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        self._belief = np.full(n_envs, self._prior, np.float32)
        return self._belief

    def update(self, observed: NDArray[np.int8]) -> NDArray[np.float32]:
        del observed
        return self._belief


def robot_type(start: float = 0.0) -> LastGesture:
    """The belief about a robot partner: its own Speed-up and Slow-down tell it."""
    return LastGesture(to_one=Action.SPEED_UP, to_zero=Action.SLOW_DOWN, start=start)


def last_gesture(start: float = 0.0) -> LastGesture:
    """The belief about a person: fatigued since the last thumbs-down, until a thumbs-up."""
    return LastGesture(to_one=THUMBS_DOWN, to_zero=THUMBS_UP, start=start)
