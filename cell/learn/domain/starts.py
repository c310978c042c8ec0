"""Where episodes start: drawn for many at once, and as chances for the exact solution."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell.learn.domain.local import LOCALS, SIZE, START, with_type
from cell.learn.domain.presets import Preset
from cell.learn.domain.rules import KINDS, SHOWN, SOUND
from cell.wire.vocabulary import EefLocation, OnionLocation, Prediction

RANDOM_STARTS = np.flatnonzero((LOCALS.indicated == 1) & (LOCALS.eef != EefLocation.ON_CONVEYOR))
"""Published: uniform over local states that are indicated and whose hand is not on the conveyor.

26 of ours; the published environment counts 52, each of them with its derived interaction flag.
"""


def draw_starts(
    rules: Preset, envs: int, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Local states and kinds of the onions in focus, both (N, E)."""
    agents = len(rules.agents)
    local, onion = np.full((agents, envs), START), np.full((agents, envs), SOUND)
    if rules.start == "random":
        local = rng.choice(RANDOM_STARTS, (agents, envs))
        onion = _matching_onions(rules, local, rng)
    for i in range(agents):
        fixed_type = _type(rules, rules.agents[i])
        if fixed_type is not None:
            local[i] = with_type(local[i], fixed_type)
    return local, onion


def start_chances(rules: Preset, role: str) -> NDArray[np.float64]:
    """P(local state at the start) of one agent, shape (L,)."""
    possible = RANDOM_STARTS if rules.start == "random" else np.array([START])
    fixed_type = _type(rules, role)
    if fixed_type is not None:
        possible = with_type(possible, fixed_type)
    return np.bincount(possible, minlength=SIZE) / len(possible)


def _type(rules: Preset, role: str) -> int | None:
    """The type that every agent of a role starts with, if it is not left to the local state."""
    if role == "robot":
        return rules.robot_start
    return None if rules.thresholds else 0


def _matching_onions(rules: Preset, local: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Kinds (N, E) that fit the predictions of random starts."""
    p, visible = rules.p_blemished, rules.p_visible
    hidden_share = p * (1 - visible) / max(1 - p * visible, 1e-12)
    concealed = rng.random(local.shape) < hidden_share
    inspected = LOCALS.onion[local] == OnionLocation.IN_FRONT
    good = np.where(concealed & ~inspected, KINDS - 1, SOUND)
    return np.where(LOCALS.prediction[local] == Prediction.BLEMISHED, SHOWN, good)
