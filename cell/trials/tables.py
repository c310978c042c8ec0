"""The tables of a campaign: `rounds.csv`, a row per round, and `summary.json`.

Rows hold only what is simulated, so that they are the same whatever ran them; what the machine took
is in the summary under "machine".
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np

from cell.frames import Array
from cell.trials.campaign import Record, Results, write_atomically
from cell.trials.statistics import detectable, paired, pairs_for, power
from cell.version import commit

TABLE, SUMMARY = "rounds.csv", "summary.json"
_FEWEST = 3
"""With fewer pairs an interval says nothing."""
_GOAL = (0.2, 0.01)
"""Difference of the sort time, as a share, and alpha, for which the power is said, too."""


def _at(*path: str) -> Callable[[Record], Any]:
    def value(record: Record) -> Any:
        found: Any = record
        for key in path:
            if found is None or key not in found:
                return None
            found = found[key]
        return found

    return value


COLUMNS: dict[str, Callable[[Record], Any]] = {
    **{k: _at(k) for k in (
        "id", "person", "persona", "block", "order", "contender", "belief", "seed", "perception")},
    **{
        k: _at("result", k)
        for k in (
            "backend", "policy", "onions", "sorted", "by_robot", "by_human", "misplaced", "dropped",
            "sort_time_s", "mode_switches", "industrial_s", "min_separation_m", "gesture_delay_s", "yields",
            "arm_contacts", "person_contacts", "misplaced_by_human",
        )
    },
    **{f"max_tcp_{k}_m_s": _at("result", "max_tcp_speed_m_s", k) for k in ("collaborative", "industrial")},
    **{k: _at("figures", k) for k in (
        "true_min_separation_m", "over_cap_ticks", "over_permitted_ticks", "sign_seen_s")},
    **{k: _at("figures", "fluency", k) for k in (
        "robot_idle", "human_idle", "concurrent", "functional_delay_share")},
    **{f"signs_{k}": _at("figures", "signs", k) for k in ("shown", "missed", "swapped", "false")},
    **{k: _at("figures", "delays", k) for k in (
        "down_to_request_s", "down_to_industrial_s", "down_to_answer_s", "up_to_answer_s", "up_to_slow_s")},
    **{k: _at("figures", "breakdown", k) for k in (
        "rests", "fatigued_s", "fatigued_per_rest_s", "waiting_s", "away_s", "showing_s",
        "away_not_industrial_s", "industrial_share_of_away", "cap_industrial_m_s",
        "cap_permitted_away_m_s", "speed_industrial_m_s",
        "speed_collaborative_m_s")},
    "failure": _at("result", "failure"),
}  # fmt: skip
"""Columns of the table and where they are in a round's JSON."""
MEASURED = tuple(COLUMNS)[list(COLUMNS).index("sorted") : list(COLUMNS).index("failure")]
"""Columns that are summed up per policy."""


def rows(results: Results) -> list[Record]:
    """A row per finished round."""
    return [{name: get(record) for name, get in COLUMNS.items()} for record in results.records]


def to_csv(table: list[Record]) -> str:
    """CSV text; what is not known is an empty cell."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in table:
        writer.writerow(["" if row[k] is None else _text(row[k]) for k in COLUMNS])
    return out.getvalue()


def summarise(results: Results) -> Record:
    """Per policy, per pair of policies, totals, and what it took."""
    table, names = rows(results), results.settings.names
    return {
        "settings": {
            k: v for k, v in results.settings.as_dict().items() if k not in ("config", "contenders")
        },
        "policies": list(names),
        "commits": sorted({r["result"]["commit"] for r in results.records}),
        "rounds": {"finished": len(table), "expected": results.expected},
        "totals": _totals(table),
        "by_policy": {name: _of_policy([r for r in table if r["contender"] == name]) for name in names},
        "comparisons": [compare(table, a, b) for a, b in combinations(names, 2)],
        "machine": _machine(results),
        "written_by": commit(),
    }


def compare(table: list[Record], first: str, second: str, value: str = "sort_time_s") -> Record:
    """Paired figures of two policies: over the pairs of which both rounds are there and completed."""
    sides: list[dict[tuple[int, int], Record]] = [
        {(r["person"], r["block"]): r for r in table if r["contender"] == name and completed(r)}
        for name in (first, second)
    ]
    both = sorted(set(sides[0]) & set(sides[1]))
    out: Record = {"first": first, "second": second, "value": value, "pairs": len(both)}
    if len(both) < _FEWEST:
        return {**out, "note": f"too few pairs, {_FEWEST} are the fewest"}
    a, b = (np.array([side[k][value] for k in both], float) for side in sides)
    found = paired(a, b, np.array([k[0] for k in both]))
    goal = _GOAL[0] * found.second_mean / found.sd if found.sd > 0.0 else float("inf")
    return {
        **out,
        **found.as_dict(),
        "power": {
            "observed_alpha_0.05": _round(power(found.effect, found.pairs)),
            "observed_alpha_0.01": _round(power(found.effect, found.pairs, 0.01)),
            "goal_20_percent_alpha_0.01": _round(power(min(goal, 50.0), found.pairs, _GOAL[1])),
            "detectable_share": _round(detectable(found.pairs) * found.sd / found.second_mean),
            "pairs_for_80_percent": pairs_for(found.effect),
        },
        "because": _because(sides, both),
    }


def _because(sides: list[dict[tuple[int, int], Record]], both: list[tuple[int, int]]) -> Record:
    """Mean differences, first minus second, of what may explain the difference in sort time."""
    out = {}
    for name in (
        "industrial_s",
        "by_human",
        "fatigued_s",
        "away_s",
        "waiting_s",
        "showing_s",
        "yields",
        "robot_idle",
        "human_idle",
    ):
        pairs = [(sides[0][k][name], sides[1][k][name]) for k in both]
        known = [(a, b) for a, b in pairs if a is not None and b is not None]
        out[name] = _round(float(np.mean([a - b for a, b in known]))) if known else None
    return out


def completed(row: Record) -> bool:
    """Every onion handled, none dropped."""
    return not row["failure"] and not row["dropped"] and row["sorted"] >= row["onions"]


def write(results: Results) -> Record:
    """Write both tables into the campaign's folder; the summary."""
    summary = summarise(results)
    write_atomically(results.folder / TABLE, to_csv(rows(results)).encode())
    write_atomically(results.folder / SUMMARY, (json.dumps(summary, indent=1) + "\n").encode())
    return summary


def _of_policy(table: list[Record]) -> Record:
    return {
        "rounds": len(table),
        "completed": sum(completed(r) for r in table),
        **{name: spread([r[name] for r in table]) for name in MEASURED},
    }


def _totals(table: list[Record]) -> Record:
    def total(name: str) -> float | None:
        known = [r[name] for r in table if r[name] is not None]
        return sum(known) if known else None

    onions, misplaced = total("onions"), total("misplaced")
    return {
        "completed": sum(completed(r) for r in table),
        "onions": onions,
        "dropped": total("dropped"),
        "misplaced": misplaced,
        "misplaced_by_human": total("misplaced_by_human"),
        "misplaced_share": _round(misplaced / onions) if misplaced is not None and onions else None,
        "over_permitted_ticks": total("over_permitted_ticks"),
        "over_cap_ticks": total("over_cap_ticks"),
        "arm_contacts": total("arm_contacts"),
        "person_contacts": total("person_contacts"),
        "simulated_s": _round(total("sort_time_s") or 0.0),
    }


def _machine(results: Results) -> Record:
    parts = [r["machine"] for r in results.records]
    wall = sum(s["wall_s"] for s in results.sessions)
    simulated = sum(r["result"]["sort_time_s"] for r in results.records)
    return {
        "sessions": results.sessions,
        "hosts": sorted({p["host"] for p in parts}),
        "wall_s": _round(wall),
        "aggregate_real_time_factor": _round(simulated / wall) if wall else None,
        "real_time_factor": spread([p["real_time_factor"] for p in parts]),
        "cpu_s": spread([p["cpu_s"] for p in parts]),
        "cpu_node_s": spread([p["cpu_node_s"] for p in parts]),
        "memory_mb": spread([p["memory_mb"] for p in parts]),
    }


def spread(values: list[Any]) -> dict[str, float | None]:
    """Mean, standard deviation, least and greatest of the values that are known."""
    known: Array = np.array([v for v in values if v is not None], float)
    if not len(known):
        return {}
    sd = float(known.std(ddof=1)) if len(known) > 1 else 0.0
    named = {"mean": float(known.mean()), "sd": sd, "min": float(known.min()), "max": float(known.max())}
    return {k: _round(v) for k, v in named.items()}


def _round(value: float | None) -> float | None:
    """To four places; None for what is not known or not a number."""
    return round(float(value), 4) if value is not None and math.isfinite(value) else None


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
