"""Bounds of a small fixed campaign, in simulated seconds: what CI holds every change to.

The file names the campaign and its bounds. Simulated time is the same on every run of one machine
type, so that a slow machine cannot fail it; other processors round differently, and a change of the
cell may shift a time a little: the sort times have room on both sides.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cell.config import CellConfig
from cell.errors import ConfigError
from cell.trials.campaign import Record
from cell.trials.settings import Settings, cell_data, contenders, people
from cell.trials.tables import completed

ROOM = 0.15
"""Room for the sort times to both sides, as a share."""
LIMITS = {
    "incomplete": 0, "dropped": 0, "over_permitted_ticks": 0, "arm_contacts": 0, "person_contacts": 0,
}  # fmt: skip
"""Sums over the campaign that must not be exceeded, whatever was measured."""
MISPLACED = 0.05
"""Least bound of the share of misplaced onions: of so few onions a single one is a large share."""


def settings(bounds: Record, config: CellConfig) -> Settings:
    """The campaign that a bounds file names."""
    suite = bounds["suite"]
    return Settings(
        people(suite["people"]), suite["rounds"], contenders(suite["policies"], suite["perception"]),
        suite["onions"], suite["seed"], "sim", suite["perception"], cell_data(config),
    )  # fmt: skip


def measured(table: list[Record]) -> Record:
    """The figures that are held to bounds, of a campaign's rows."""
    onions = sum(r["onions"] for r in table)
    names = sorted({r["contender"] for r in table})
    return {
        "rounds": len(table),
        "incomplete": sum(not completed(r) for r in table),
        **{k: sum(r[k] or 0 for r in table) for k in LIMITS if k != "incomplete"},
        "misplaced_share": round(sum(r["misplaced"] for r in table) / max(onions, 1), 4),
        "sort_time_s": {
            name: _mean([r["sort_time_s"] for r in table if r["contender"] == name]) for name in names
        },
    }


def bounds_of(found: Record, onions: int) -> Record:
    """Bounds from what was measured: no worse, sort times within `ROOM`."""
    more = 1.0 / max(onions, 1)
    return {
        "rounds": found["rounds"],
        **LIMITS,
        "misplaced_share": round(max(MISPLACED, found["misplaced_share"] + more / 2), 4),
        "sort_time_s": {
            name: [round((1 - ROOM) * mean, 2), round((1 + ROOM) * mean, 2)]
            for name, mean in found["sort_time_s"].items()
        },
    }


def violations(found: Record, bounds: Record) -> list[str]:
    """A line for each bound that is broken."""
    out = []
    if found["rounds"] != bounds["rounds"]:
        out.append(f"rounds: {found['rounds']} are done, {bounds['rounds']} belong to the campaign")
    for name in (*LIMITS, "misplaced_share"):
        if found[name] > bounds[name]:
            out.append(f"{name.replace('_', ' ')}: {found[name]:g}, at most {bounds[name]:g} is allowed")
    for name, (low, high) in bounds["sort_time_s"].items():
        mean = found["sort_time_s"].get(name)
        if mean is None:
            out.append(f"sort time of {name}: no round")
        elif not low <= mean <= high:
            out.append(f"sort time of {name}: {mean:g} simulated seconds, allowed are {low:g} to {high:g}")
    return out


def difference(before: Record, after: Record, where: str = "") -> list[str]:
    """A line per value that changed between two bounds or figures."""
    out = []
    for key in sorted({*before, *after}):
        old, new, name = before.get(key), after.get(key), f"{where}{key}"
        if isinstance(old, dict) and isinstance(new, dict):
            out += difference(old, new, f"{name}.")
        elif old != new:
            out.append(f"{name}: {old} -> {new}")
    return out


def read(path: Path) -> Record:
    """A bounds file; raises `ConfigError`."""
    try:
        data: Any = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"cannot read bounds {path}: {error}") from None
    if not isinstance(data, dict) or not {"suite", "bounds"} <= set(data):
        raise ConfigError(f"{path} is no bounds file: it needs 'suite' and 'bounds'")
    return data


def _mean(values: list[float]) -> float:
    return round(sum(values) / len(values), 3)
