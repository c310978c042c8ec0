"""The hand-coded policy vector: the one sensible behaviour, and variations of its parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cell.errors import ConfigError, one_of
from cell.learn.domain.local import LOCALS, SINK, SIZE
from cell.learn.domain.presets import Preset
from cell.wire.vocabulary import Action, OnionLocation, Prediction

KINDS = ("expert", "never-speed-up", "always-industrial", "never-inspect")


def expert_actions(rules: Preset, agent: int, kind: str = "expert") -> NDArray[np.int8]:
    """Action (L, 2) by local state and by "the partner is believed to be fatigued".

    Where actions take time there are twice as many states: a busy agent can only No-op.

    Under the published rules the mode changes are forced, so the second index changes nothing.

    Args:
        kind: "expert"; "never-speed-up" or "always-industrial" for the robot's mode; "never-inspect".

    Raises:
        ConfigError: unknown kind.
    """
    if kind not in KINDS:
        raise ConfigError(f"policy: {one_of(kind, KINDS)}")
    robot = rules.agents[agent] == "robot"
    inspects = kind != "never-inspect"
    out = np.zeros((SIZE, 2), np.int8)
    for state in range(SINK):
        for believed in (0, 1):
            wanted = {"never-speed-up": 0, "always-industrial": 1}.get(kind, believed)
            chooses = robot and not rules.published
            out[state, believed] = _action(state, robot, wanted if chooses else None, inspects)
    return np.concatenate([out, np.zeros_like(out)]) if rules.seconds > 0.0 else out


def without_forcing(rules: Preset, kind: str) -> Preset:
    """The preset in which a robot can keep one mode: the published rules force its changes, so they are
    undone and the robot starts in its mode. Other presets and kinds stay as they are."""
    if not rules.published or kind not in ("never-speed-up", "always-industrial"):
        return rules
    return replace(rules, forcing=False, robot_start=int(kind == "always-industrial"))


def _action(state: int, robot: bool, wanted: int | None, inspects: bool) -> Action:
    """`wanted` is the mode that a robot chooses, None where it does not choose."""
    onion, _, prediction, own, told = (int(v[state]) for v in LOCALS)
    held = onion >= OnionLocation.IN_FRONT
    if not told:
        up = own == 0
        return Action.SPEED_UP if up else Action.SLOW_DOWN
    if not robot and own == 1:
        return Action.NO_OP
    if wanted is not None and own != wanted and not held:
        return Action.SPEED_UP if wanted else Action.SLOW_DOWN
    if onion == OnionLocation.UNKNOWN:
        return Action.DETECT_PICK if robot and own == 1 else Action.DETECT
    if onion == OnionLocation.ON_CONVEYOR:
        return Action.PICK
    if prediction == Prediction.BLEMISHED:
        return Action.PLACE_IN_BIN
    if onion == OnionLocation.AT_HOME and inspects:
        return Action.INSPECT
    return Action.PLACE_ON_CONVEYOR
