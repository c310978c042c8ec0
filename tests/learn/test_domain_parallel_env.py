"""The PettingZoo form of the domain, by PettingZoo's own checks."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

pytest.importorskip("pettingzoo")

from pettingzoo.test import parallel_api_test

from cell.errors import ConfigError
from cell.learn.domain.parallel_env import SortingParallelEnv, interaction


@pytest.mark.parametrize("name", ["paper", "released", "cell"])
def test_pettingzoos_own_test(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        parallel_api_test(SortingParallelEnv(name), num_cycles=250)


@pytest.mark.parametrize("name", ["paper", "cell"])
def test_a_seed_repeats_an_episode(name: str) -> None:
    env = SortingParallelEnv(name)

    def episode() -> list[float]:
        observations, _ = env.reset(seed=7)
        choose, rewards = np.random.default_rng(1), []
        while env.agents:
            actions = {
                a: int(choose.choice(np.flatnonzero(o["action_mask"]))) for a, o in observations.items()
            }
            observations, reward, _, _, _ = env.step(actions)
            rewards.append(reward["robot_0"])
        return rewards

    first = episode()
    assert first == episode()
    assert len(first) == 100 if name == "paper" else 100 < len(first) < 400


def test_unknown_rewards_are_named() -> None:
    with pytest.raises(ConfigError, match="truth, priced, shaped"):
        SortingParallelEnv("paper", reward="onions")


def test_interaction_is_the_published_flag() -> None:
    from cell.learn.domain.local import START, local_id

    assert interaction(np.array([START, START]))
    assert interaction(np.array([local_id(2, 2, 2, 0, 1)] * 2))
    assert not interaction(np.array([local_id(2, 2, 1, 0, 1)] * 2))
    assert not interaction(np.array([local_id(3, 3, 2, 0, 1)] * 2))
    assert not interaction(np.array([START, local_id(1, 3, 2, 0, 1)]))
