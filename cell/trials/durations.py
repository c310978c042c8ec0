"""How long each action takes in the cell, by role and mode: what the abstract task is calibrated with.

In the task an action always works; in the cell a grasp may fail, a hand may be withdrawn, the robot
may wait for the person. The time of all tries belongs to the ones that worked, so that the task's
pace is the cell's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cell.frames import Array
from cell.trials.log import Log, segments
from cell.wire.vocabulary import Action, RobotType

SORTING = (Action.DETECT, Action.DETECT_PICK, Action.PICK, Action.INSPECT, Action.PLACE_ON_CONVEYOR,
           Action.PLACE_IN_BIN)  # fmt: skip
_AFTER = {
    # an action worked when one of these came next
    Action.DETECT: (Action.PICK,),
    Action.DETECT_PICK: (Action.INSPECT, Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN),
    Action.PICK: (Action.INSPECT, Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN),
    Action.INSPECT: (Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN),
}


def durations(log: Log) -> dict[str, Any]:
    """Sums over one round: per role, mode and action [seconds, number that worked].

    "robot": by the mode that the policy asked for; "human": by action, with the rests' lengths and the
    times around them. "overhead": of the robot before its first and after its last onion [s].
    """
    out: dict[str, Any] = {"robot": _robot(log), "overhead": _overhead(log)}
    if log.with_person:
        out |= {"human": _human(log), "rests": _rests(log)}
    return out


def _robot(log: Log) -> dict[str, dict[str, list[float]]]:
    step, own = _step(log), log["own_type"]
    runs = segments(log["robot"])
    spent, worked = np.zeros((2, len(Action))), np.zeros((2, len(Action)))
    for i, (action, a, b) in enumerate(runs):
        fast = float(own[a:b].mean())
        share = np.array([1.0 - fast, fast])
        spent[:, action] += share * (b - a) * step
        following = runs[i + 1][0] if i + 1 < len(runs) else -1
        placed = action in (Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN)
        if placed or following in _AFTER.get(Action(action), ()):
            worked[:, action] += share
    names = {RobotType.COLLABORATIVE: "collaborative", RobotType.INDUSTRIAL: "industrial"}
    return {name: _table(spent[mode], worked[mode]) for mode, name in names.items()}


def _human(log: Log) -> dict[str, list[float]]:
    step, runs = _step(log), segments(log["human"])
    spent, worked = np.zeros(len(Action)), np.zeros(len(Action))
    for i, (action, a, b) in enumerate(runs):
        following = runs[i + 1][0] if i + 1 < len(runs) else -1
        if action == Action.DETECT and following != Action.PICK:
            continue  # looked out for work until the round was over, or tired
        spent[action] += (b - a) * step
        placed = action in (Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN)
        worked[action] += placed or following in _AFTER.get(Action(action), ())
    return _table(spent, worked)


def _rests(log: Log) -> list[dict[str, float]]:
    """Each whole rest: tired until rested; of that, until thumbs-down is over; then back to work [s]."""
    step, human = _step(log), log["human"]
    out = []
    for tired, a, b in segments(log["fatigued"]):
        if not tired or b == len(human):
            continue
        down = np.flatnonzero(human[a:b] == Action.SLOW_DOWN)
        up = np.flatnonzero(human[b:] == Action.SPEED_UP)
        if not len(down) or not len(up):
            continue
        told = np.flatnonzero(human[b + up[0] :] != Action.SPEED_UP)
        back = up[0] + (told[0] if len(told) else len(human) - b - up[0])
        out.append(
            {
                "recovery": round((b - a) * step, 3),
                "thumbs_down": round((int(down[-1]) + 1) * step, 3),
                "thumbs_up": round(float(back) * step, 3),
            }
        )
    return out


def _overhead(log: Log) -> dict[str, float]:
    """Before the robot first looks, and from its last success to the end [s]."""
    t, done = log["t"], np.flatnonzero(np.diff(log["sorted"], prepend=0.0) > 0)
    looked = np.flatnonzero(log["robot"] != Action.NO_OP)
    before = float(t[looked[0]] - t[0]) if len(looked) else 0.0
    last = float(t[done[-1]]) if len(done) else float(t[0])
    if log.with_person:
        placing = np.isin(log["human"], (Action.PLACE_IN_BIN, Action.PLACE_ON_CONVEYOR))
        put = np.flatnonzero(placing)
        last = max(last, float(t[put[-1]])) if len(put) else last
    return {"before": round(before, 3), "after": round(float(t[-1]) - last, 3)}


def _table(spent: Array, worked: Array) -> dict[str, list[float]]:
    return {
        action.name.lower(): [round(float(spent[action]), 4), round(float(worked[action]), 4)]
        for action in SORTING
        if spent[action] or worked[action]
    }


def _step(log: Log) -> float:
    t = log["t"]
    return float(np.median(np.diff(t))) if len(t) > 1 else 0.0
