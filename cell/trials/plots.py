"""PNG pictures of a campaign (matplotlib without a display)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import ConfigError
from cell.trials.campaign import Record, Results
from cell.trials.log import SIGNS, Log, segments
from cell.trials.tables import completed
from cell.wire.vocabulary import Action, Mode

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#555555", "#F0E442")
"""Told apart by colour-blind people, too (Okabe and Ito)."""
_ROBOT = (Action.NO_OP, Action.DETECT, Action.DETECT_PICK, Action.PICK, Action.INSPECT,
          Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN)  # fmt: skip


def check() -> None:
    """Raises `ConfigError` where matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ConfigError(
            "the report's plots need matplotlib: pip install 'sorting-cell[trials]' (or -e .[trials]); "
            "--no-report runs the rounds without"
        ) from None


def _figure(width: float, height: float, rows: int = 1, columns: int = 1, **more: Any) -> tuple[Any, Any]:
    check()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **more)


def sort_times(path: Path, table: Sequence[Record], names: Sequence[str]) -> None:
    """Fig. 7: sort time per person and policy; bars are means, dots are rounds."""
    people = sorted({(r["person"], r["persona"]) for r in table})
    figure, axes = _figure(max(6.5, 1.3 * len(people) + 3.5), 4.2, 1, 2, width_ratios=[len(people) + 1, 1.6])
    left, right = axes[0]
    width = 0.8 / len(names)
    for k, name in enumerate(names):
        mine = [r for r in table if r["contender"] == name and completed(r)]
        offset = (k - (len(names) - 1) / 2) * width
        for i, (number, _) in enumerate(people):
            times = [r["sort_time_s"] for r in mine if r["person"] == number]
            _bar(left, i + offset, times, width, k, name if i == 0 else None)
        _bar(right, offset, [r["sort_time_s"] for r in mine], width, k, None)
    left.set_xticks(range(len(people)), [f"{persona}\n(person {n})" for n, persona in people])
    right.set_xticks([0], ["all"])
    right.set_xlim(-0.7, 0.7)
    top = max((r["sort_time_s"] for r in table), default=1.0) * 1.22
    for axis in (left, right):
        axis.set_ylim(0, top)
        axis.grid(axis="y", alpha=0.3)
    left.set_ylabel("sort time of a round [s]")
    figure.suptitle("Sort time per person and policy (bar: mean; line: 1 sd; dots: rounds)", fontsize=10)
    left.legend(fontsize=9, ncols=min(3, len(names)), loc="upper left")
    figure.savefig(path, dpi=120)


def _bar(axis: Any, x: float, values: list[float], width: float, k: int, label: str | None) -> None:
    if not values:
        return
    sd = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    axis.bar(x, np.mean(values), width * 0.92, yerr=sd, color=COLOURS[k % len(COLOURS)], alpha=0.75,
             label=label, error_kw={"lw": 1.2, "capsize": 3})  # fmt: skip
    spots = x + np.linspace(-0.25, 0.25, len(values)) * width if len(values) > 1 else [x]
    axis.plot(spots, values, "o", ms=3.5, color="black", alpha=0.7)


def fluency(path: Path, table: Sequence[Record], names: Sequence[str]) -> None:
    """Fluency, delays, and where the time of a rest goes, per policy."""
    groups = (
        ("share of the round", ("human_idle", "robot_idle", "concurrent", "functional_delay_share")),
        (
            "delay from the sign [s]",
            ("sign_seen_s", "down_to_answer_s", "down_to_industrial_s", "up_to_answer_s"),
        ),
        ("seconds of a round", ("fatigued_s", "away_s", "industrial_s", "showing_s")),
    )
    figure, axes = _figure(12.5, 4.0, 1, 3)
    width = 0.8 / len(names)
    for axis, (title, columns) in zip(axes[0], groups, strict=True):
        for k, name in enumerate(names):
            offset = (k - (len(names) - 1) / 2) * width
            for i, column in enumerate(columns):
                known = [r[column] for r in table if r["contender"] == name and r[column] is not None]
                _bar(axis, i + offset, known, width, k, name if i == 0 else None)
        words = [c.removesuffix("_s").removesuffix("_share").replace("_", "\n") for c in columns]
        axis.set_xticks(range(len(columns)), words, fontsize=8)
        axis.set_xlim(-0.5, len(columns) - 0.5)
        axis.set_title(title, fontsize=10)
        axis.grid(axis="y", alpha=0.3)
    axes[0][0].legend(fontsize=8)
    figure.savefig(path, dpi=120)


def timeline(path: Path, log: Log, title: str) -> None:
    """One round: what both do, belief and signs, separation, caps and speed."""
    t = log["t"] - log["t"][0]
    figure, axes = _figure(12.5, 8.2, 4, 1, sharex=True, height_ratios=[1.5, 1, 1, 1])
    lanes, top, middle, bottom = axes[:, 0]
    _lanes(lanes, log)
    top.plot(t, log["belief"], color="black", lw=1.2, label="belief: P(fatigued)")
    if log.with_person:
        top.fill_between(
            t, 0, 1, where=log["fatigued"] > 0.5, color="#D55E00", alpha=0.15, lw=0, label="truly fatigued"
        )
        middle.plot(t, np.minimum(log["true_separation"], 2.0), color="0.6", lw=1, label="true separation")
    for column, level, width, words in (("sign", 1.18, 4, "shown"), ("sign_seen", 1.09, 2.5, "seen")):
        for sign, colour in (("down", "#D55E00"), ("up", "#009E73")):
            if column in log.columns:
                height = np.where(log[column] == SIGNS[sign], level, np.nan)
                top.plot(t, height, color=colour, lw=width, label=f"thumbs {sign}, {words}")
    top.set_ylim(-0.05, 1.3)
    top.set_ylabel("belief")
    middle.plot(t, np.minimum(log["separation"], 2.0), color="#0072B2", lw=1, label="known separation")
    for column, colour, words in (
        ("permitted", "#009E73", "permitted"),
        ("requested", "#E69F00", "requested"),
    ):
        middle.fill_between(
            t, 0, 2, where=log[column] > 0.5, color=colour, alpha=0.15, lw=0, label=f"industrial {words}"
        )
    middle.set_ylabel("separation [m]")
    bottom.plot(t, log["cap"], color="black", lw=1.2, drawstyle="steps-post", label="cap in force")
    bottom.plot(t, log["speed"], color="#0072B2", lw=0.8, label="tool speed")
    for mode, colour in ((Mode.INDUSTRIAL, "#E69F00"), (Mode.HOLD, "0.4")):
        bottom.fill_between(
            t,
            0,
            1.05,
            where=log["mode"] == mode,
            color=colour,
            alpha=0.18,
            lw=0,
            label=f"{mode.name.lower()} mode",
        )
    bottom.set_ylabel("tool [m/s]")
    bottom.set_xlabel("time [s]")
    for axis in (top, middle, bottom):
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    figure.suptitle(title, fontsize=11)
    figure.savefig(path, dpi=110)


def _lanes(axis: Any, log: Log) -> None:
    """Gantt-like bars of both agents' actions."""
    t = log["t"] - log["t"][0]
    names = [a.name.lower().replace("_", " ") for a in _ROBOT]
    shades = ("0.88", "#56B4E9", "#0072B2", "#009E73", "#F0E442", "#E69F00", "#D55E00", "#CC79A7", "#882255")
    used = set()
    for level, column in ((1, "robot"), (0, "human")):
        if column not in log.columns:
            continue
        for action, a, b in segments(log[column]):
            words = names[action] if action < len(names) else ("thumbs up" if action == 7 else "thumbs down")
            if column == "robot" and action >= len(names):
                words = Action(action).name.lower().replace("_", " ")
            label = words if words not in used else None
            used.add(words)
            end = t[b] if b < len(t) else t[-1]
            axis.broken_barh(
                [(t[a], end - t[a])], (level - 0.4, 0.8), color=shades[action], lw=0, label=label
            )
    axis.set_yticks([0, 1], ["person", "robot"])
    axis.set_xlim(t[0], t[-1])
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)


def draw(results: Results, table: Sequence[Record]) -> dict[str, Path]:
    """All pictures, in the campaign's folder; by their names."""
    names, folder = results.settings.names, results.folder
    out = {"sort-time": folder / "sort-time.png", "fluency": folder / "fluency.png"}
    sort_times(out["sort-time"], table, names)
    fluency(out["fluency"], table, names)
    for name in names[:2]:
        mine = [r for r in table if r["contender"] == name and completed(r)]
        if mine:
            shown = max(mine, key=lambda r: (r["industrial_s"], r["rests"] or 0))
            key = f"timeline-{_plain(name)}"
            out[key] = folder / f"{key}.png"
            title = f"{shown['persona']}, {name}, seed {shown['seed']}: {shown['sort_time_s']:.0f} s"
            timeline(out[key], results.log(shown["id"]), title)
    return out


def _plain(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-_" else "-" for c in name)[-40:]
