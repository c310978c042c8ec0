"""Many episodes of the sorting task at once.

All episodes run in step; everything that happens is a table look-up over arrays. The same seed
and the same calls give the same bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell.errors import ConfigError
from cell.learn.domain.interface import Step, VectorDomain, checked, draw_kinds, observer
from cell.learn.domain.local import ACTIONS, FEATURES, LOCALS, SINK, SIZE
from cell.learn.domain.presets import Preset
from cell.learn.domain.rules import KINDS, STEP_COST, drawing, forced, phases, tables
from cell.learn.domain.starts import draw_starts
from cell.wire.vocabulary import Action


class Domain:
    """The task in synchronous steps.

    Attributes:
        preset, n_envs, n_agents, horizon: sizes. features: (L, 15) float32, encoding of local states.
        mask: (N, L, 9) bool, what agent i may choose. Where the rules leave nothing (states that do
            not occur, and the sink) it is No-op.
    """

    def __init__(self, preset: Preset, envs: int, seed: int) -> None:
        if preset.published and preset.agents != ("robot", "human"):
            raise ConfigError("agents: the published rules are for one robot and one human")
        if not 1 <= envs <= 1_000_000:
            raise ConfigError(f"envs must be between 1 and 1000000, got {envs}")
        self.preset, self.n_envs, self.n_agents, self.horizon = (
            preset,
            envs,
            len(preset.agents),
            preset.horizon,
        )
        self.features = FEATURES
        self._rng = np.random.default_rng([seed, 0x50F7])
        self._tables = [tables(preset, role) for role in preset.agents]
        self.mask = np.stack([t.valid for t in self._tables])
        self.mask[:, :, Action.NO_OP] |= ~self.mask.any(axis=2)
        # Flat tables: one look-up each, by local state, action and whatever else decides.
        self._valid = [np.ascontiguousarray(t.valid.ravel()) for t in self._tables]
        self._following = [np.ascontiguousarray(t.following.ravel()) for t in self._tables]
        self._wrong = [np.ascontiguousarray(t.wrong.ravel()) for t in self._tables]
        self._shaped = [t.shaped.ravel().astype(np.float32) for t in self._tables]
        self._forced = forced(preset).ravel() if preset.published and preset.forcing else None
        following, self._fatigued = phases(preset)
        self._thresholds = following.shape[2]
        self._phase_after = following.ravel()
        self._first_rest = len(self._fatigued) - 1
        self._kind = draw_kinds(preset)
        self._fresh = drawing(preset)
        self._observe = observer(preset, self._rng)
        self._placing = np.isin(np.arange(ACTIONS), (Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN))
        self.reset()

    def reset(self) -> NDArray[np.int16]:
        """Start a new episode everywhere; returns local states (E, N)."""
        count, agents = self.n_envs, self.n_agents
        self._alive = np.ones(count, dtype=bool)
        self._local, self._onion = draw_starts(self.preset, count, self._rng)
        self._phase = np.zeros((agents, count), dtype=np.int64)
        for i in self.preset.humans:
            self._phase[i] = np.where(LOCALS.own_type[self._local[i]] == 1, self._first_rest, 0)
        self._told = LOCALS.own_type[self._local].astype(np.int8)
        return self._local.T.astype(np.int16)

    def step(self, actions: NDArray[np.integer]) -> Step:
        """Let one step pass.

        Args:
            actions: (E, N) numbers of actions. Outside of the published rules they must be in `mask`.

        Raises:
            ConfigError: another shape, no action's number, or an action that the mask forbids, where
                the rules are not the published ones.
        """
        agents, humans = range(self.n_agents), self.preset.humans
        action = checked(actions, self.n_envs, self.n_agents)
        key = self._local * ACTIONS + action
        valid = self._valid[0][key[0]]
        for i in agents[1:]:
            valid = valid & self._valid[i][key[i]]
        if not self.preset.published and not valid.all():
            raise ConfigError("an action was chosen that the mask forbids")
        alive = self._alive & valid
        draws = np.frombuffer(
            self._rng.bytes(2 * (self.n_agents + len(humans)) * self.n_envs), np.uint16
        ).reshape(-1, self.n_envs)
        own = LOCALS.own_type[self._local]
        priced = self._priced(own, action) & alive

        placed, wrong = np.empty_like(action, dtype=np.int8), np.empty_like(action, dtype=np.int8)
        shaped = np.full(self.n_envs, -STEP_COST, dtype=np.float32)
        local, hidden = np.empty_like(self._local), own.astype(np.int8)
        for i in agents:
            fresh = self._fresh[action[i]]
            kind = np.where(fresh, self._kind[draws[i]], self._onion[i])
            self._onion[i] = kind
            true_type = self._fatigued[self._phase[i]] if i in humans else own[i]
            local[i] = self._following[i][
                ((self._local[i] * 2 + true_type) * ACTIONS + action[i]) * KINDS + kind
            ]
            placed[i] = self._placing[action[i]] & alive
            wrong[i] = self._wrong[i][key[i] * KINDS + kind] & alive
            shaped += np.where(alive, self._shaped[i][key[i]], np.float32(0.0))
        for k, i in enumerate(humans):
            drawn = (draws[self.n_agents + k].astype(np.int64) * self._thresholds) >> 16
            self._phase[i] = self._phase_after[(self._phase[i] * 2 + placed[i]) * self._thresholds + drawn]
            hidden[i] = self._fatigued[self._phase[i]]
        if self._forced is not None:
            local[0] = self._forced[local[0] * SIZE + local[1]]
        if not alive.all():
            local[:, ~alive] = SINK
            shaped[~self._alive] = 0.0
        self._local, self._alive = local, alive
        known = LOCALS.own_type[local].astype(np.int8)
        if not alive.all():
            known[:, ~alive] = 0  # the sink has no type; nobody learns from what follows an end
        for i in self.preset.robots:
            hidden[i] = known[i]
        thumb = action >= Action.SPEED_UP
        robot = np.isin(np.arange(self.n_agents), self.preset.robots)[:, None]
        told = np.where(robot, action == Action.SPEED_UP, action == Action.SLOW_DOWN)
        self._told = np.where(thumb, told, self._told).astype(np.int8)
        truth = (placed.sum(axis=0) - 2 * wrong.sum(axis=0)).astype(np.float32)
        return Step(
            local=local.T.astype(np.int16),
            observed=self._observe(action).T.astype(np.int8),
            reward_truth=truth,
            reward_priced=truth - np.float32(self.preset.price) * priced,
            reward_shaped=shaped,
            placed=placed.T,
            wrong=wrong.T,
            priced=priced,
            alive=alive,
            type_hidden=hidden.T,
            type_own=known.T,
            type_announced=self._told.T,
        )

    def _priced(self, own: NDArray[np.int64], action: NDArray[np.int64]) -> NDArray[np.bool_]:
        """A robot acts in industrial mode (slowing down is free) beside a human at work, shape (E,)."""
        working = np.zeros(self.n_envs, dtype=bool)
        for i in self.preset.humans:
            match self.preset.priced_on:
                case "own":
                    working |= (own[i] == 0) & (LOCALS.indicated[self._local[i]] == 1)
                case "active":
                    working |= (action[i] != Action.NO_OP) & (action[i] < Action.SPEED_UP)
                case "hidden":
                    working |= self._fatigued[self._phase[i]] == 0
        fast = np.zeros(self.n_envs, dtype=bool)
        for i in self.preset.robots:
            fast |= (own[i] == 1) & (action[i] != Action.SLOW_DOWN)
        return working & fast


def make(preset: Preset, envs: int, seed: int) -> VectorDomain:
    """`envs` episodes of the task at once, seeded: in steps, or in seconds if the preset has any."""
    if preset.seconds > 0.0:
        from cell.learn.domain.semi_markov import SemiMarkovDomain

        return SemiMarkovDomain(preset, envs, seed)
    return Domain(preset, envs, seed)


__all__ = ["Domain", "Step", "VectorDomain", "make"]
