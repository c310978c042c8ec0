"""The parameters of the task, and the named presets.

`released` follows the published environment's code, `paper` the paper's text. Where the two
differ, the fields below say so.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import ConfigError, one_of
from cell.learn.domain.local import ACTIONS
from cell.wire.vocabulary import Action

ROLES = ("robot", "human")
PRICED_ON = ("own", "active", "hidden")
STARTS = ("fixed", "random")


@dataclass(frozen=True)
class Preset:
    """One task.

    Attributes:
        name: of the preset it came from.
        published: the published environment's rules: an invalid action ends the episode, the robot's
            indication is cleared by the mismatch of the types (`forcing`), labels are drawn again at
            every inspection and there is no truth beyond the prediction. Else the paper's text.
        agents: role of each agent; agent 0 is a robot.
        horizon: steps of an episode (in seconds: events, enough for all).
        seconds: length of an episode whose actions take time; 0: all act in step.
        durations: CSV file of the actions' seconds; empty: the shipped one.
        recovery: steps of a rest, or seconds.
        thresholds: a human is fatigued after a step when it has sorted at least as many onions since
            its last rest as a number drawn from these, anew at every step. Empty: never.
        forcing: see `published`; False undoes that rule.
        robot_start: own type of the robots at the start; None: collaborative at a fixed start, either
            at a random one.
        p_blemished: share of blemished onions. p_visible: of those, share that shows at first sight.
        price: of a step (or second) of a robot in industrial mode beside a human at work.
        priced_on: what "at work" means: "own" type known and told by the human to be unfatigued;
            "active": a physical action in this step; "hidden": truly unfatigued.
        missed_gestures: share of thumbs that are seen as No-op.
        misread_actions: share of all actions that are seen as another one, each equally likely.
        observation: (9, 9) P(observed | done), in place of these two shares; empty: by them.
        start: "fixed" or "random" local states.
    """

    name: str
    published: bool = False
    agents: tuple[str, ...] = ROLES
    horizon: int = 100
    seconds: float = 0.0
    durations: str = ""
    recovery: int = 20
    thresholds: tuple[int, ...] = (2, 3, 4, 5)
    forcing: bool = True
    robot_start: int | None = None
    p_blemished: float = 0.5
    p_visible: float = 0.5
    price: float = 0.5
    priced_on: str = "own"
    missed_gestures: float = 0.0
    misread_actions: float = 0.0
    observation: tuple[tuple[float, ...], ...] = ()
    start: str = "fixed"

    def __post_init__(self) -> None:
        for role in self.agents:
            if role not in ROLES:
                raise ConfigError(f"agents: {one_of(role, ROLES)}")
        if len(self.agents) < 2 or self.agents[0] != "robot":
            raise ConfigError("agents: at least two, of which the first is a robot")
        if self.priced_on not in PRICED_ON:
            raise ConfigError(f"priced_on: {one_of(self.priced_on, PRICED_ON)}")
        if self.start not in STARTS:
            raise ConfigError(f"start: {one_of(self.start, STARTS)}")
        for name in ("p_blemished", "p_visible", "missed_gestures", "misread_actions"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"{name} must be between 0 and 1, got {getattr(self, name)}")
        for name in ("horizon", "recovery"):
            if not _whole(getattr(self, name), 1, 10_000):
                raise ConfigError(
                    f"{name} must be a whole number from 1 to 10000, got {getattr(self, name)!r}"
                )
        if not 0.0 <= self.seconds <= 3600.0:
            raise ConfigError(f"seconds must be between 0 and 3600, got {self.seconds}")
        if not 0.0 <= self.price <= 1000.0:
            raise ConfigError(f"price must be between 0 and 1000, got {self.price}")
        if self.robot_start is not None and not _whole(self.robot_start, 0, 1):
            raise ConfigError(f"robot_start must be None, 0 or 1, got {self.robot_start!r}")
        if not isinstance(self.thresholds, tuple) or not all(_whole(t, 1, 1000) for t in self.thresholds):
            raise ConfigError(
                f"thresholds must be a tuple of whole numbers from 1 to 1000, got {self.thresholds!r}"
            )
        if self.observation:
            _check_observation(self)

    @property
    def humans(self) -> tuple[int, ...]:
        """Indices of the human agents."""
        return tuple(i for i, role in enumerate(self.agents) if role == "human")

    @property
    def robots(self) -> tuple[int, ...]:
        """Indices of the robots."""
        return tuple(i for i, role in enumerate(self.agents) if role == "robot")


def _whole(value: object, least: int, most: int) -> bool:
    return isinstance(value, int | np.integer) and bool(least <= value <= most)


def _check_observation(rules: Preset) -> None:
    if rules.missed_gestures or rules.misread_actions:
        raise ConfigError("observation takes the place of missed_gestures and misread_actions: give one")
    rows = rules.observation
    if len(rows) != ACTIONS or any(len(row) != ACTIONS for row in rows):
        raise ConfigError(f"observation must have {ACTIONS} rows of {ACTIONS} chances")
    for action, row in zip(Action, rows, strict=True):
        if not all(0.0 <= p <= 1.0 for p in row) or abs(sum(row) - 1.0) > 1e-6:
            raise ConfigError(
                f"observation, row {action.name.lower()}: chances from 0 to 1 that sum to 1, got {row}"
            )


PRESETS = {
    "released": Preset("released", published=True, recovery=5, p_visible=1.0, price=0.0, start="random"),
    "paper": Preset("paper"),
    "cell": Preset(
        "cell", seconds=180.0, horizon=400, recovery=25, missed_gestures=0.05, misread_actions=0.08
    ),
}
"""Named tasks."""


def preset(name: str, **changes: Any) -> Preset:
    """A named preset with some fields changed.

    Raises:
        ConfigError: unknown preset or field, or a value out of range.
    """
    if name not in PRESETS:
        raise ConfigError(f"preset: {one_of(name, PRESETS)}")
    legal = [f.name for f in fields(Preset)]
    for key in changes:
        if key not in legal:
            raise ConfigError(f"preset {name}: {one_of(key, legal)}")
    return replace(PRESETS[name], **changes)


def confusion(rules: Preset) -> NDArray[np.float64]:
    """P(observed | done), shape (9, 9), rows sum to 1."""
    if rules.observation:
        return np.array(rules.observation)
    thumbs = (Action.SPEED_UP, Action.SLOW_DOWN)
    seen = np.eye(ACTIONS)
    for thumb in thumbs:
        seen[thumb, thumb] = 1.0 - rules.missed_gestures
        seen[thumb, Action.NO_OP] = rules.missed_gestures
    other = (np.ones((ACTIONS, ACTIONS)) - np.eye(ACTIONS)) / (ACTIONS - 1)
    out: NDArray[np.float64] = seen @ ((1.0 - rules.misread_actions) * np.eye(ACTIONS))
    out = out + seen @ (rules.misread_actions * other)
    return out


__all__ = ["PRESETS", "Preset", "confusion", "preset"]
