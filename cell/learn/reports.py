"""Reports by name: what computes their rows, and what draws them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cell.learn import plots
from cell.learn.belief.bank import BeliefBank
from cell.learn.demonstrations import LABELS
from cell.learn.domain.presets import Preset
from cell.learn.job import Job, Tick
from cell.learn.studies import MISSED, fig4, prices, recovery, robustness, theorem1, transfer
from cell.learn.table1 import LEARNERS, table1
from cell.learn.yardsticks import DEMONSTRATED, RECOVERIES, UNSEEN, Row

REPORTS: dict[str, Callable[[Preset, BeliefBank, Job, Tick], list[Row]]] = {
    "table1": table1,
    "fig4": fig4,
    "theorem1": theorem1,
    "recovery": recovery,
    "transfer": transfer,
    "prices": prices,
    "robustness": robustness,
}


def steps(what: str, presets: tuple[tuple[str, int], ...], job: Job) -> int:
    """Ticks a report makes, for its progress bar."""
    per = {
        "table1": job.seeds * (len(LEARNERS) + 1),
        "fig4": len(LABELS),
        "theorem1": 2 * job.seeds,
        "recovery": 3,
        "transfer": 2 * len(DEMONSTRATED) + len(UNSEEN) + 1,
        "prices": len(RECOVERIES),
        "robustness": len(MISSED),
    }
    return per[what] * len(presets)


def draw(what: str, rows: list[Row], path: Path) -> None:
    """The PNG of a report: Table 1 for all presets in it, the others for the last one."""
    last = [r for r in rows if (r["preset"], r["recovery"]) == (rows[-1]["preset"], rows[-1]["recovery"])]
    title = f"{rows[-1]['preset']}, recovery {rows[-1]['recovery']}"
    if what == "table1":
        panels: dict[str, dict[str, tuple[float, float]]] = {}
        for r in rows:
            values = panels.setdefault(f"{r['preset']}, recovery {r['recovery']}", {})
            reward = r["reward_priced"]
            values[f"{r['method']} ({r['decoding']})"] = (reward["mean"], reward["ci95"])
        plots.bars(path, panels, "reward per episode (priced)")
    elif what == "fig4":
        shown = [r for r in last if r["label"] == "hidden"]
        plots.rocs(path, {r["belief"]: (*r["curve"], r["auc"]) for r in shown}, f"{title}, hidden type")
    elif what == "theorem1":
        bounds = {f"{r['method']} {r['seed']}": (r["policy_gap"], 0.0) for r in last}
        plots.bars(path, {title: bounds}, "log-likelihood gap (discounted)")
    elif what == "prices":
        gains: dict[str, list[tuple[float, float]]] = {}
        of_one = [r for r in rows if r["preset"] == rows[-1]["preset"]]
        blind = {(r["recovery"], r["price"]): r for r in of_one if r["method"] == "dec-airl"}
        for r in of_one:
            if r["method"] == "tb-decairl":
                key = r["recovery"], r["price"]
                gain = r["reward_priced"]["mean"] - blind[key]["reward_priced"]["mean"]
                gains.setdefault(f"price {r['price']:g}", []).append((float(r["recovery"]), gain))
        plots.lines(
            path, gains, "recovery time [steps]", "TB-DecAIRL's reward less Dec-AIRL's", rows[0]["preset"]
        )
    elif what == "transfer":
        times = ", ".join(str(t) for t in rows[0]["trained_at"])
        points = {
            name: [(float(r["recovery"]), r["ratio_to_dp"]) for r in rows if r["demonstrated"] is shown]
            for name, shown in (("never demonstrated", False), ("demonstrated", True))
        }
        told = f"{rows[0]['preset']}, one reward learnt at recovery {times}"
        plots.lines(path, points, "recovery time [steps]", "reward / exact optimum", told)
    elif what == "robustness":
        over: dict[str, list[tuple[float, float]]] = {}
        for r in last:
            over.setdefault(r["method"], []).append((r["missed_gestures"], r["reward_priced"]["mean"]))
        plots.lines(path, over, "share of thumbs missed", "reward per episode (priced)", title)
    else:
        series: dict[str, list[tuple[float, float]]] = {}
        for r in rows:
            series.setdefault(r["method"], []).append((float(r["recovery"]), r["ratio_to_expert"]))
        plots.lines(
            path, series, "recovery time [steps]", "reward / expert's", f"trained at {rows[0]['trained_at']}"
        )
