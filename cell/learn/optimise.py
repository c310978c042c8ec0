"""TB-Dec-PPO against a given reward: the task's own, or a learned one kept fixed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor

from cell.learn.belief.bank import BeliefBank
from cell.learn.demonstrations import derived
from cell.learn.discriminator import Reward
from cell.learn.domain.presets import Preset
from cell.learn.domain.vector import make
from cell.learn.networks import generator
from cell.learn.ppo import DecPpo
from cell.learn.rollout import Rollout, roll, sampling
from cell.learn.settings import Settings

RewardOf = Callable[[Rollout], Tensor]
"""Reward (T, E) of a rollout."""


def true_reward(name: str = "priced") -> RewardOf:
    """The domain's own reward: `truth`, `priced` or `shaped`."""
    return lambda rollout: rollout.rewards[name]


def learned_reward(reward: Reward, shaping: bool = True) -> RewardOf:
    """A frozen f (or g alone), divided by its standard deviation over the rollout."""

    @torch.no_grad()
    def evaluate(rollout: Rollout) -> Tensor:
        pool = rollout.transitions()
        if shaping:
            values: Tensor = reward(pool)
        else:
            values = reward.task(reward.encode(pool.local, pool.belief), pool.action)
        values = values.view(rollout.action.shape[:2])
        return values / (values.std() + 1e-6)

    return evaluate


def optimise(
    preset: Preset,
    beliefs: BeliefBank,
    reward: RewardOf,
    settings: Settings,
    ppo: DecPpo | None = None,
    learners: Sequence[int] | None = None,
) -> Iterator[tuple[int, DecPpo, Rollout]]:
    """Policy optimisation; yields (iterations done, learner, last rollout) after each iteration.

    Args:
        ppo: where to start (None: fresh networks). learners: agents that learn (None: all).
    """
    if ppo is None:
        domain = make(preset, 1, 0)
        ppo = DecPpo(domain.features, domain.mask, settings)
    for iteration in range(settings.iterations):
        rng = generator(settings.seed, 7, iteration)
        domain = make(preset, settings.envs, derived(settings.seed, 8, iteration))
        rollout = roll(domain, beliefs, sampling(ppo.actors, domain.horizon, settings.envs, rng))
        ppo.update(rollout, reward(rollout), rng, settings.share(iteration), learners)
        yield iteration + 1, ppo, rollout


def optimised(preset: Preset, beliefs: BeliefBank, reward: RewardOf, settings: Settings) -> DecPpo:
    """Fresh networks after all iterations of `optimise`."""
    domain = make(preset, 1, 0)
    ppo = DecPpo(domain.features, domain.mask, settings)
    for _ in optimise(preset, beliefs, reward, settings, ppo):
        pass
    return ppo
