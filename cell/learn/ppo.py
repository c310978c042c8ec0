"""TB-Dec-PPO: decentralised actors on (s_i, b_i), one centralised critic on the joint (s, b).

The reward is common, so one advantage serves every agent; each actor's clipped objective has its own
probability ratio, its own gradient and its own gradient norm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cell.learn.networks import Actors, Critic, generator
from cell.learn.rollout import Rollout
from cell.learn.settings import Settings


@dataclass(frozen=True)
class PpoReport:
    """Means over the last epoch: entropy per agent [nats], squared error of V, share of clipped ratios."""

    entropy: float
    value_loss: float
    clipped: float


class DecPpo:
    """Actors, critic and their optimisers.

    Args:
        features: (L, F). mask: (N, L, A) legal actions.
    """

    def __init__(self, features: NDArray[np.float32], mask: NDArray[np.bool_], settings: Settings) -> None:
        self.settings = settings
        agents = mask.shape[0]
        seed = settings.seed
        self.actors = Actors(features, mask, settings.policy_hidden, settings.beliefs, generator(seed, 1))
        alphas = settings.alpha_vectors if settings.value == "alpha" else 0
        self.critic = Critic(
            features, agents, settings.policy_hidden, settings.beliefs, generator(seed, 2), alphas
        )
        self.actor_optimiser = torch.optim.Adam(self.actors.parameters(), lr=settings.lr_actor, fused=True)
        self.critic_optimiser = torch.optim.Adam(self.critic.parameters(), lr=settings.lr_critic, fused=True)

    def set_share(self, share: float) -> None:
        """Scale the step sizes (annealing)."""
        for optimiser, rate in (
            (self.actor_optimiser, self.settings.lr_actor),
            (self.critic_optimiser, self.settings.lr_critic),
        ):
            for group in optimiser.param_groups:
                group["lr"] = rate * share

    @torch.no_grad()
    def advantages(self, rollout: Rollout, reward: Tensor) -> tuple[Tensor, Tensor]:
        """GAE of A = Q - V (the paper's advantage), for a common reward (T, E).

        Episodes end by their time limit, which the agents do not see: the value of the last state counts.

        Returns:
            advantages and value targets, both (T E,) in order of time.
        """
        steps, envs = reward.shape
        value = self.critic(rollout.local.flatten(0, 1), rollout.belief.flatten(0, 1)).view(steps + 1, envs)
        gamma, lam = self.settings.gamma, self.settings.gae_lambda
        delta = reward + gamma * value[1:] - value[:-1]
        advantage = torch.empty_like(delta)
        running = torch.zeros(envs)
        for t in range(steps - 1, -1, -1):
            running = delta[t] + gamma * lam * running
            advantage[t] = running
        return advantage.flatten(), (advantage + value[:-1]).flatten()

    def update(
        self,
        rollout: Rollout,
        reward: Tensor,
        rng: torch.Generator,
        share: float = 1.0,
        learners: Sequence[int] | None = None,
    ) -> PpoReport:
        """Some epochs of the clipped objective on one rollout.

        Args:
            reward: (T, E), common to all agents. share: of step sizes and entropy bonus.
            learners: agents whose actors learn (None: all).
        """
        settings = self.settings
        self.set_share(share)
        advantage, target = self.advantages(rollout, reward)
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        pool = rollout.transitions()
        learns = torch.zeros(self.actors.agents)
        learns[list(range(self.actors.agents) if learners is None else learners)] = 1.0
        with torch.no_grad():
            before = self.actors.log_prob(pool.local, pool.belief, pool.action)  # (M, N)
        totals, count = torch.zeros(3), 0
        for epoch in range(settings.epochs):
            order = torch.randperm(len(pool), generator=rng)
            for index in torch.split(order, settings.minibatch):
                local, belief, action = pool.local[index], pool.belief[index], pool.action[index]
                table: Tensor = self.actors(local, belief)
                log_p = table.gather(-1, action.t()[..., None])[..., 0].t()
                ratio = torch.exp(log_p - before[index])
                gain = advantage[index, None]
                clipped = ratio.clamp(1.0 - settings.clip, 1.0 + settings.clip)
                objective = torch.minimum(ratio * gain, clipped * gain).mean(0)  # (N,)
                entropy = -(table.exp() * table.clamp_min(-50.0)).sum(-1).mean(1)  # (N,)
                loss = -((objective + share * settings.entropy * entropy) * learns).sum()
                self.actor_optimiser.zero_grad(set_to_none=True)
                torch.autograd.backward(loss)
                clip_per_agent(self.actors, settings.max_grad_norm)
                self.actor_optimiser.step()

                error = (self.critic(local, belief) - target[index]).square().mean()
                self.critic_optimiser.zero_grad(set_to_none=True)
                torch.autograd.backward(error)
                nn.utils.clip_grad_norm_(self.critic.parameters(), settings.max_grad_norm)
                self.critic_optimiser.step()
                if epoch == settings.epochs - 1:
                    outside = (ratio != clipped).float().mean()
                    totals += torch.stack((entropy.mean(), error, outside)).detach()
                    count += 1
        return PpoReport(*(float(v) for v in totals / count))


@torch.no_grad()
def clip_per_agent(actors: Actors, limit: float) -> None:
    """Scale each agent's gradient to a norm of at most `limit` (the stacked actors stay independent)."""
    gradients = [p.grad for p in actors.parameters() if p.grad is not None]
    norm = torch.stack([g.square().sum((1, 2)) for g in gradients]).sum(0).sqrt()
    scale = (limit / (norm + 1e-6)).clamp_max(1.0)[:, None, None]
    for gradient in gradients:
        gradient.mul_(scale)
