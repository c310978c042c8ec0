"""What every form of the domain offers, and the chances they share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cell.errors import ConfigError
from cell.learn.domain.local import ACTIONS
from cell.learn.domain.presets import Preset, confusion

_LEVELS = 1 << 16
"""Chances are kept to 1 in 65,536."""


@dataclass(frozen=True)
class Step:
    """What one step of E episodes with N agents gave.

    Attributes:
        local: (E, N) int16 local states after the step.
        observed: (E, N) int8 each agent's action as the others see it.
        reward_truth, reward_priced, reward_shaped: (E,) float32 team rewards: +1 and -1 by the truth;
            the same minus the price; the published environment's own.
        placed, wrong: (E, N) int8 onions put down in this step, and those put wrongly.
        priced: (E,) a step of a robot in industrial mode beside a human at work.
        alive: (E,) False once an invalid action has ended the episode.
        type_hidden, type_own, type_announced: (E, N) int8 types after the step: the truth, what the
            agent itself knows, what it told last.
    """

    local: NDArray[np.int16]
    observed: NDArray[np.int8]
    reward_truth: NDArray[np.float32]
    reward_priced: NDArray[np.float32]
    reward_shaped: NDArray[np.float32]
    placed: NDArray[np.int8]
    wrong: NDArray[np.int8]
    priced: NDArray[np.bool_]
    alive: NDArray[np.bool_]
    type_hidden: NDArray[np.int8]
    type_own: NDArray[np.int8]
    type_announced: NDArray[np.int8]


class VectorDomain(Protocol):
    """What every form of the domain offers; made by `make`.

    Attributes:
        features: (L, F) float32. mask: (N, L, 9) bool, what agent i may choose.
    """

    preset: Preset
    n_envs: int
    n_agents: int
    horizon: int
    features: NDArray[np.float32]
    mask: NDArray[np.bool_]

    def reset(self) -> NDArray[np.int16]:
        """Start a new episode everywhere; returns local states (E, N)."""
        ...

    def step(self, actions: NDArray[np.integer]) -> Step:
        """Let one step pass under actions (E, N)."""
        ...


def checked(actions: NDArray[np.integer], envs: int, agents: int) -> NDArray[np.int64]:
    """Actions (E, N) as (N, E), in memory that a table look-up can rely on.

    Raises:
        ConfigError: another shape, no integers, or a number that is no action's.
    """
    if actions.shape != (envs, agents) or actions.dtype.kind not in "iu":
        raise ConfigError(
            f"actions must be integers of shape ({envs}, {agents}), got {actions.dtype} {actions.shape}"
        )
    out = np.ascontiguousarray(actions.T, dtype=np.int64)
    if out.view(np.uint64).max() >= ACTIONS:  # negative numbers are huge ones here
        raise ConfigError(f"actions must be from 0 to {ACTIONS - 1}, got {out.min()} to {out.max()}")
    return out


def draw_kinds(rules: Preset) -> NDArray[np.int64]:
    """Kind of onion by a 16-bit random number, shape (65536,)."""
    edges = np.cumsum([1 - rules.p_blemished, rules.p_blemished * rules.p_visible])
    return np.searchsorted(edges, (np.arange(_LEVELS) + 0.5) / _LEVELS, side="right")


def observer(rules: Preset, rng: np.random.Generator) -> Callable[[NDArray[np.int64]], NDArray[np.int64]]:
    """Actions (N, E) -> actions as the others see them, by the preset's confusion."""
    seen = confusion(rules)
    if (seen == np.eye(ACTIONS)).all():
        return lambda action: action
    below = np.cumsum(seen, axis=1)[:, :-1]

    def observe(action: NDArray[np.int64]) -> NDArray[np.int64]:
        out: NDArray[np.int64] = (rng.random(action.shape)[..., None] >= below[action]).sum(axis=-1)
        return out

    return observe
