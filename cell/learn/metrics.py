"""Means, spreads and confidence intervals of episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from cell.learn.rollout import Rollout


class Statistic(TypedDict):
    """Mean and standard deviation between episodes, half width of the mean's 95 % interval."""

    mean: float
    sd: float
    ci95: float


def statistic(values: Sequence[float] | NDArray[np.generic]) -> Statistic:
    """Of samples (n,), n >= 1."""
    data = np.asarray(values, np.float64)
    sd = float(data.std(ddof=1)) if len(data) > 1 else 0.0
    return {"mean": float(data.mean()), "sd": sd, "ci95": 1.96 * sd / float(np.sqrt(len(data)))}


def summary(rollout: Rollout) -> dict[str, Statistic]:
    """What is reported of episodes."""
    return {
        "onions": statistic(rollout.onions),
        "reward_truth": statistic(rollout.returns("truth")),
        "reward_priced": statistic(rollout.returns("priced")),
        "reward_shaped": statistic(rollout.returns("shaped")),
        "priced_steps": statistic(rollout.priced_steps),
        "switches": statistic(rollout.switches),
        "wrong": statistic(rollout.wrong),
    }
