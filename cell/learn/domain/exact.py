"""What is best: the robot's best response to the expert human, exactly.

The published human does not react to the robot, so it is a Markov chain over its local state and
its phase of fatigue. With that chain known, the best robot follows from backward induction over
the episode; it is an upper bound for every policy that has to guess the human's type. QMDP on the
exact filter is a policy that only sees what can be observed, and so a lower bound of the best of
those. One robot, one human, acting in step; fixed or random starts, the paper's rules or the
published ones (there the robot's only choice is what to do with a held onion).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.errors import ConfigError
from cell.learn.domain.experts import expert_actions
from cell.learn.domain.local import ACTIONS, LOCALS, SIZE
from cell.learn.domain.presets import Preset, confusion
from cell.learn.domain.rules import Tables, forced, kind_chances, phases, tables
from cell.learn.domain.starts import start_chances
from cell.wire.vocabulary import Action

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class HumanChain:
    """The expert human by itself: H states that can occur, each a local state and a phase.

    Attributes:
        local, phase: (H,). action: (H,) what the human does in each. move: (H, H) transition matrix.
        reward: (H,) expected sorting reward of the action. start: (H,) chances at the start.
        types: per label (hidden, own, announced) (H,) type in that state.
    """

    local: NDArray[np.int64]
    phase: NDArray[np.int64]
    action: NDArray[np.int64]
    move: Floats
    reward: Floats
    start: Floats
    types: dict[str, NDArray[np.int64]]


def solvable(rules: Preset) -> bool:
    """Whether the exact solution speaks of a preset: one robot and one human, acting in step."""
    return rules.agents == ("robot", "human") and rules.seconds == 0.0


def human_chain(rules: Preset) -> HumanChain:
    """Enumerate the human's states from where episodes start.

    Raises:
        ConfigError: the preset has other agents than one robot and one human.
    """
    if not solvable(rules):
        raise ConfigError("the exact solution is for one robot and one human, in steps")
    table, policy = tables(rules, "human"), expert_actions(rules, 1)[:, 0]
    after, fatigued = phases(rules)
    begin = start_chances(rules, "human")
    rest = len(fatigued) - 1
    waiting = [(int(s), rest * int(LOCALS.own_type[s] == 1)) for s in np.flatnonzero(begin)]
    found = {key: k for k, key in enumerate(waiting)}
    moves, rewards = [], []
    while waiting:
        local, phase = waiting.pop(0)
        action = int(policy[local])
        chances, reward = kind_chances(rules, local, action), 0.0
        placed = int(action in (Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN))
        here: dict[tuple[int, int], float] = {}
        for kind in np.flatnonzero(chances):
            following = int(table.following[local, fatigued[phase], action, kind])
            reward += placed * chances[kind] * (1 - 2 * table.wrong[local, action, kind])
            for drawn in after[phase, placed]:
                key = following, int(drawn)
                here[key] = here.get(key, 0.0) + chances[kind] / after.shape[2]
        for key in here:
            if key not in found:
                found[key] = len(found)
                waiting.append(key)
        moves.append(here)
        rewards.append(reward)
    locals_, phases_ = np.array([k[0] for k in found]), np.array([k[1] for k in found])
    move = np.zeros((len(found), len(found)))
    for row, here in enumerate(moves):
        for key, chance in here.items():
            move[row, found[key]] += chance
    own, told = LOCALS.own_type[locals_], LOCALS.indicated[locals_]
    types = {"hidden": fatigued[phases_], "own": own, "announced": np.where(told == 1, own, 1 - own)}
    start = np.zeros(len(found))
    firsts = np.flatnonzero(begin)
    start[: len(firsts)] = begin[firsts]
    return HumanChain(
        locals_, phases_, policy[locals_].astype(np.int64), move, np.array(rewards), start, types
    )


class BestResponse:
    """Backward induction for the robot over one episode.

    Attributes:
        q: (T, H, L, 9) value of an action with the human's state known; -inf where not allowed.
        value: expected reward of an episode, the human's share included.
    """

    def __init__(self, rules: Preset, *, priced: bool = True) -> None:
        self.rules, self.chain = rules, human_chain(rules)
        table = tables(rules, "robot")
        robot, reward = _robot_model(rules, table)
        price = _price(rules, self.chain) if priced else np.zeros((len(self.chain.local), SIZE, ACTIONS))
        gain = reward[None] - price + self.chain.reward[:, None, None]
        gain = np.where(table.valid[None], gain, -np.inf)
        value = np.zeros((len(self.chain.local), SIZE))
        # Published: what the human is told to be after the step may clear the robot's indication.
        robots_own = forced(rules)[:, self.chain.local].T  # (H, L)
        self.q = np.empty((rules.horizon, *gain.shape), dtype=np.float32)
        for t in reversed(range(rules.horizon)):
            ahead = self.chain.move @ np.take_along_axis(value, robots_own, axis=1)
            q = gain + (ahead @ robot.reshape(-1, SIZE).T).reshape(gain.shape)
            self.q[t] = q
            value = np.where(np.isfinite(q).any(axis=2), q.max(axis=2), 0.0)
        self.value = float(self.chain.start @ value @ start_chances(rules, "robot"))


def rule_value(rules: Preset, kind: str = "expert") -> float:
    """Expected reward (priced) of an episode of a hand-coded robot rule that goes by what was told last.

    Exact, without sampling: the reference that simulations are checked against.
    """
    chain, table = human_chain(rules), tables(rules, "robot")
    robot, reward = _robot_model(rules, table)
    action = expert_actions(rules, 0, kind)[:, chain.types["announced"]].T.astype(np.intp)  # (H, L)
    gain = np.take_along_axis(reward[None] - _price(rules, chain), action[..., None], axis=2)[..., 0]
    gain = gain + chain.reward[:, None]
    move = robot[np.arange(SIZE), action]  # (H, L, L)
    robots_own = forced(rules)[:, chain.local].T  # (H, L)
    chance, total = np.outer(chain.start, start_chances(rules, "robot")), 0.0
    for _ in range(rules.horizon):
        total += float((chance * gain).sum())
        met = chain.move.T @ (chance[:, None] @ move)[:, 0]
        chance = np.zeros_like(met)
        np.add.at(chance, (np.arange(len(met))[:, None], robots_own), met)
    return total


def _robot_model(rules: Preset, table: Tables) -> tuple[Floats, Floats]:
    """Transitions (L, 9, L) and expected sorting rewards (L, 9) of the robot."""
    move, reward = np.zeros((SIZE, ACTIONS, SIZE)), np.zeros((SIZE, ACTIONS))
    for local, action in zip(*np.nonzero(table.valid), strict=True):
        placed = action in (Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN)
        for kind, chance in enumerate(kind_chances(rules, int(local), int(action))):
            following = table.following[local, LOCALS.own_type[local], action, kind]
            move[local, action, following] += chance
            reward[local, action] += placed * chance * (1 - 2 * table.wrong[local, action, kind])
    return move, reward


def _price(rules: Preset, chain: HumanChain) -> Floats:
    """(H, L, 9) price of a robot's action; see `Preset.priced_on`."""
    working = {
        "own": (LOCALS.own_type[chain.local] == 0) & (LOCALS.indicated[chain.local] == 1),
        "active": (chain.action != Action.NO_OP) & (chain.action < Action.SPEED_UP),
        "hidden": chain.types["hidden"] == 0,
    }[rules.priced_on]
    fast = np.repeat((LOCALS.own_type == 1)[:, None], ACTIONS, axis=1)
    fast[:, Action.SLOW_DOWN] = False
    out: Floats = rules.price * working[:, None, None] * fast[None]
    return out


class SemiMarkovFilter:
    """The exact Bayes filter: P(type of the human | its observed actions), for E episodes at once.

    The chain knows how long a rest lasts and when fatigue comes, and the filter uses which action a
    state would show; Eq. 3 of the paper does neither.

    Args:
        label: which reading of the type: "hidden", "own" or "announced".
    """

    def __init__(self, rules: Preset, label: str = "announced") -> None:
        self.chain = human_chain(rules)
        seen = confusion(rules)
        self._likelihood = seen[self.chain.action].T.copy()  # (9, H)
        self._type = self.chain.types[label].astype(float)
        self.state: Floats = np.zeros((0, len(self.chain.local)))

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        """Start new episodes; the belief (E,)."""
        self.state = np.tile(self.chain.start, (n_envs, 1))
        return self._belief()

    def update(self, observed: NDArray[np.integer]) -> NDArray[np.float32]:
        """Take in the human's observed actions (E,); the belief after the step (E,)."""
        weighed = self.state * self._likelihood[observed]
        total = weighed.sum(axis=1, keepdims=True)
        # What the model holds for impossible tells nothing: keep the belief and let time pass.
        weighed = np.where(total > 1e-12, weighed / np.maximum(total, 1e-12), self.state)
        self.state = weighed @ self.chain.move
        return self._belief()

    def _belief(self) -> NDArray[np.float32]:
        out: NDArray[np.float32] = (self.state @ self._type).astype(np.float32)
        return out


class QmdpRobot:
    """Acts by the known-type values averaged over the exact filter's belief."""

    def __init__(self, rules: Preset) -> None:
        self._best = BestResponse(rules)
        self._filter = SemiMarkovFilter(rules)
        self._t = 0

    def reset(self, n_envs: int) -> None:
        """Start new episodes."""
        self._filter.reset(n_envs)
        self._t = 0

    def act(self, local: NDArray[np.integer]) -> NDArray[np.int8]:
        """Actions (E,) in the robot's local states (E,)."""
        q = self._best.q[self._t]
        known = np.where(np.isfinite(q), q, -1e6).transpose(1, 0, 2)  # (L, H, 9)
        out = np.empty(len(local), dtype=np.int8)
        for state in np.unique(local):
            here = local == state
            out[here] = (self._filter.state[here] @ known[state]).argmax(axis=1)
        return out

    def update(self, observed: NDArray[np.integer]) -> None:
        """Take in the human's observed actions (E,)."""
        self._filter.update(observed)
        self._t += 1
