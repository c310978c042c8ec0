"""The task in seconds: actions take time and agents decide when they are free, not in step.

The domain moves from event to event; an event is the end of at least one agent's action. An agent
in the middle of its action is in the busy twin of its local state, whose only action is No-op, so
that policies, masks and learners stay what they are. An episode has a fixed length in seconds.

What the paper leaves open: a human can tire at the end of a placement, not at every step, for there
are no steps; the price is per second, and `Step.priced` marks events, not seconds; the published
shaped reward has no meaning without steps, so that it is the reward by the truth.
"""

from __future__ import annotations

import csv
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.errors import ConfigError, one_of
from cell.learn.domain.interface import Step, checked, draw_kinds, observer
from cell.learn.domain.local import ACTIONS, FEATURES, LOCALS, SIZE
from cell.learn.domain.presets import ROLES, Preset
from cell.learn.domain.rules import tables
from cell.learn.domain.starts import draw_starts
from cell.wire.vocabulary import Action, RobotType

BUSY = SIZE
"""Added to a local state it makes the busy twin."""
_EPS = 1e-9
_ANY = "any"


def load_durations(path: Path | None = None) -> NDArray[np.float64]:
    """Seconds by role (robot, human), mode (collaborative, industrial) and action, shape (2, 2, 9).

    Args:
        path: CSV with columns role, mode, action, seconds; mode "any" stands for both. None: shipped.

    Raises:
        ConfigError: missing file, unknown name, missing or impossible value; names the row.
    """
    source = path or Path(str(files("cell.learn.domain") / "durations.csv"))
    try:
        lines = [line for line in source.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read durations {source}: {error}") from None
    out = np.full((len(ROLES), len(RobotType), ACTIONS), np.nan)
    modes = [m.name.lower() for m in RobotType]
    actions = [a.name.lower() for a in Action]
    for number, row in enumerate(csv.DictReader(lines), start=2):
        where = f"durations {source.name}, row {number}"
        role, mode, action = (row.get(k) or "" for k in ("role", "mode", "action"))
        for value, legal in ((role, list(ROLES)), (mode, [*modes, _ANY]), (action, actions)):
            if value not in legal:
                raise ConfigError(f"{where}: {one_of(value, legal)}")
        try:
            seconds = float(row.get("seconds") or "nan")
        except ValueError:
            seconds = float("nan")
        if not 0.01 <= seconds <= 600.0:
            raise ConfigError(
                f"{where}: seconds must be a number from 0.01 to 600, got {row.get('seconds')!r}"
            )
        which = range(2) if mode == _ANY else [modes.index(mode)]
        for m in which:
            out[ROLES.index(role), m, actions.index(action)] = seconds
    if np.isnan(out).any():
        r, m, a = (int(v[0]) for v in np.nonzero(np.isnan(out)))
        raise ConfigError(f"durations {source.name}: no row for {ROLES[r]}, {modes[m]}, {actions[a]}")
    return out


class SemiMarkovDomain:
    """`Domain`'s interface over events; `preset.seconds` is an episode's length.

    Attributes:
        features: (2 L, 16) float32: the local state's encoding and a busy flag.
        mask: (N, 2 L, 9): busy agents can only No-op.
        time: (E,) seconds since the start of the episode.
    """

    def __init__(self, preset: Preset, envs: int, seed: int) -> None:
        if preset.published or preset.seconds <= 0.0:
            raise ConfigError("the domain in seconds needs a preset with seconds, and the paper's rules")
        if not 1 <= envs <= 1_000_000:
            raise ConfigError(f"envs must be between 1 and 1000000, got {envs}")
        self.preset, self.n_envs, self.n_agents, self.horizon = (
            preset,
            envs,
            len(preset.agents),
            preset.horizon,
        )
        self._rng = np.random.default_rng([seed, 0x5E31])
        self._tables = [tables(preset, role) for role in preset.agents]
        seconds = load_durations(Path(preset.durations) if preset.durations else None)
        self._seconds = [seconds[ROLES.index(role)] for role in preset.agents]
        free = np.stack([t.valid for t in self._tables])
        free[:, :, Action.NO_OP] |= ~free.any(axis=2)
        busy = np.zeros_like(free)
        busy[:, :, Action.NO_OP] = True
        self.mask = np.concatenate([free, busy], axis=1)
        flag = np.repeat([0.0, 1.0], SIZE)[:, None]
        self.features = np.concatenate([np.tile(FEATURES, (2, 1)), flag], axis=1).astype(np.float32)
        self._observe = observer(preset, self._rng)
        self._draw = draw_kinds(preset)
        self.reset()

    def reset(self) -> NDArray[np.int16]:
        """Start new episodes; local states (E, N)."""
        count, agents = self.n_envs, self.n_agents
        self.time = np.zeros(count)
        self._local, self._onion = draw_starts(self.preset, count, self._rng)
        self._left = np.zeros((agents, count))
        self._doing = np.zeros((agents, count), dtype=np.int64)
        self._since = np.zeros((agents, count), dtype=np.int64)
        self._rest = np.zeros((agents, count))
        for i in self.preset.humans:
            self._rest[i] = LOCALS.own_type[self._local[i]] * float(self.preset.recovery)
        self._told = LOCALS.own_type[self._local].astype(np.int8)
        return self._seen_local()

    def step(self, actions: NDArray[np.integer]) -> Step:
        """Free agents start their actions (E, N); time moves to the next end of an action.

        Raises:
            ConfigError: another shape, no action's number, or a free agent's action that the mask forbids.
        """
        action = checked(actions, self.n_envs, self.n_agents)
        over = self.time >= self.preset.seconds - _EPS
        free = (self._left <= _EPS) & ~over
        for i in range(self.n_agents):
            chosen = np.where(free[i], action[i], Action.NO_OP)
            if not self.mask[i][self._local[i], chosen][free[i]].all():
                raise ConfigError("an action was chosen that the mask forbids")
            own = LOCALS.own_type[self._local[i]]
            length = self._seconds[i][own, chosen]
            self._doing[i] = np.where(free[i], chosen, self._doing[i])
            self._left[i] = np.where(free[i], length, self._left[i])
        dt = np.minimum(self._left.min(axis=0), self.preset.seconds - self.time)
        dt = np.where(over, 0.0, dt)
        priced_s = self._priced() * dt
        self.time = self.time + dt
        self._left = self._left - dt
        ended = (self._left <= _EPS) & ~over
        placed, wrong = self._finish(ended, dt, over)
        truth = (placed.sum(axis=0) - 2 * wrong.sum(axis=0)).astype(np.float32)
        robots = np.isin(np.arange(self.n_agents), self.preset.robots)[:, None]
        own = LOCALS.own_type[self._local]
        return Step(
            local=self._seen_local(),
            observed=self._observe(self._doing).T.astype(np.int8),
            reward_truth=truth,
            reward_priced=truth - (self.preset.price * priced_s).astype(np.float32),
            reward_shaped=truth,
            placed=placed.T,
            wrong=wrong.T,
            priced=priced_s > 0.0,
            alive=np.ones(self.n_envs, dtype=bool),
            type_hidden=np.where(robots, own, self._rest > _EPS).T.astype(np.int8),
            type_own=own.T.astype(np.int8),
            type_announced=self._told.T.copy(),
        )

    def _finish(
        self, ended: NDArray[np.bool_], dt: NDArray[np.float64], over: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
        """Effects of the actions that ended; onions placed and placed wrongly, (N, E)."""
        placed, wrong = (np.zeros(ended.shape, dtype=np.int8) for _ in range(2))
        draws = self._rng.integers(1 << 16, size=(self.n_agents, self.n_envs), dtype=np.uint16)
        limits = np.array(self.preset.thresholds or (10**9,))[
            self._rng.integers(max(1, len(self.preset.thresholds)), size=(self.n_agents, self.n_envs))
        ]
        for i in range(self.n_agents):
            done, local = self._doing[i], self._local[i]
            look = ended[i] & ((done == Action.DETECT) | (done == Action.DETECT_PICK))
            kind = self._onion[i] = np.where(look, self._draw[draws[i]], self._onion[i])
            human = i in self.preset.humans
            if human:
                resting = self._rest[i] > _EPS
                self._rest[i] = np.maximum(self._rest[i] - dt, 0.0)
                self._since[i] = np.where(resting & (self._rest[i] <= _EPS), 0, self._since[i])
            true_type = (self._rest[i] > _EPS).astype(np.int64) if human else LOCALS.own_type[local]
            following = self._tables[i].following[local, true_type, done, kind]
            puts = (done == Action.PLACE_ON_CONVEYOR) | (done == Action.PLACE_IN_BIN)
            placed[i] = ended[i] & puts
            wrong[i] = ended[i] & self._tables[i].wrong[local, done, kind]
            self._local[i] = np.where(ended[i], following, local)
            one = Action.SLOW_DOWN if human else Action.SPEED_UP
            thumb = (done >= Action.SPEED_UP) & ~over  # held up until it is seen: seen is told
            self._told[i] = np.where(thumb, done == one, self._told[i])
            if human:
                self._since[i] += placed[i]
                tires = (placed[i] == 1) & (self._rest[i] <= _EPS) & (self._since[i] >= limits[i])
                self._rest[i] = np.where(tires, float(self.preset.recovery), self._rest[i])
        return placed, wrong

    def _priced(self) -> NDArray[np.bool_]:
        """A robot acts in industrial mode beside a human at work (E,); slowing down is free."""
        own, told = LOCALS.own_type[self._local], LOCALS.indicated[self._local]
        working, fast = (np.zeros(self.n_envs, dtype=bool) for _ in range(2))
        for i in self.preset.humans:
            moving = (self._doing[i] != Action.NO_OP) & (self._doing[i] < Action.SPEED_UP)
            known = (own[i] == 0) & (told[i] == 1)
            working |= {"own": known, "active": moving, "hidden": self._rest[i] <= _EPS}[
                self.preset.priced_on
            ]
        for i in self.preset.robots:
            fast |= (own[i] == 1) & (self._doing[i] != Action.SLOW_DOWN)
        return working & fast

    def _seen_local(self) -> NDArray[np.int16]:
        """Local states (E, N), of busy agents and after the end of an episode their busy twins."""
        busy = (self._left > _EPS) | (self.time >= self.preset.seconds - _EPS)
        out: NDArray[np.int16] = (self._local + BUSY * busy).T.astype(np.int16)
        return out
