"""The domain through the PettingZoo parallel API (extra `learn`).

One episode at a time, for people who have PettingZoo tools; training uses the vectorised domain.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from cell.errors import ConfigError, one_of
from cell.learn.domain.local import ACTIONS, LOCALS, SIZE
from cell.learn.domain.presets import Preset, preset
from cell.learn.domain.semi_markov import SemiMarkovDomain
from cell.learn.domain.vector import VectorDomain, make
from cell.wire.vocabulary import OnionLocation, Prediction

REWARDS = ("truth", "priced", "shaped")
Observation = dict[str, NDArray[Any]]


class SortingParallelEnv(ParallelEnv[str, Observation, int]):
    """Agents "robot_0", "human_1", ... with common reward.

    Observation of an agent: `observation` (17,) float32 in the published order (onion 4, hand 4,
    prediction 3, interaction 2, own type 2, indicated 2), and `action_mask` (9,) int8. Where actions take
    time a step is an event, and an 18th number says whether the agent is busy. The info of a step holds
    `observed`, the actions as the others see them, and the other rewards.

    Args:
        rules: a preset or its name. reward: "truth", "priced" or "shaped".
    """

    metadata = {"name": "onion_sorting_v0", "render_modes": []}  # noqa: RUF012 (PettingZoo's interface)

    def __init__(self, rules: Preset | str = "paper", reward: str = "priced") -> None:
        self.rules = preset(rules) if isinstance(rules, str) else rules
        if reward not in REWARDS:
            raise ConfigError(f"reward: {one_of(reward, REWARDS)}")
        self.render_mode = None
        self._reward = f"reward_{reward}"
        self.possible_agents = [f"{role}_{i}" for i, role in enumerate(self.rules.agents)]
        self.agents: list[str] = []
        timed = int(self.rules.seconds > 0.0)
        seen = gymnasium.spaces.Dict(
            {
                "observation": gymnasium.spaces.Box(0.0, 1.0, (17 + timed,), np.float32),
                "action_mask": gymnasium.spaces.Box(0, 1, (ACTIONS,), np.int8),
            }
        )
        self.observation_spaces = dict.fromkeys(self.possible_agents, seen)
        self.action_spaces = {agent: gymnasium.spaces.Discrete(ACTIONS) for agent in self.possible_agents}
        self._domain: VectorDomain | None = None
        self._episode = 0
        self._local = np.zeros(0, np.int16)
        self._t = 0

    def observation_space(self, agent: str) -> gymnasium.spaces.Space[Any]:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.spaces.Space[Any]:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start an episode; without a seed the next one of the running sequence."""
        del options
        if seed is not None or self._domain is None:
            self._domain = make(self.rules, 1, 0 if seed is None else seed)
        self._local = self._domain.reset()[0]
        self._t = 0
        self.agents = list(self.possible_agents)
        return self._observations(), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, int]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """One joint step; raises `ConfigError` for an action that the mask forbids (paper's rules)."""
        assert self._domain is not None, "call reset first"
        chosen = np.array([[actions[agent] for agent in self.possible_agents]])
        step = self._domain.step(chosen)
        self._local, self._t = step.local[0], self._t + 1
        over, late = not bool(step.alive[0]), self._t >= self.rules.horizon
        if isinstance(self._domain, SemiMarkovDomain):
            late = late or bool(self._domain.time[0] >= self.rules.seconds)
        info: dict[str, Any] = {
            "observed": step.observed[0].tolist(),
            **{k: float(getattr(step, k)[0]) for k in ("reward_truth", "reward_priced", "reward_shaped")},
        }
        agents, reward = self.agents, float(getattr(step, self._reward)[0])
        if over or late:
            self.agents = []
        return (
            self._observations(agents),
            dict.fromkeys(agents, reward),
            dict.fromkeys(agents, over),
            dict.fromkeys(agents, late and not over),
            {agent: dict(info) for agent in agents},
        )

    def _observations(self, agents: list[str] | None = None) -> dict[str, Observation]:
        assert self._domain is not None
        together = interaction(self._local)
        out = {}
        for agent in self.agents if agents is None else agents:
            i = self.possible_agents.index(agent)
            state = int(self._local[i])
            flag = np.eye(2, dtype=np.float32)[int(together)]
            row = self._domain.features[state]
            out[agent] = {
                "observation": np.concatenate([row[:11], flag, row[11:]]),
                "action_mask": self._domain.mask[i, state].astype(np.int8),
            }
        return out


def interaction(local: NDArray[np.integer]) -> bool:
    """The published environment's derived flag: both agents are at the same stage.

    Both onions Unknown, or both OnConveyor, or both InFront with prediction Good.
    """
    free = local % SIZE  # where actions take time, what the busy twin is the twin of
    onion, prediction = LOCALS.onion[free], LOCALS.prediction[free]
    same = (onion == onion[0]).all()
    if not same:
        return False
    if onion[0] == OnionLocation.IN_FRONT:
        return bool((prediction == Prediction.UNBLEMISHED).all())
    return int(onion[0]) in (OnionLocation.UNKNOWN, OnionLocation.ON_CONVEYOR)
