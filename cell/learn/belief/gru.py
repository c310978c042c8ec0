"""The learned belief: a GRU cell (64 hidden, tanh) with a softmax over the partner's next type.

Pre-trained on whole episodes against ground-truth types by cross-entropy with Adam, then frozen.
A network trained at one recovery time learns to count to it; train on several.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from cell.errors import ConfigError
from cell.learn.networks import ACTIONS, generator

HIDDEN = 64


@dataclass(frozen=True)
class TypeData:
    """Episodes of one partner, for training and testing beliefs.

    Attributes:
        observed: (T, E) int8 actions. types: (T + 1, E) int8, before the first and after each action.
    """

    observed: NDArray[np.int8]
    types: NDArray[np.int8]

    @staticmethod
    def join(parts: list[TypeData]) -> TypeData:
        """All episodes of several sets (of equal length)."""
        return TypeData(
            np.concatenate([p.observed for p in parts], axis=1),
            np.concatenate([p.types for p in parts], axis=1),
        )


class GruNet(nn.Module):
    """GRU cell and head; `prior` is P(fatigued) before anything was observed."""

    def __init__(self, rng: torch.Generator | None = None) -> None:
        super().__init__()
        self.gru = nn.GRU(ACTIONS, HIDDEN)  # one cell, unrolled over an episode
        self.head = nn.Linear(HIDDEN, 2)
        self.register_buffer("prior", torch.tensor(0.0))
        if rng is not None:
            with torch.no_grad():
                for p in self.parameters():
                    p.uniform_(-(HIDDEN**-0.5), HIDDEN**-0.5, generator=rng)

    def forward(self, observed: Tensor) -> Tensor:
        """Observed actions (T, E) -> logits of the type after each (T, E, 2)."""
        states, _ = self.gru(functional.one_hot(observed.long(), ACTIONS).float())
        out: Tensor = self.head(states)
        return out


def train_gru(
    data: TypeData,
    seed: int,
    updates: int = 400,
    episodes: int = 100,
    lr: float = 3e-3,
    progress: Callable[[int, float], None] | None = None,
) -> GruNet:
    """Fit the belief network.

    Args:
        data: whole episodes. updates: Adam steps, each on `episodes` episodes; the step size falls
            to a tenth by a cosine. progress: told (update, loss).
    """
    rng = generator(seed, 11)
    net = GruNet(rng)
    optimiser = torch.optim.Adam(net.parameters(), lr=lr, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates, lr / 10)
    observed = torch.from_numpy(data.observed.astype(np.int64))
    types = torch.from_numpy(data.types[1:].astype(np.int64))
    for update in range(updates):
        pick = torch.randint(observed.shape[1], (episodes,), generator=rng)
        logits: Tensor = net(observed[:, pick])
        loss = functional.cross_entropy(logits.flatten(0, 1), types[:, pick].flatten())
        optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        if progress is not None:
            progress(update, float(loss.detach()))
    net.get_buffer("prior").fill_(float(data.types[0].mean()))
    return net.requires_grad_(False)


class GruBelief:
    """Belief tracker by a frozen GRU: one step costs two small products for all environments."""

    def __init__(self, net: GruNet) -> None:
        weight = {name: value.detach().clone() for name, value in net.gru.named_parameters()}
        self._from_action = weight["weight_ih_l0"].t().contiguous() + weight["bias_ih_l0"]  # (A, 3 H)
        self._from_state = weight["weight_hh_l0"].t().contiguous()
        self._bias = weight["bias_hh_l0"]
        head = net.head.weight.detach(), net.head.bias.detach()
        self._head = (head[0][1] - head[0][0]).contiguous()  # softmax of two = sigmoid of the difference
        self._head_bias = float(head[1][1] - head[1][0])
        self._prior = float(net.get_buffer("prior"))
        self._state = torch.zeros(0, HIDDEN)

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        self._state = torch.zeros(n_envs, HIDDEN)
        return np.full(n_envs, self._prior, np.float32)

    def update(self, observed: NDArray[np.int8]) -> NDArray[np.float32]:
        with torch.inference_mode():
            x = self._from_action[torch.from_numpy(observed.astype(np.int64))]
            s = torch.addmm(self._bias, self._state, self._from_state)
            gates = torch.sigmoid(x[:, : 2 * HIDDEN] + s[:, : 2 * HIDDEN])
            reset, keep = gates[:, :HIDDEN], gates[:, HIDDEN:]
            new = torch.tanh(x[:, 2 * HIDDEN :] + reset * s[:, 2 * HIDDEN :])
            self._state = torch.lerp(new, self._state, keep)
            belief: NDArray[np.float32] = torch.sigmoid(self._state @ self._head + self._head_bias).numpy()
        return belief


def save_gru(net: GruNet, path: Path, about: dict[str, str]) -> None:
    """Write the weights (safetensors) and what they were trained on (text metadata)."""
    from safetensors.torch import save_file

    save_file({k: v.contiguous() for k, v in net.state_dict().items()}, path, metadata=about)


def load_gru(path: Path) -> GruNet:
    """Read weights written by `save_gru`.

    Raises:
        ConfigError: missing, damaged or of another shape.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        state = load_file(path)
    except (OSError, SafetensorError) as error:
        raise ConfigError(f"cannot read belief weights {path}: {error}") from None
    net = GruNet()
    expected = {name: tuple(value.shape) for name, value in net.state_dict().items()}
    if {name: tuple(value.shape) for name, value in state.items()} != expected:
        raise ConfigError(f"{path} does not hold belief weights; expected tensors {expected}")
    net.load_state_dict(state)
    return net.requires_grad_(False)
