"""What a person at the terminal sees of a campaign: progress with time left, then the result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from cell.clock import perf_s
from cell.trials.campaign import Campaign, Record
from cell.trials.schedule import RoundSpec

__all__ = ["Console", "show", "watched"]


@contextmanager
def watched(
    console: Console, campaign: Campaign, specs: Sequence[RoundSpec], workers: int
) -> Iterator[Callable[[Record], None]]:
    """A progress bar over the rounds; in a file or pipe a line per round."""
    left, began = len(campaign.left(specs)), perf_s()
    if left < len(specs):
        console.print(f"{len(specs) - left} of {len(specs)} rounds are done already", highlight=False)
    columns = (
        TextColumn("trials"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("{task.fields[note]}"),
    )  # fmt: skip
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=len(specs), completed=len(specs) - left, note="")
        done = 0

        def tell(record: Record) -> None:
            nonlocal done
            done += 1
            result, spent = record["result"], perf_s() - began
            remaining = _time(spent / done * (left - done))
            note = (
                f"about {remaining} left; {record['id']}: {result['sort_time_s']:.0f} s {result['failure']}"
            )
            progress.update(task, advance=1, note=note)
            if not console.is_terminal:
                console.print(f"{len(specs) - left + done}/{len(specs)} done, {note}", highlight=False)

        yield tell


def show(console: Console, summary: dict[str, Any], folder: Path) -> None:
    """The comparison and where everything is."""
    table = Table(title="Sort time of a round", title_justify="left")
    for name in ("policy", "rounds", "completed", "sort time [s]", "misplaced", "dropped", "industrial [s]"):
        table.add_column(name, justify="left" if name == "policy" else "right")
    for name in summary["policies"]:
        found = summary["by_policy"][name]
        time, fast = found["sort_time_s"], found["industrial_s"]
        table.add_row(
            name, str(found["rounds"]), str(found["completed"]), _pm(time),
            *(f"{found[k].get('mean', 0.0) * found['rounds']:.0f}" for k in ("misplaced", "dropped")),
            _pm(fast),
        )  # fmt: skip
    console.print(table)
    for c in summary["comparisons"]:
        if "note" in c:
            continue
        low, high = (100 * v for v in c["share_ci"])
        console.print(
            f"{c['first']} against {c['second']}: {100 * c['share']:+.1f} % ({low:+.1f} to {high:+.1f} %), "
            f"p = {c['p_permutation']:.3g}, {c['pairs']} pairs",
            highlight=False,
        )
    console.print(f"written to {folder}", highlight=False)


def _pm(spread: dict[str, float]) -> str:
    return f"{spread['mean']:.1f} ± {spread['sd']:.1f}" if spread else ""


def _time(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"
