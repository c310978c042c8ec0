"""`report.html`: tables, statistics, pictures, settings, machine and limits in one file."""

from __future__ import annotations

import base64
import html
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cell.trials import plots
from cell.trials.campaign import Record, Results, write_atomically
from cell.trials.tables import rows, write

REPORT = "report.html"
_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:1150px;padding:0 1rem;color:#1b1b1b}
h1{font-size:1.6rem;margin-bottom:.2rem}h2{font-size:1.2rem;margin-top:2.2rem;border-bottom:1px solid #ccc}
table{border-collapse:collapse;font-size:13px;margin:.6rem 0}th,td{padding:.2rem .6rem;text-align:right;
border-bottom:1px solid #e4e4e4;white-space:nowrap}th{background:#f4f4f4}
td:first-child,th:first-child{text-align:left}
img{max-width:100%;height:auto}.wide{overflow-x:auto}.note{color:#555}.warn{
background:#fff3cd;padding:.5rem .8rem;border-left:4px solid #e0a800}
dl{display:grid;grid-template-columns:max-content auto;gap:.1rem 1rem}dd{margin:0}
"""
_SHOWN = (
    ("sort_time_s", "sort time [s]"), ("by_robot", "onions by robot"), ("by_human", "by person"),
    ("misplaced", "misplaced"), ("industrial_s", "industrial mode [s]"), ("mode_switches", "mode switches"),
    ("waiting_s", "person without work [s]"), ("rests", "rests"),
    ("fatigued_per_rest_s", "a rest [s]"), ("gesture_delay_s", "sign to answer [s]"),
    ("down_to_industrial_s", "sign to industrial [s]"), ("human_idle", "person idle"),
    ("robot_idle", "robot idle"), ("concurrent", "both active"),
    ("functional_delay_share", "functional delay"),
    ("true_min_separation_m", "least separation [m]"), ("yields", "gave way"),
    ("cap_permitted_away_m_s", "permitted while away [m/s]"),
    ("cap_industrial_m_s", "cap in industrial [m/s]"),
)  # fmt: skip
_ROUND = (
    "id", "persona", "contender", "sort_time_s", "by_robot", "by_human", "misplaced", "dropped", "rests",
    "industrial_s", "true_min_separation_m", "over_permitted_ticks", "yields", "failure",
)  # fmt: skip
_LIMITS = (
    "Simulated people, arm, onions and cameras: nothing here is measured on people or on a real arm, and "
    "simulated times are not a real arm's.",
    "Five made-up people stand for persons; the interval over persons speaks of people made up like them.",
    "Rounds of one pair share batch and seed, but the person answers to what the robot does: the rounds part "
    "after the first difference.",
    "Nobody learns or tires from round to round: the order of the rounds, though balanced, cannot matter.",
    "Not a safety-rated system; separation figures are those of the simulation's own truth.",
)


def build(results: Results) -> Record:
    """Write tables, pictures and the report into the campaign's folder; the summary.

    Raises:
        ConfigError: matplotlib is missing.
    """
    plots.check()
    summary, table = write(results), rows(results)
    pictures = plots.draw(results, table) if table else {}
    write_atomically(results.folder / REPORT, page(results, summary, table, pictures).encode())
    return summary


def page(results: Results, summary: Record, table: Sequence[Record], pictures: Mapping[str, Path]) -> str:
    """The whole page."""
    settings, rounds = results.settings, summary["rounds"]
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>Sorting trials</title>",
        f"<style>{_STYLE}</style></head><body><h1>Sorting trials</h1>",
        f"<p class='note'>{len(settings.people)} simulated people, {settings.rounds} rounds each of "
        f"{settings.onions} onions; {', '.join(map(_e, settings.names))}; seed {settings.seed}.</p>",
    ]
    if rounds["finished"] < rounds["expected"]:
        parts.append(_warn(f"Incomplete: {rounds['finished']} of {rounds['expected']} rounds are done."))
    if settings.perception == "truth":
        parts.append(
            _warn("Quick mode (--perception truth): the supervisor was told of the person what the "
                  "simulation knows; no person camera was in the loop. Not a result of the cell.")
        )  # fmt: skip
    if len(summary["commits"]) > 1:
        parts.append(_warn(f"Rounds of several versions: {', '.join(summary['commits'])}."))
    parts += [_comparisons(summary["comparisons"]), "<h2>Pictures</h2>"]
    parts += [f"<p><img alt='{_e(name)}' src='{_inline(path)}'></p>" for name, path in pictures.items()]
    parts += [
        "<h2>Per policy</h2>",
        _per_policy(summary),
        "<h2>All rounds together</h2>",
        _list(summary["totals"]),
    ]
    body = [[r[k] for k in _ROUND] for r in table]
    parts += ["<h2>Rounds</h2>", _table([k.replace("_", " ") for k in _ROUND], body)]
    parts += ["<h2>Settings, version, machine</h2>", _list(_circumstances(summary))]
    parts += [
        "<h2>Limits of the claim</h2><ul>",
        *(f"<li>{_e(x)}</li>" for x in _LIMITS),
        "</ul></body></html>\n",
    ]
    return "".join(parts)


def _comparisons(found: Iterable[Record]) -> str:
    out = ["<h2>Sort time, paired</h2>"]
    for c in found:
        title = f"<h3>{_e(c['first'])} against {_e(c['second'])}</h3>"
        if "note" in c:
            out.append(f"{title}<p>{_e(c['note'])}: {c['pairs']}.</p>")
            continue
        strength, because = c["power"], c["because"]
        out.append(
            f"{title}<p><b>{_percent(c['share'])}</b> (95 % interval {_percent(c['share_ci'][0])} to "
            f"{_percent(c['share_ci'][1])}): {c['first_mean']:.1f} s against {c['second_mean']:.1f} s, "
            f"difference {c['mean']:+.1f} s ({_n(c['ci'][0])} to {_n(c['ci'][1])}) over {c['pairs']} "
            f"pairs of {c['persons']} persons.</p>"
        )
        out.append(
            _list(
                {
                    "p, changing signs": c["p_permutation"],
                    "p, Wilcoxon's signed ranks": c["p_wilcoxon"],
                    "effect d_z (Hedges' g)": f"{_n(c['effect'])} ({_n(c['effect_g'])})",
                    "persons as random effects": f"{_n(c['person_mean'])} s, 95 % interval "
                    f"{_n(c['person_ci'][0])} to {_n(c['person_ci'][1])}, p {_n(c['person_p'])}",
                    "sd between persons, within": f"{_n(c['person_sd'])} s, {_n(c['residual_sd'])} s",
                    "power at this effect, alpha 0.05 (0.01)": f"{_n(strength['observed_alpha_0.05'])} "
                    f"({_n(strength['observed_alpha_0.01'])})",
                    "power for -20 %, alpha 0.01": strength["goal_20_percent_alpha_0.01"],
                    "least difference found with 80 % power": _percent(strength["detectable_share"]),
                    "pairs for 80 % power": strength["pairs_for_80_percent"],
                    "mean differences": ", ".join(
                        f"{k.replace('_', ' ')} {_n(v)}" for k, v in because.items()
                    ),
                }
            )
        )
    return "".join(out)


def _per_policy(summary: Record) -> str:
    names = summary["policies"]
    body = []
    for key, words in _SHOWN:
        spreads = [summary["by_policy"][name].get(key) or {} for name in names]
        body.append([words, *(f"{_n(s['mean'])} ± {_n(s['sd'])}" if s else "" for s in spreads)])
    completed = [
        f"{summary['by_policy'][n]['completed']} of {summary['by_policy'][n]['rounds']}" for n in names
    ]
    return _table(["mean ± sd between rounds", *names], [["completed", *completed], *body])


def _circumstances(summary: Record) -> Record:
    machine = summary["machine"]
    settings = {k: v for k, v in summary["settings"].items() if k != "format"}
    return {
        **settings,
        "version of the rounds": ", ".join(summary["commits"]),
        "hosts": ", ".join(machine["hosts"]),
        "written on": f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, "
        f"Python {platform.python_version()}",
        "wall time": f"{machine['wall_s']:.0f} s in {len(machine['sessions'])} sessions",
        "aggregate real-time factor": machine["aggregate_real_time_factor"],
        "CPU of a round [s]": (machine["cpu_s"] or {}).get("mean"),
        "memory of a round's processes [MB]": (machine["memory_mb"] or {}).get("max"),
    }


def _table(header: Sequence[str], body: Iterable[Sequence[Any]]) -> str:
    head = "".join(f"<th>{_e(h)}</th>" for h in header)
    lines = ("".join(f"<td>{_e(_n(cell))}</td>" for cell in row) for row in body)
    return f"<div class='wide'><table><tr>{head}</tr>{''.join(f'<tr>{x}</tr>' for x in lines)}</table></div>"


def _list(items: Mapping[str, Any]) -> str:
    pairs = "".join(f"<dt>{_e(k.replace('_', ' '))}</dt><dd>{_e(_n(v))}</dd>" for k, v in items.items())
    return f"<dl>{pairs}</dl>"


def _inline(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()


def _warn(text: str) -> str:
    return f"<p class='warn'>{_e(text)}</p>"


def _percent(value: float | None) -> str:
    return "not known" if value is None else f"{100 * value:+.1f} %"


def _n(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.4g}"
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _e(text: Any) -> str:
    return html.escape(str(text), quote=True)
