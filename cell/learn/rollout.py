"""Roll the agents out in the domain, beliefs included.

Shapes: T steps, E environments, N agents, K = N - 1 partners.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cell.learn.belief.bank import BeliefBank
from cell.learn.discriminator import Transitions
from cell.learn.domain.interface import VectorDomain
from cell.learn.networks import Actors
from cell.wire.vocabulary import Action

Act = Callable[[NDArray[np.int16], NDArray[np.float32]], NDArray[np.int8]]
"""(E, N) local ids and (E, N, K) beliefs -> (E, N) actions."""


@dataclass(frozen=True)
class Rollout:
    """One episode in every environment.

    Attributes:
        local: (T + 1, E, N) int64. belief: (T + 1, E, N, K) float32. action: (T, E, N) int64.
        rewards: per name (`truth`, `priced`, `shaped`) (T, E) float32.
        onions, priced_steps, wrong, switches: per episode (E,) int64.
        invalid: (E,) whether an invalid action ended the episode.
    """

    local: Tensor
    belief: Tensor
    action: Tensor
    rewards: dict[str, Tensor]
    onions: NDArray[np.int64]
    priced_steps: NDArray[np.int64]
    wrong: NDArray[np.int64]
    switches: NDArray[np.int64]
    invalid: NDArray[np.bool_]

    def transitions(self) -> Transitions:
        """All (s, b, a, s', b') of the rollout, in order of time: M = T E."""
        return Transitions(
            self.local[:-1].flatten(0, 1),
            self.belief[:-1].flatten(0, 1),
            self.action.flatten(0, 1),
            self.local[1:].flatten(0, 1),
            self.belief[1:].flatten(0, 1),
        )

    def returns(self, name: str) -> NDArray[np.float64]:
        """Undiscounted reward per episode: (E,)."""
        total: NDArray[np.float64] = self.rewards[name].double().sum(0).numpy()
        return total


def roll(domain: VectorDomain, bank: BeliefBank, act: Act) -> Rollout:
    """One episode of every environment under `act`."""
    horizon, envs, agents = domain.horizon, domain.n_envs, domain.n_agents
    local = np.empty((horizon + 1, envs, agents), np.int16)
    belief = np.empty((horizon + 1, envs, agents, agents - 1), np.float32)
    action = np.empty((horizon, envs, agents), np.int8)
    rewards = {name: np.empty((horizon, envs), np.float32) for name in ("truth", "priced", "shaped")}
    onions, priced, wrong = (np.zeros(envs, np.int64) for _ in range(3))
    alive = np.ones(envs, np.bool_)
    local[0] = domain.reset()
    belief[0] = bank.reset(envs)
    for t in range(horizon):
        action[t] = act(local[t], belief[t])
        step = domain.step(action[t])
        local[t + 1] = step.local
        belief[t + 1] = bank.update(step.observed)
        rewards["truth"][t], rewards["priced"][t] = step.reward_truth, step.reward_priced
        rewards["shaped"][t] = step.reward_shaped
        onions += step.placed.sum(1)
        wrong += step.wrong.sum(1)
        priced += step.priced
        alive = step.alive
    switched = (action[:, :, 0] == Action.SPEED_UP) | (action[:, :, 0] == Action.SLOW_DOWN)
    return Rollout(
        torch.from_numpy(local.astype(np.int64)),
        torch.from_numpy(belief),
        torch.from_numpy(action.astype(np.int64)),
        {name: torch.from_numpy(values) for name, values in rewards.items()},
        onions,
        priced,
        wrong,
        switched.sum(0),
        ~alive,
    )


def sampling(actors: Actors, steps: int, envs: int, rng: torch.Generator) -> Act:
    """Actions drawn from the policies (Gumbel-max; the noise of a whole episode is drawn at once)."""
    uniform = torch.rand((steps, actors.agents, envs, 9), generator=rng).clamp_(1e-20, 1.0 - 1e-7)
    noise = iter(-torch.log(-torch.log(uniform)))

    def act(local: NDArray[np.int16], belief: NDArray[np.float32]) -> NDArray[np.int8]:
        with torch.inference_mode():
            log_p: Tensor = actors(torch.from_numpy(local).long(), torch.from_numpy(belief))
            chosen: NDArray[np.int64] = (log_p + next(noise)).argmax(-1).t().numpy()
        return chosen.astype(np.int8)

    return act


def greedy(actors: Actors) -> Act:
    """The most probable action of every agent."""

    def act(local: NDArray[np.int16], belief: NDArray[np.float32]) -> NDArray[np.int8]:
        with torch.inference_mode():
            log_p: Tensor = actors(torch.from_numpy(local).long(), torch.from_numpy(belief))
            chosen: NDArray[np.int64] = log_p.argmax(-1).t().numpy()
        return chosen.astype(np.int8)

    return act


def tables(per_agent: list[NDArray[np.int8]]) -> Act:
    """Experts' tables: per agent (L, 2), action by local id and by "some partner believed fatigued"."""
    stacked = np.stack(per_agent)
    agents = np.arange(len(per_agent))

    def act(local: NDArray[np.int16], belief: NDArray[np.float32]) -> NDArray[np.int8]:
        tired = (belief > 0.5).any(-1).astype(np.int64)
        chosen: NDArray[np.int8] = stacked[agents, local, tired]
        return chosen

    return act
