"""The beliefs of all agents over all others: M_i = (Theta_-i, b_i, F_i) for every i."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cell.errors import ConfigError
from cell.learn.belief.tracker import BeliefTracker, robot_type


class BeliefBank:
    """One tracker per observed agent; all others share it, since all observe the same actions.

    Args:
        about: tracker of each agent's type as its partners see it, in agent order (N >= 2).
    """

    def __init__(self, about: Sequence[BeliefTracker]) -> None:
        if len(about) < 2:
            raise ConfigError(f"beliefs need at least two agents, got {len(about)}")
        self.about = tuple(about)
        n = len(about)
        self._others = np.array([[j for j in range(n) if j != i] for i in range(n)])  # (N, K)

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        """Beliefs at the start: (E, N, K), agent i's over the others in agent order."""
        return self._spread([tracker.reset(n_envs) for tracker in self.about])

    def update(self, observed: NDArray[np.int8]) -> NDArray[np.float32]:
        """Beliefs after the observed joint action (E, N): (E, N, K)."""
        return self._spread([tracker.update(observed[:, j]) for j, tracker in enumerate(self.about)])

    def _spread(self, about: list[NDArray[np.float32]]) -> NDArray[np.float32]:
        return np.stack(about, axis=-1)[:, self._others]


def bank(agents: Sequence[str], people: Sequence[BeliefTracker], start: float = 0.0) -> BeliefBank:
    """Trackers for named agents: robots by their own announcements, people by the given trackers.

    Args:
        agents: names; those that begin with "robot" are robots.
        people: one tracker per person, in agent order.
        start: P(type 1) of a robot before it announced anything.
    """
    given = iter(people)
    count = sum(not name.startswith("robot") for name in agents)
    if count != len(people):
        raise ConfigError(f"{count} of the agents {', '.join(agents)} are people, got {len(people)} trackers")
    return BeliefBank([robot_type(start) if n.startswith("robot") else next(given) for n in agents])
