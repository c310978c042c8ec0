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
            if not 1 <= getattr(self, name) <= 10_000:
                raise ConfigError(f"{name} must be between 1 and 10000, got {getattr(self, name)}")
        if not 0.0 <= self.seconds <= 3600.0:
            raise ConfigError(f"seconds must be between 0 and 3600, got {self.seconds}")
        if any(not 1 <= t <= 1000 for t in self.thresholds):
            raise ConfigError(f"thresholds must be between 1 and 1000, got {self.thresholds}")

    @property
    def humans(self) -> tuple[int, ...]:
        """Indices of the human agents."""
        return tuple(i for i, role in enumerate(self.agents) if role == "human")

    @property
    def robots(self) -> tuple[int, ...]:
        """Indices of the robots."""
        return tuple(i for i, role in enumerate(self.agents) if role == "robot")


PRESETS = {
    "released": Preset("released", published=True, recovery=5, p_visible=1.0, price=0.0, start="random"),
    "paper": Preset("paper"),
    "cell": Preset("cell", seconds=180.0, horizon=400, recovery=25),
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
