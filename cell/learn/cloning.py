"""Behaviour cloning, the floor: maximum likelihood of the expert's actions, no environment needed."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from cell.learn.discriminator import Transitions
from cell.learn.networks import Actors, generator
from cell.learn.settings import Settings


def clone(
    features: NDArray[np.float32],
    mask: NDArray[np.bool_],
    expert: Transitions,
    settings: Settings,
    updates: int = 1000,
    batch: int = 512,
) -> Actors:
    """Actors that maximise log pi_i(a_i | s_i, b_i) of the expert's actions.

    Args:
        features: (L, F). mask: (N, L, A). expert: demonstrations. settings: seed, sizes, step size
            (`lr_actor`, falling linearly to a tenth), and whether beliefs are seen.
    """
    rng = generator(settings.seed, 6)
    actors = Actors(features, mask, settings.policy_hidden, settings.beliefs, generator(settings.seed, 1))
    optimiser = torch.optim.Adam(actors.parameters(), lr=settings.lr_actor, fused=True)
    for update in range(updates):
        index = torch.randint(len(expert), (batch,), generator=rng)
        loss = -actors.log_prob(expert.local[index], expert.belief[index], expert.action[index]).sum(1).mean()
        for group in optimiser.param_groups:
            group["lr"] = settings.lr_actor * (1.0 - 0.9 * update / updates)
        optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        optimiser.step()
    return actors
