"""The discriminator: D = e^f / (e^f + pi), f = g(s, b, a) + gamma h(s', b') - h(s, b).

g is the reward, h a shaping potential; both see the states, beliefs and actions of all agents pooled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from cell.learn.networks import ACTIONS, Actors, JointEncoder, mlp
from cell.learn.settings import Settings


@dataclass(frozen=True)
class Transitions:
    """A pool of joint transitions (s, b, a, s', b').

    Attributes:
        local, next_local: (M, N) int64. belief, next_belief: (M, N, K) float32. action: (M, N) int64.
    """

    local: Tensor
    belief: Tensor
    action: Tensor
    next_local: Tensor
    next_belief: Tensor

    def __len__(self) -> int:
        return len(self.local)

    def take(self, index: Tensor | slice) -> Transitions:
        """The transitions at `index` (I,)."""
        return Transitions(
            self.local[index],
            self.belief[index],
            self.action[index],
            self.next_local[index],
            self.next_belief[index],
        )

    @staticmethod
    def join(parts: list[Transitions]) -> Transitions:
        """All transitions of several pools."""
        return Transitions(
            torch.cat([p.local for p in parts]),
            torch.cat([p.belief for p in parts]),
            torch.cat([p.action for p in parts]),
            torch.cat([p.next_local for p in parts]),
            torch.cat([p.next_belief for p in parts]),
        )


@dataclass(frozen=True)
class Source:
    """What the discriminator tells apart: expert and policy transitions, and the policy's actors."""

    expert: Transitions
    policy: Transitions
    actors: Actors


class Reward(nn.Module):
    """f and its two networks."""

    def __init__(
        self, features: NDArray[np.float32], agents: int, settings: Settings, rng: torch.Generator
    ) -> None:
        super().__init__()
        self.gamma = settings.gamma
        self.encode = JointEncoder(features, agents, settings.beliefs)
        self.g = mlp((self.encode.width + agents * ACTIONS, *settings.reward_hidden, 1), nn.ReLU, rng)
        self.h = mlp((self.encode.width, *settings.reward_hidden, 1), nn.ReLU, rng)
        self.register_buffer("one_hot", torch.eye(ACTIONS), persistent=False)

    def forward(self, t: Transitions) -> Tensor:
        """f(s, b, a, s', b') = g(s, b, a) + gamma h(s', b') - h(s, b): (M,).

        An episode ends by its time limit alone, so h(s', b') counts there as everywhere.
        """
        here, there = self.encode(t.local, t.belief), self.encode(t.next_local, t.next_belief)
        potential: Tensor = self.h(torch.cat((here, there)))[:, 0]
        g = self.task(here, t.action)
        return g + self.gamma * potential[len(here) :] - potential[: len(here)]

    def task(self, encoded: Tensor, action: Tensor) -> Tensor:
        """g alone: (M,)."""
        acts: Tensor = self.get_buffer("one_hot")[action].flatten(1)
        g: Tensor = self.g(torch.cat((encoded, acts), dim=-1))
        return g[:, 0]


class Discriminator:
    """f, its optimiser and its loss."""

    def __init__(
        self, features: NDArray[np.float32], agents: int, settings: Settings, rng: torch.Generator
    ) -> None:
        self.settings = settings
        self.f = Reward(features, agents, settings, rng)
        self.optimiser = torch.optim.Adam(self.f.parameters(), lr=settings.lr_discriminator, fused=True)

    def set_share(self, share: float) -> None:
        """Scale the step size (annealing)."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.settings.lr_discriminator * share

    def logits(self, t: Transitions, actors: Actors) -> Tensor:
        """log D - log(1 - D) = f - log pi, pi = product over agents of pi_i(a_i | s_i, b_i): (M,)."""
        with torch.no_grad():
            log_pi = actors.log_prob(t.local, t.belief, t.action).sum(-1)
        out: Tensor = self.f(t) - log_pi
        return out

    @torch.no_grad()
    def reward(self, t: Transitions, actors: Actors) -> Tensor:
        """Eq. 2: R = log D - log(1 - D) (M,)."""
        return self.logits(t, actors)

    def train(self, sources: Sequence[Source], rng: torch.Generator) -> float:
        """Eq. 5: binary cross-entropy of expert (1) against policy (0) transitions.

        Args:
            sources: one, or one per task when several tasks share a reward; each gives an equal part
                of every batch.

        Returns:
            Accuracy over all batches of this call.
        """
        steps = self.settings.discriminator_steps
        batch = max(1, self.settings.discriminator_batch // len(sources))
        pools: list[Transitions] = []
        log_pis: list[Tensor] = []
        for source in sources:
            for side in (source.expert, source.policy):
                pool = side.take(torch.randint(len(side), (steps * batch,), generator=rng))
                pools.append(pool)
                with torch.no_grad():  # the policy stands still meanwhile: one evaluation for all steps
                    log_pis.append(source.actors.log_prob(pool.local, pool.belief, pool.action).sum(-1))
        truth = torch.cat((torch.ones(batch), torch.zeros(batch))).repeat(len(sources))
        right = 0
        for step in range(steps):
            part = slice(step * batch, (step + 1) * batch)
            with torch.autocast("cpu", torch.bfloat16, enabled=self.settings.bfloat16):
                f = self.f(Transitions.join([pool.take(part) for pool in pools]))
            logit = f.float() - torch.cat([log_pi[part] for log_pi in log_pis])
            loss = functional.binary_cross_entropy_with_logits(logit, truth)
            self.optimiser.zero_grad(set_to_none=True)
            torch.autograd.backward(loss)
            nn.utils.clip_grad_norm_(self.f.parameters(), self.settings.max_grad_norm)
            self.optimiser.step()
            right += int(((logit.detach() > 0.0) == (truth > 0.5)).sum())
        return right / (len(truth) * steps)
