"""The task's rules as tables, one set for each role.

An onion's kind is what its skin hides: sound, blemished where it shows at first sight, or
blemished on a hidden side only. Detect draws it; the published environment, which knows no truth
beyond the prediction, draws again at every inspection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.learn.domain.local import ACTIONS, LOCALS, SINK, SIZE, local_id
from cell.learn.domain.presets import Preset
from cell.wire.vocabulary import Action, EefLocation, OnionLocation, Prediction

SOUND, SHOWN, CONCEALED = 0, 1, 2
KINDS = 3
STEP_COST = 0.02
_LOOKS = (Action.DETECT, Action.DETECT_PICK)
_PLACES = (Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN)
_SWITCHES = (Action.SPEED_UP, Action.SLOW_DOWN)


@dataclass(frozen=True)
class Tables:
    """Rules of one role; L local states, 9 actions, 3 kinds of onion.

    Attributes:
        valid: (L, 9) what the rules allow.
        following: (L, 2, 9, 3) local state after an action, by the agent's true type (which comes
            into a human's own state first) and the onion's kind.
        wrong: (L, 9, 3) the action sorts an onion wrongly.
        shaped: (L, 9) the published environment's reward of the action, step cost excluded.
    """

    valid: NDArray[np.bool_]
    following: NDArray[np.int64]
    wrong: NDArray[np.bool_]
    shaped: NDArray[np.float64]


def tables(rules: Preset, role: str) -> Tables:
    """The tables of `role` under a preset's rules."""
    valid = _valid_published(role) if rules.published else _valid_paper(role)
    following = np.full((SIZE, 2, ACTIONS, KINDS), SINK)
    wrong = np.zeros((SIZE, ACTIONS, KINDS), dtype=bool)
    shaped = np.zeros((SIZE, ACTIONS))
    for state in range(SINK):
        for action in Action:
            shaped[state, action] = _shaped(state, action, role)
            for kind in range(KINDS):
                wrong[state, action, kind] = _wrong(state, action, kind, rules)
                for true_type in (0, 1):
                    following[state, true_type, action, kind] = _after(
                        state, true_type, action, kind, role, rules
                    )
    return Tables(valid, following, wrong, shaped)


def _valid_task(*, conveyor_hand_may_pick: bool) -> NDArray[np.bool_]:
    """Pick with a chosen onion; Inspect and both places with a held one."""
    out = np.zeros((SIZE, ACTIONS), dtype=bool)
    pick = LOCALS.onion == OnionLocation.ON_CONVEYOR
    if not conveyor_hand_may_pick:
        pick &= LOCALS.eef != EefLocation.ON_CONVEYOR
    out[:, Action.PICK] = pick
    for action in (Action.INSPECT, *_PLACES):
        out[:, action] = LOCALS.held
    return out


def _valid_published(role: str) -> NDArray[np.bool_]:
    """Published environment: all but 7 and 8 need indicated = 1; a resting human can only No-op."""
    own, told = LOCALS.own_type, LOCALS.indicated == 1
    out = _valid_task(conveyor_hand_may_pick=False)
    out[:, Action.DETECT] = LOCALS.idle & (own == 0)
    if role == "robot":
        out[:, Action.DETECT_PICK] = LOCALS.idle & (own == 1)
    else:
        out[own == 1] = False
        out[:, Action.NO_OP] = own == 1
    out &= told[:, None]
    out[:, Action.SPEED_UP] = (own == 0) & ~told
    out[:, Action.SLOW_DOWN] = (own == 1) & ~told
    out[SINK] = False
    return out


def _valid_paper(role: str) -> NDArray[np.bool_]:
    """The paper's text: the robot chooses its mode while its hand is empty, and may wait."""
    own, told = LOCALS.own_type, LOCALS.indicated == 1
    out = _valid_task(conveyor_hand_may_pick=True)
    if role == "robot":
        out[:, Action.NO_OP] = True
        out[:, Action.DETECT] = LOCALS.idle & (own == 0)
        out[:, Action.DETECT_PICK] = LOCALS.idle & (own == 1)
        out[:, Action.SPEED_UP] = ~LOCALS.held & (own == 0)
        out[:, Action.SLOW_DOWN] = ~LOCALS.held & (own == 1)
    else:
        out[:, Action.DETECT] = LOCALS.idle
        out[own == 1] = False
        out[:, Action.NO_OP] = own == 1
        out &= told[:, None]
        out[:, Action.SPEED_UP] = (own == 0) & ~told
        out[:, Action.SLOW_DOWN] = (own == 1) & ~told
    out[SINK] = False
    return out


def _after(state: int, true_type: int, action: Action, kind: int, role: str, rules: Preset) -> int:
    """Local state after an action; a human's true type comes into its own state before the effect."""
    onion, eef, prediction, own, told = (int(v[state]) for v in LOCALS)
    if role == "human" and own != true_type:
        own, told = true_type, 0
    held = onion >= OnionLocation.IN_FRONT
    at_home = (int(OnionLocation.AT_HOME), int(EefLocation.AT_HOME))
    if action is Action.NO_OP and not held and eef in (EefLocation.IN_BIN, EefLocation.ON_CONVEYOR):
        eef = EefLocation.AT_HOME
    elif action in _LOOKS:
        prediction = Prediction.BLEMISHED if kind == SHOWN else Prediction.UNBLEMISHED
        onion, eef = at_home
        if action is Action.DETECT:
            onion = OnionLocation.ON_CONVEYOR
    elif action is Action.PICK and onion != OnionLocation.UNKNOWN:
        onion, eef = at_home
    elif action is Action.INSPECT and held:
        onion, eef = OnionLocation.IN_FRONT, EefLocation.IN_FRONT
        seen = kind == SHOWN if rules.published else kind != SOUND
        if seen:
            prediction = Prediction.BLEMISHED
        elif not rules.published:
            prediction = Prediction.UNBLEMISHED
    elif action in _PLACES:
        onion, prediction = OnionLocation.UNKNOWN, Prediction.UNKNOWN
        eef = EefLocation.ON_CONVEYOR if action is Action.PLACE_ON_CONVEYOR else EefLocation.IN_BIN
    elif action in _SWITCHES:
        told = 1
        if role == "robot":
            own = int(action is Action.SPEED_UP)
    return local_id(onion, eef, prediction, own, told)


def _wrong(state: int, action: Action, kind: int, rules: Preset) -> bool:
    if action not in _PLACES:
        return False
    bad = LOCALS.prediction[state] == Prediction.BLEMISHED if rules.published else kind != SOUND
    return bool(bad) == (action is Action.PLACE_ON_CONVEYOR)


def _shaped(state: int, action: Action, role: str) -> float:
    """+1 for a placement that fits the own prediction and for inspecting a promising onion, else -1.

    A human's part counts only while its own state says unfatigued.
    """
    prediction, onion = LOCALS.prediction[state], LOCALS.onion[state]
    if role == "human" and LOCALS.own_type[state] == 1:
        return 0.0
    if action in _PLACES and LOCALS.held[state]:
        fits = (prediction == Prediction.BLEMISHED) == (action is Action.PLACE_IN_BIN)
        return 1.0 if fits else -1.0
    promising = onion == OnionLocation.AT_HOME and prediction == Prediction.UNBLEMISHED
    return 1.0 if action is Action.INSPECT and promising else 0.0


def drawing(rules: Preset) -> NDArray[np.bool_]:
    """Actions (9,) that draw the onion's kind: those that look, and every published inspection."""
    out = np.isin(np.arange(ACTIONS), _LOOKS)
    out[Action.INSPECT] = rules.published
    return out


def kind_chances(rules: Preset, local: int, action: int) -> NDArray[np.float64]:
    """P(kind of the onion that an action meets | what the local state knows of it), shape (3,).

    An action that draws a kind, or nothing in focus: any onion's. A blemished prediction has seen it;
    an unblemished one at first sight may still hide a blemish, after Inspect it does not.
    """
    p, visible = rules.p_blemished, rules.p_visible
    prediction = LOCALS.prediction[local]
    prior: NDArray[np.float64] = np.array([1 - p, p * visible, p * (1 - visible)])
    if prediction == Prediction.UNKNOWN or drawing(rules)[action]:
        return prior
    if prediction == Prediction.BLEMISHED:
        return _certain(SHOWN)
    if LOCALS.onion[local] == OnionLocation.IN_FRONT:  # inspected
        return _certain(SOUND)
    left: NDArray[np.float64] = np.array([prior[SOUND], 0.0, prior[CONCEALED]])
    out: NDArray[np.float64] = left / left.sum()
    return out


def _certain(kind: int) -> NDArray[np.float64]:
    out: NDArray[np.float64] = np.zeros(KINDS)
    out[kind] = 1.0
    return out


def forced(rules: Preset) -> NDArray[np.int64]:
    """Robot's local state (L, L) by its own and the human's: the published mismatch rule.

    A robot whose type does not answer what the human has told loses its own indication.
    """
    robot = np.repeat(np.arange(SIZE)[:, None], SIZE, axis=1)
    if not (rules.published and rules.forcing):
        return robot
    out = robot.copy()
    for state in range(SINK):
        onion, eef, prediction, own, _ = (int(v[state]) for v in LOCALS)
        mismatch = (LOCALS.indicated == 1) & (LOCALS.own_type != own)
        mismatch[SINK] = False
        out[state, mismatch] = local_id(onion, eef, prediction, own, 0)
    return out


def phases(rules: Preset) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """A human's fatigue as a chain.

    Phases 0..C count onions sorted since the last rest, the following ones the steps of rest that are
    left, fewest first.

    Returns:
        following: (P, 2, T) next phase by "sorted one in this step" and index of the threshold drawn.
        fatigued: (P,) true type of each phase.
    """
    thresholds = rules.thresholds or (10**9,)
    most = max(rules.thresholds, default=0)
    count = most + 1 + rules.recovery
    following = np.zeros((count, 2, len(thresholds)), dtype=np.int64)
    for phase in range(count):
        for placed in (0, 1):
            for k, threshold in enumerate(thresholds):
                if phase > most:
                    left = phase - most - 1
                    following[phase, placed, k] = 0 if left == 0 else most + left
                else:
                    done = phase + placed
                    tired = done >= threshold
                    following[phase, placed, k] = most + rules.recovery if tired else min(done, most)
    return following, (np.arange(count) > most).astype(np.int64)
