"""Figures of one round from its log: fluency, delays, speed against caps, where the time went.

Fluency follows Hoffman (IEEE THMS 2019, doi 10.1109/thms.2019.2904558): idle shares, concurrent
activity, functional delay. All of it needs the truth of the simulated person, and says None without.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.config import CellConfig
from cell.frames import Array
from cell.motion.ssm import allowed_speed
from cell.trials.log import SIGNS, Log, segments
from cell.wire.vocabulary import Action, Mode

BRAKING = 0.6
"""Longest braking transient after a cap was lowered [s]."""
OVER = 0.005
"""Tool speeds count as above a cap from here on [m/s]: the differences of measured joint speeds."""
_EARLY, _LATE = 0.2, 0.3
"""A sign may be seen so long before its hand is in place, and after it was answered [s]."""
_PATIENCE = 12.0

Figures = dict[str, Any]
Mask = NDArray[np.bool_]


def fluency(robot: Mask, human: Mask, t: Array) -> Figures:
    """Idle shares, concurrent activity and functional delay.

    Args:
        robot, human: whether each is active, (N,) bool. t: (N,) [s], even.

    Returns:
        shares of the round; `functional_delay_share` is the time from the end of one agent's activity
        to the start of the other's, in which neither is active.
    """
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    delay, who = 0.0, 0
    since: float | None = None
    for r, h in zip(robot, human, strict=True):
        if r or h:
            if since is not None and ((who == 1 and h and not r) or (who == 2 and r and not h)):
                delay += since
            since = None
            who = 3 if r and h else 1 if r else 2
        else:
            since = (since or 0.0) + step
    total = max(step * len(t), 1e-9)
    return {
        "robot_idle": _share(~robot),
        "human_idle": _share(~human),
        "concurrent": _share(robot & human),
        "functional_delay_share": round(delay / total, 6),
    }


def at_work(log: Log) -> Mask:
    """When the person does something: not in No-op, and not looking out for work that does not come."""
    out: Mask = log["human"] != Action.NO_OP
    runs = segments(log["human"])
    for (action, a, b), following in zip(runs, [*runs[1:], (-1, 0, 0)], strict=True):
        if action == Action.DETECT and following[0] != Action.PICK:
            out[a:b] = False
    return out


def over(log: Log, cap: Array) -> int:
    """Ticks with the tool faster than a cap (N,) [m/s] allowed at any time of the braking before."""
    t, speed = log["t"], log["speed"]
    first = np.searchsorted(t, t - BRAKING, side="right")
    most = np.array([cap[a : i + 1].max() for i, a in enumerate(first)])
    return int((speed > most + OVER).sum())


def permitted_speed(log: Log, config: CellConfig) -> Array:
    """Tool speed that the true separation permits, (N,) [m/s]."""
    floor, top = config.motion.collaborative_speed, config.motion.industrial_speed
    allowed = [allowed_speed(float(d), config.separation) for d in log["true_separation"]]
    return np.clip(allowed, floor, top)


def signs(log: Log) -> Figures:
    """Signs shown, missed, swapped, false; how soon each was seen [s]."""
    t, seen = log["t"], log["sign_seen"]
    delays, missed, swapped = [], 0, 0
    near = np.zeros(len(t), bool)
    for sign in log.gestures:
        code = SIGNS[sign.sign]
        until = _end(sign)
        during = (t >= sign.shown - _EARLY) & (t <= until + _LATE)
        right = t[during & (seen == code)]
        swapped += bool(((seen != code) & (seen != 0) & during).any())
        missed += not len(right)
        delays += [round(max(0.0, float(right[0]) - sign.shown), 3)] if len(right) else []
        near |= (t >= sign.shown - 1.0) & (t <= until + 1.5)
    false = (seen != 0) & ~near
    return {
        "shown": len(log.gestures),
        "missed": missed,
        "swapped": swapped,
        "false": int((false[1:] & ~false[:-1]).sum()),
        "delay_s": delays,
    }


def delays(log: Log) -> Figures:
    """Mean times from a sign's being shown [s]: until it is seen, requested, in force, answered.

    None where there was none. `up_to_slow` is 0 where the separation had ended industrial mode before.
    """
    t, requested = log["t"], log["requested"] > 0.5
    industrial = log["mode"] == Mode.INDUSTRIAL
    out: dict[str, list[float]] = {
        k: []
        for k in ("down_to_request", "down_to_industrial", "down_to_answer", "up_to_answer", "up_to_slow")
    }
    ends = [g.shown for g in log.gestures[1:]] + [float(t[-1])]
    for sign, end in zip(log.gestures, ends, strict=False):
        after = (t >= sign.shown - _EARLY) & (t < max(end, sign.shown + 1.0))
        if sign.sign == "down":
            for name, what in (("down_to_request", requested), ("down_to_industrial", industrial)):
                first = t[after & what]
                if len(first):
                    out[name].append(max(0.0, float(first[0]) - sign.shown))
        else:
            fast = t[after & industrial & (t < sign.shown + _PATIENCE)]
            out["up_to_slow"].append(max(0.0, float(fast[-1]) - sign.shown) if len(fast) else 0.0)
        if sign.answered >= 0.0:
            out[f"{sign.sign}_to_answer"].append(sign.answered - sign.shown)
    return {f"{k}_s": round(float(np.mean(v)), 4) if v else None for k, v in out.items()}


def breakdown(log: Log, config: CellConfig) -> Figures:
    """Where the time of a round went that adapting can win [s], and the caps in force [m/s]."""
    t, human = log["t"], log["human"]
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    tired = log["fatigued"] > 0.5
    industrial = log["mode"] == Mode.INDUSTRIAL
    away = log["true_separation"] >= config.separation.permit
    showing = (human == Action.SPEED_UP) | (human == Action.SLOW_DOWN)
    rests = int((np.diff(tired.astype(int)) == 1).sum())

    def seconds(mask: Mask) -> float:
        return round(float(mask.sum()) * step, 3)

    def mean(values: Array, mask: Mask) -> float | None:
        return round(float(values[mask].mean()), 4) if mask.any() else None

    return {
        "rests": rests,
        "fatigued_s": seconds(tired),
        "fatigued_per_rest_s": round(seconds(tired) / rests, 3) if rests else None,
        "waiting_s": seconds((human == Action.DETECT) & ~at_work(log)),
        "away_s": seconds(away),
        "showing_s": seconds(showing),
        "away_not_industrial_s": seconds(away & ~industrial),
        "industrial_share_of_away": _share(industrial[away]) if away.any() else None,
        "cap_industrial_m_s": mean(log["cap"], industrial),
        "cap_permitted_away_m_s": mean(permitted_speed(log, config), away),
        "speed_industrial_m_s": mean(log["speed"], industrial & (log["robot_moving"] > 0.5)),
        "speed_collaborative_m_s": mean(log["speed"], ~industrial & (log["robot_moving"] > 0.5)),
    }


def entries(log: Log, config: CellConfig) -> list[dict[str, float]]:
    """Each time the person comes near while the robot works fast: until the tool is slow."""
    t, true = log["t"], log["true_separation"]
    near = true < config.separation.permit
    slow = config.motion.collaborative_speed + OVER
    out = []
    for k in np.flatnonzero(near[1:] & ~near[:-1]) + 1:
        if log["mode"][k] != Mode.INDUSTRIAL and log["speed"][k] <= slow:
            continue
        fast = np.flatnonzero((t >= t[k]) & (t < t[k] + 2.0) & (log["speed"] > slow))
        sensed = np.flatnonzero((t >= t[k]) & (log["separation"] < config.separation.permit))
        decided = np.flatnonzero((t >= t[k]) & (log["mode"] != Mode.INDUSTRIAL))
        at = [float(t[i[0]] - t[k]) if len(i) else 0.0 for i in (sensed, decided)]
        total = float(t[fast[-1]] - t[k]) + 0.04 if len(fast) else 0.0
        out.append({"sensing": at[0], "deciding": at[1] - at[0], "total": total})
    return out


def figures(log: Log, config: CellConfig) -> Figures:
    """All of them, for a round's JSON."""
    out: Figures = {"over_cap_ticks": over(log, log["cap"])}
    if not log.with_person:
        return {**out, "over_permitted_ticks": None, "true_min_separation_m": None}
    shown = signs(log)
    stops = [e["total"] for e in entries(log, config)]
    return {
        **out,
        "over_permitted_ticks": over(log, permitted_speed(log, config)),
        "true_min_separation_m": round(float(log["true_separation"].min()), 4),
        "fluency": fluency(log["robot_moving"] > 0.5, at_work(log), log["t"]),
        "signs": shown,
        "sign_seen_s": round(float(np.mean(shown["delay_s"])), 4) if shown["delay_s"] else None,
        "delays": delays(log),
        "breakdown": breakdown(log, config),
        "to_slow_s": {"count": len(stops), "max": round(max(stops), 3) if stops else None},
    }


def _end(sign: Any) -> float:
    return float(sign.answered if sign.answered >= 0.0 else sign.shown + _PATIENCE)


def _share(mask: Mask) -> float:
    return round(float(mask.mean()), 6) if len(mask) else 0.0
