"""Expert trajectories, with the beliefs the agents held along them."""

from __future__ import annotations

import numpy as np

from cell.learn.belief.bank import BeliefBank
from cell.learn.belief.gru import TypeData
from cell.learn.discriminator import Transitions
from cell.learn.domain.experts import expert_actions
from cell.learn.domain.presets import Preset
from cell.learn.domain.vector import make
from cell.learn.rollout import Act, Rollout, roll, tables

LABELS = ("announced", "own", "hidden")
"""Three readings of a person's type: last told, known to itself, the domain's truth."""


def derived(*seed: int) -> int:
    """One integer seed from several."""
    return int(np.random.SeedSequence(list(seed)).generate_state(1, np.uint64)[0] >> 1)


def expert(preset: Preset, robot: str = "expert") -> Act:
    """The hand-coded policy vector; `robot` names the rule of the robots (see `domain.experts`)."""
    return tables(
        [
            expert_actions(preset, agent, robot if name.startswith("robot") else "expert")
            for agent, name in enumerate(preset.agents)
        ]
    )


def play(preset: Preset, bank: BeliefBank, act: Act, episodes: int, seed: int) -> Rollout:
    """Episodes of any joint policy; the belief trajectories follow the observed actions (Eq. 4)."""
    return roll(make(preset, episodes, seed), bank, act)


def demonstrate(
    preset: Preset, bank: BeliefBank, episodes: int, seed: int, robot: str = "expert"
) -> Transitions:
    """Expert transitions (s, b, a, s', b') from `episodes` episodes; the paper's 10^6 steps are 10,000.

    Eq. 4: the expert's belief trajectory is what the frozen belief module makes of the actions the
    other was observed to take.
    """
    return play(preset, bank, expert(preset, robot), episodes, seed).transitions()


def type_data(preset: Preset, label: str, episodes: int, seed: int, person: int | None = None) -> TypeData:
    """Observed actions and types of one person in expert episodes (ground truth for the belief).

    Args:
        label: one of `LABELS`. person: agent index (None: the first person of the preset).
    """
    from cell.learn.belief.bank import bank
    from cell.learn.belief.tracker import last_gesture

    names = preset.agents
    people = [i for i, name in enumerate(names) if not name.startswith("robot")]
    who = people[0] if person is None else person
    domain = make(preset, episodes, seed)
    beliefs = bank(names, [last_gesture() for _ in people])
    act = expert(preset)
    local, belief = domain.reset(), beliefs.reset(episodes)
    observed = np.empty((domain.horizon, episodes), np.int8)
    types = np.empty((domain.horizon + 1, episodes), np.int8)
    types[0] = start_types(local[:, who])
    for t in range(domain.horizon):
        step = domain.step(act(local, belief))
        local, belief = step.local, beliefs.update(step.observed)
        observed[t] = step.observed[:, who]
        types[t + 1] = getattr(step, f"type_{label}")[:, who]
    return TypeData(observed, types)


def start_types(
    local: np.ndarray[tuple[int, ...], np.dtype[np.int16]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.int8]]:
    """Own types (E,) in local states (E,): at the start hidden, own and announced type agree."""
    from cell.learn.domain.local import LOCALS

    own: np.ndarray[tuple[int, ...], np.dtype[np.int8]] = np.asarray(LOCALS.own_type)[local].astype(np.int8)
    return own
