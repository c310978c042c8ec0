"""PNG plots of the reports (matplotlib without a display)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cell.errors import ConfigError


def _figure(columns: int = 1) -> tuple[Any, Any]:
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise ConfigError("plots need matplotlib; install the extra `learn`") from None
    figure = Figure(figsize=(5.2 * columns, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(1, columns, squeeze=False)[0]


def curve(path: Path, data: Mapping[str, Any], title: str, expert: float | None = None) -> None:
    """Learning curve: reward of the sampled policy and the discriminator's accuracy over env steps."""
    figure, (left, right) = _figure(2)
    steps = [p["env_steps"] for p in data["progress"]]
    left.plot(steps, [p["reward_priced"] for p in data["progress"]], label="sampled, training episodes")
    for decoding in ("greedy", "sampled"):
        points = [(e["env_steps"], e[f"{decoding}_reward_priced"]) for e in data["evaluations"]]
        if points:
            left.plot(*zip(*points, strict=True), marker=".", label=f"{decoding}, evaluated")
    if expert is not None:
        left.axhline(expert, color="black", linewidth=0.8, linestyle="--", label="expert")
    left.set(xlabel="joint environment steps", ylabel="reward per episode (priced)", title=title)
    left.legend(fontsize=8)
    right.plot(steps, [p["accuracy"] for p in data["progress"]])
    right.axhline(0.5, color="black", linewidth=0.8, linestyle="--")
    right.set(xlabel="joint environment steps", ylabel="discriminator accuracy", ylim=(0.4, 1.0))
    figure.savefig(path, dpi=130)


def rocs(
    path: Path, curves: Mapping[str, tuple[Sequence[float], Sequence[float], float]], title: str
) -> None:
    """ROC curves: name -> (false positive rates, true positive rates, AUC)."""
    figure, (axes,) = _figure()
    for name, (fpr, tpr, area) in curves.items():
        axes.plot(fpr, tpr, label=f"{name} ({area:.3f})")
    axes.plot([0, 1], [0, 1], color="black", linewidth=0.8, linestyle="--")
    axes.set(xlabel="false positive rate", ylabel="true positive rate", title=title)
    axes.legend(fontsize=8, title="AUC", loc="lower right")
    figure.savefig(path, dpi=130)


def lines(
    path: Path, series: Mapping[str, Sequence[tuple[float, float]]], x: str, y: str, title: str
) -> None:
    """Named series of points."""
    figure, (axes,) = _figure()
    for name, points in series.items():
        axes.plot(*zip(*points, strict=True), marker=".", label=name)
    axes.set(xlabel=x, ylabel=y, title=title)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=130)


def bars(path: Path, panels: Mapping[str, Mapping[str, tuple[float, float]]], y: str) -> None:
    """Named values with half widths of their intervals, a panel for each title."""
    figure, axes = _figure(len(panels))
    for axis, (title, values) in zip(axes, panels.items(), strict=True):
        names = list(values)
        axis.bar(names, [values[n][0] for n in names], yerr=[values[n][1] for n in names], capsize=3)
        axis.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=8)
        low = min(v for v, _ in values.values())
        axis.set(ylabel=y, title=title, ylim=(low * 0.8 if low > 0 else None, None))
    figure.savefig(path, dpi=130)
