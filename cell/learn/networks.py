"""The networks: decentralised actors, the centralised critic, and the discriminator's g and h.

Shapes: B samples, N agents, K = N - 1 partners, L local ids, F features per local id, A = 9 actions.
An agent's belief is P(partner fatigued) for each partner in agent order, (B, N, K).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

ACTIONS = 9
_NEVER = -1e9


def generator(*seed: int) -> torch.Generator:
    """A torch generator seeded by a sequence of integers (mixed by numpy's SeedSequence)."""
    state = np.random.SeedSequence(list(seed)).generate_state(2, np.uint32)
    made = torch.Generator()
    made.manual_seed(int(state[0]) << 31 | int(state[1]) >> 1)
    return made


def types(belief: Tensor) -> Tensor:
    """P(fatigued) (..., K) -> distributions over {unfatigued, fatigued}, flattened: (..., 2 K)."""
    return torch.stack((1.0 - belief, belief), dim=-1).flatten(-2)


class Stack(nn.Module):
    """N networks of one shape and separate parameters, evaluated by one batched product per layer."""

    def __init__(self, copies: int, sizes: Sequence[int], last_gain: float, rng: torch.Generator) -> None:
        super().__init__()
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for layer, (inputs, outputs) in enumerate(pairwise(sizes)):
            last = layer == len(sizes) - 2
            weight = torch.empty(copies, inputs, outputs)
            for copy in range(copies):
                nn.init.orthogonal_(weight[copy], last_gain if last else math.sqrt(2.0), generator=rng)
            self.weights.append(nn.Parameter(weight))
            self.biases.append(nn.Parameter(torch.zeros(copies, 1, outputs)))

    def forward(self, x: Tensor) -> Tensor:
        """(N, B, inputs) -> (N, B, outputs); tanh between layers."""
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = torch.baddbmm(bias, x, weight)
            if layer < last:
                x = torch.tanh(x)
        return x


class Actors(nn.Module):
    """Decentralised policies pi_i(a_i | s_i, b_i), masked to the actions each agent may choose.

    Args:
        features: (L, F). mask: (N, L, A); a state without any legal action is left unmasked.
        beliefs: False: pi_i(a_i | s_i), as in Dec-AIRL.
    """

    features: Tensor
    illegal: Tensor

    def __init__(
        self,
        features: NDArray[np.float32],
        mask: NDArray[np.bool_],
        hidden: Sequence[int],
        beliefs: bool,
        rng: torch.Generator,
    ) -> None:
        super().__init__()
        self.agents = mask.shape[0]
        self.beliefs = beliefs
        inputs = features.shape[1] + (2 * (self.agents - 1) if beliefs else 0)
        self.net = Stack(self.agents, (inputs, *hidden, ACTIONS), 0.01, rng)
        legal = mask | ~mask.any(-1, keepdims=True)
        self.register_buffer("features", torch.from_numpy(features.copy()), persistent=False)
        self.register_buffer(
            "illegal", torch.from_numpy(np.where(legal, 0.0, _NEVER)).float(), persistent=False
        )
        self.register_buffer("rows", torch.arange(self.agents)[:, None], persistent=False)

    def forward(self, local: Tensor, belief: Tensor) -> Tensor:
        """Masked log-probabilities.

        Args:
            local: (B, N) local ids. belief: (B, N, K).

        Returns:
            (N, B, A).
        """
        local = local.t()
        x = self.features[local]
        if self.beliefs:
            x = torch.cat((x, types(belief).transpose(0, 1)), dim=-1)
        out: Tensor = self.net(x) + self.illegal[self.get_buffer("rows"), local]
        return functional.log_softmax(out, dim=-1)

    def log_prob(self, local: Tensor, belief: Tensor, action: Tensor) -> Tensor:
        """log pi_i(a_i | s_i, b_i): (B, N) for actions (B, N)."""
        table: Tensor = self(local, belief)
        return table.gather(-1, action.t()[..., None])[..., 0].t()


class JointEncoder(nn.Module):
    """Pooled (s, b) of all agents as one vector: (B, N F + N 2 K)."""

    features: Tensor

    def __init__(self, features: NDArray[np.float32], agents: int, beliefs: bool) -> None:
        super().__init__()
        self.beliefs = beliefs
        self.width = agents * features.shape[1] + (agents * 2 * (agents - 1) if beliefs else 0)
        self.register_buffer("features", torch.from_numpy(features.copy()), persistent=False)

    def forward(self, local: Tensor, belief: Tensor) -> Tensor:
        """(B, N), (B, N, K) -> (B, width)."""
        x = self.features[local].flatten(1)
        return torch.cat((x, types(belief).flatten(1)), dim=-1) if self.beliefs else x


def mlp(sizes: Sequence[int], activation: type[nn.Module], rng: torch.Generator) -> nn.Sequential:
    """A plain network with Kaiming-uniform weights drawn from `rng`."""
    layers: list[nn.Module] = []
    for layer, (inputs, outputs) in enumerate(pairwise(sizes)):
        linear = nn.Linear(inputs, outputs)
        bound = 1.0 / math.sqrt(inputs)
        with torch.no_grad():
            linear.weight.uniform_(-bound, bound, generator=rng)
            linear.bias.uniform_(-bound, bound, generator=rng)
        layers += [linear] if layer == len(sizes) - 2 else [linear, activation()]
    return nn.Sequential(*layers)


class Critic(nn.Module):
    """One centralised critic V(s, b) on the joint state and all beliefs.

    With `alphas` = 0 it is a network of (s, b). Otherwise it is the paper's
    V(s, b) = max_k sum_theta b(theta) alpha_k(s, theta): the network of s alone gives, for each of the
    `alphas` vectors, one value per joint type theta; b(theta) is the product over agents of what
    their partners believe of them (mean over partners).
    """

    def __init__(
        self,
        features: NDArray[np.float32],
        agents: int,
        hidden: Sequence[int],
        beliefs: bool,
        rng: torch.Generator,
        alphas: int = 0,
    ) -> None:
        super().__init__()
        self.agents, self.alphas = agents, alphas if beliefs else 0
        self.encode = JointEncoder(features, agents, beliefs and not alphas)
        outputs = self.alphas * 2**agents if self.alphas else 1
        self.net = mlp((self.encode.width, *hidden, outputs), nn.Tanh, rng)

    def forward(self, local: Tensor, belief: Tensor) -> Tensor:
        """(B, N), (B, N, K) -> (B,)."""
        out: Tensor = self.net(self.encode(local, belief))
        if not self.alphas:
            return out[:, 0]
        weight = joint_types(believed(belief))
        return (out.view(len(out), self.alphas, -1) * weight[:, None]).sum(-1).amax(-1)


def believed(belief: Tensor) -> Tensor:
    """What the others believe of each agent, mean over observers: (B, N, K) -> (B, N)."""
    n = belief.shape[1]
    about = [
        torch.stack([belief[:, i, j - (j > i)] for i in range(n) if i != j], dim=-1).mean(-1)
        for j in range(n)
    ]
    return torch.stack(about, dim=-1)


def joint_types(fatigued: Tensor) -> Tensor:
    """Product distribution over the 2^N joint types, agent i as bit i: (B, N) -> (B, 2^N)."""
    joint = torch.ones(len(fatigued), 1)
    for agent in range(fatigued.shape[1]):
        p = fatigued[:, agent, None]
        joint = torch.cat((joint * (1.0 - p), joint * p), dim=-1)
    return joint
