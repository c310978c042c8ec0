"""Theorem 1 as a diagnostic: its terms measured on a trained run, and the steps of its proof checked.

The theorem bounds the log-likelihood gap by 8 N eps / (1 - gamma (1 - delta / 2)), with eps the
discriminator's distance from 1/2 and delta the contraction of successive belief changes (Eq. 8).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from cell.learn.belief.eq3 import Kernel
from cell.learn.discriminator import Discriminator, Transitions
from cell.learn.networks import Actors
from cell.learn.rollout import Rollout
from cell.wire.vocabulary import Action

DELTAS = (0.0, 0.5, 0.9, 1.0)


@dataclass(frozen=True)
class Theorem1:
    """What was measured.

    Attributes:
        agents, gamma: of the run.
        error: share of misclassified transitions (1/2 at equilibrium).
        eps_mean, eps_p99, eps_max: of |D - 1/2| over expert and policy transitions.
        policy_gap: expert's minus learner's discounted log-likelihood of the expert's actions
            (the expert is deterministic: its own is 0).
        reward_gap: same for the learned reward, expert's minus policy's transitions, discounted.
        bounds: per eps kind and delta, the theorem's right-hand side.
        safe_bound: 2 N artanh(2 eps_p99) / (1 - gamma), which holds without any delta.
        expansion: share of steps whose belief change exceeds the one before (contraction fails there).
        largest_ratio: the largest such ratio.
        last_step_holds: whether 2 ln((1/2 + eps) / (1/2 - eps)) <= 8 eps at eps_mean (Eq. 9's last
            step per agent; it is 4 artanh(2 eps), so it fails for every eps > 0).
        per_step_holds: whether |logit D| <= 8 eps there, which is what the bound needs.
    """

    agents: int
    gamma: float
    error: float
    eps_mean: float
    eps_p99: float
    eps_max: float
    policy_gap: float
    reward_gap: float
    bounds: dict[str, dict[str, float]]
    safe_bound: float
    expansion: float
    largest_ratio: float
    last_step_holds: bool
    per_step_holds: bool

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def bound(agents: int, eps: float, gamma: float, delta: float) -> float:
    """Theorem 1's right-hand side: 8 N eps / (1 - gamma (1 - delta / 2))."""
    return 8.0 * agents * eps / (1.0 - gamma * (1.0 - delta / 2.0))


def contraction(kernel: Kernel) -> dict[str, float | None]:
    """Dobrushin's coefficient of Eq. 3's kernel for each observed action: the delta it contracts by.

    None where a row was never seen, for then the kernel, and with it delta, is not defined.
    """
    apart = 0.5 * np.abs(kernel.table[:, 0] - kernel.table[:, 1]).sum(-1)  # (A,)
    return {a.name.lower(): float(apart[a]) if kernel.seen[a].all() else None for a in Action}


@torch.no_grad()
def measure(discriminator: Discriminator, actors: Actors, expert: Rollout, policy: Rollout) -> Theorem1:
    """All terms, on rollouts of the expert and of the (sampled) learner under one belief module."""
    gamma, agents = discriminator.settings.gamma, actors.agents
    of_expert, of_policy = expert.transitions(), policy.transitions()
    logit_expert = discriminator.logits(of_expert, actors).double()
    logit_policy = discriminator.logits(of_policy, actors).double()
    d = torch.cat((torch.sigmoid(logit_expert), torch.sigmoid(logit_policy)))
    eps = (d - 0.5).abs().numpy()
    wrong = torch.cat((logit_expert <= 0, logit_policy > 0)).double().mean()
    kinds = {"mean": float(eps.mean()), "p99": float(np.quantile(eps, 0.99)), "max": float(eps.max())}
    p99 = min(kinds["p99"], 0.5 - 1e-9)
    mean = min(kinds["mean"], 0.5 - 1e-9)
    ratios = change_ratios(expert.belief.numpy())
    return Theorem1(
        agents=agents,
        gamma=gamma,
        error=float(wrong),
        eps_mean=kinds["mean"],
        eps_p99=kinds["p99"],
        eps_max=kinds["max"],
        policy_gap=_likelihood_gap(actors, of_expert, expert.action.shape, gamma),
        reward_gap=_discounted(logit_expert, expert.action.shape, gamma)
        - _discounted(logit_policy, policy.action.shape, gamma),
        bounds={k: {f"{x:g}": bound(agents, e, gamma, x) for x in DELTAS} for k, e in kinds.items()},
        safe_bound=2.0 * agents * math.atanh(2.0 * p99) / (1.0 - gamma),
        expansion=float((ratios > 1.0).mean()) if len(ratios) else 0.0,
        largest_ratio=float(ratios.max()) if len(ratios) else 0.0,
        last_step_holds=4.0 * math.atanh(2.0 * mean) <= 8.0 * mean,
        per_step_holds=2.0 * math.atanh(2.0 * mean) <= 8.0 * mean,
    )


def change_ratios(belief: NDArray[np.float32]) -> NDArray[np.float64]:
    """|b(t+2) - b(t+1)| / |b(t+1) - b(t)| of the robot's beliefs (T + 1, E, N, K), where defined."""
    change = np.abs(np.diff(belief[:, :, 0, 0].astype(np.float64), axis=0))
    before, after = change[:-1].ravel(), change[1:].ravel()
    moved = before > 1e-9
    return after[moved] / before[moved]


def _likelihood_gap(actors: Actors, pool: Transitions, shape: torch.Size, gamma: float) -> float:
    log_pi = actors.log_prob(pool.local, pool.belief, pool.action).sum(-1).double()
    return -_discounted(log_pi, shape, gamma)


def _discounted(values: torch.Tensor, shape: torch.Size, gamma: float) -> float:
    """Mean over episodes of sum_t gamma^t values, for values (T E,) in order of time."""
    weight = gamma ** torch.arange(shape[0], dtype=torch.float64)
    return float((values.view(shape[0], shape[1]) * weight[:, None]).sum(0).mean())
