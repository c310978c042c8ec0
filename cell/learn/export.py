"""Policies as CSV tables: one row per local state and belief bin, arg-max and probabilities.

The table of an agent is what the network does, averaged over the beliefs it was seen to hold in that
state and bin. States it never visits are filled from the expert, and where the expert names nothing
the machine could do, from what it could.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from cell.decision.policy import COLUMNS, PROBABILITY_COLUMNS, State, load, possible_actions, states
from cell.errors import ConfigError
from cell.learn.domain.experts import expert_actions
from cell.learn.domain.local import local_id
from cell.learn.domain.presets import Preset
from cell.learn.networks import ACTIONS, Actors
from cell.learn.rollout import Act, Rollout
from cell.wire.vocabulary import Action

BELIEF_EDGES = tuple(round(k / 20, 2) for k in range(21))
"""Twenty belief bins of equal width."""


@dataclass(frozen=True)
class Table:
    """One agent's policy as a table.

    Attributes:
        edges: (bins + 1,) from 0 to 1. probabilities: (L, bins, A). best: (L, bins) arg-max actions.
        visited: (L, bins) whether the network was seen there.
    """

    edges: tuple[float, ...]
    probabilities: NDArray[np.float64]
    best: NDArray[np.int8]
    visited: NDArray[np.bool_]

    def bin(self, belief: NDArray[np.float32]) -> NDArray[np.int64]:
        """Bins of beliefs (...,)."""
        return np.searchsorted(np.asarray(self.edges[1:-1], np.float32), belief, side="right")


def tabulate(
    preset: Preset, actors: Actors, agent: int, visits: list[Rollout], edges: tuple[float, ...] = BELIEF_EDGES
) -> Table:
    """The table of one agent of a two-agent preset.

    Args:
        visits: rollouts of the same actors, sampled and greedy, that say which beliefs occur where.
    """
    if actors.agents != 2:
        raise ConfigError(f"a policy table has one belief column: two agents, got {actors.agents}")
    size, bins = len(actors.features), len(edges) - 1
    local = torch.cat([r.local[:-1].flatten(0, 1) for r in visits])
    belief = torch.cat([r.belief[:-1].flatten(0, 1) for r in visits])
    with torch.no_grad():
        seen = actors(local, belief)[agent].exp().double().numpy()  # (M, A)
        centres = torch.tensor([(a + b) / 2 for a, b in pairwise(edges)])
        ids = torch.arange(size).repeat_interleave(bins)
        grid_local = ids[:, None].repeat(1, 2)
        grid_belief = centres.repeat(size)[:, None, None].expand(-1, 2, 1).contiguous()
        grid = actors(grid_local, grid_belief)[agent].exp().double().numpy().reshape(size, bins, ACTIONS)
    empty = Table(edges, grid, grid.argmax(-1).astype(np.int8), np.zeros((size, bins), np.bool_))
    place = local[:, agent].numpy() * bins + empty.bin(belief[:, agent, 0].numpy())
    count = np.bincount(place, minlength=size * bins).reshape(size, bins)
    total = np.stack([np.bincount(place, seen[:, a], size * bins) for a in range(ACTIONS)], axis=-1)
    votes = np.zeros((size * bins, ACTIONS), np.int64)
    np.add.at(votes, (place, seen.argmax(-1)), 1)
    visited = count > 0
    probabilities = np.where(
        visited[..., None], total.reshape(size, bins, ACTIONS) / np.maximum(count, 1)[..., None], grid
    )
    best = np.where(visited, votes.argmax(-1).reshape(size, bins), empty.best).astype(np.int8)
    known = visited.any(1)  # elsewhere in the belief of a known state the network itself answers
    expert = expert_actions(preset, agent)[:, (centres.numpy() > 0.5).astype(np.int64)]
    best[~known] = expert[~known]
    probabilities[~known] = np.eye(ACTIONS)[expert[~known]]
    return Table(edges, probabilities, best, visited)


def to_csv(table: Table, comment: str) -> str:
    """CSV text as `cell.decision.policy.load` reads it; `comment` gives policy, preset, seed, commit."""
    edges = ",".join(f"{e:g}" for e in table.edges)
    lines = [f"# {comment} belief_bins={edges}", ",".join(COLUMNS)]
    for state in states(len(table.edges) - 1):
        local = _id(state)
        action, chances = (
            Action(int(table.best[local, state.belief_bin])),
            table.probabilities[local, state.belief_bin],
        )
        possible = possible_actions(state)
        if action not in possible:
            action = _fallback(state)
            chances = np.eye(ACTIONS)[action]
        words = [v.name.lower() if hasattr(v, "name") else str(v) for v in state]
        lines.append(",".join([*words, action.name.lower(), *(f"{c:.6g}" for c in chances)]))
    return "\n".join(lines) + "\n"


def from_csv(path: Path, size: int) -> Table:
    """Read a policy CSV back, probabilities included.

    Args:
        size: number of local ids of the domain.

    Raises:
        PolicyError: not a complete policy (see `cell.decision.policy.load`).
    """
    policy = load(str(path))
    bins = len(policy.bin_edges) - 1
    best = np.zeros((size, bins), np.int8)
    probabilities = np.zeros((size, bins, ACTIONS))
    probabilities[..., Action.NO_OP] = 1.0
    with path.open(encoding="utf-8", newline="") as file:
        rows = csv.DictReader(line for line in file if not line.startswith("#"))
        by_key = {tuple(row[c].strip() for c in COLUMNS[:6]): row for row in rows}
    for state, action in policy.actions.items():
        row = by_key[tuple(v.name.lower() if hasattr(v, "name") else str(v) for v in state)]
        chances = np.array([float(row[c]) for c in PROBABILITY_COLUMNS])
        best[_id(state), state.belief_bin] = action
        probabilities[_id(state), state.belief_bin] = chances / chances.sum()
    return Table(policy.bin_edges, probabilities, best, np.ones((size, bins), np.bool_))


def expert_table(preset: Preset, agent: int, kind: str = "expert") -> Table:
    """A hand-coded expert as a table of two belief bins."""
    best = expert_actions(preset, agent, kind)
    return Table((0.0, 0.5, 1.0), np.eye(ACTIONS)[best], best, np.ones(best.shape, np.bool_))


def acting(per_agent: list[Table], sampled: np.random.Generator | None = None) -> Act:
    """A joint policy of tables; `sampled` gives the random numbers, None the arg-max."""

    def act(local: NDArray[np.int16], belief: NDArray[np.float32]) -> NDArray[np.int8]:
        chosen = np.empty(local.shape, np.int8)
        for agent, table in enumerate(per_agent):
            rows = local[:, agent], table.bin(belief[:, agent, 0])
            if sampled is None:
                chosen[:, agent] = table.best[rows]
            else:
                steps = table.probabilities[rows].cumsum(-1)
                draw = sampled.random((len(local), 1)) * steps[:, -1:]
                chosen[:, agent] = (draw >= steps).sum(-1).clip(0, ACTIONS - 1)
        return chosen

    return act


def _id(state: State) -> int:
    return int(local_id(state.onion, state.eef, state.prediction, state.own_type, state.indicated))


def _fallback(state: State) -> Action:
    """For a state no rule speaks of: announce what was not announced, else go on sorting."""
    possible = possible_actions(state)
    return possible[-1] if not state.indicated else possible[1]
