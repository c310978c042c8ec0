"""A replay for people: progress, verdict, and what has changed since the recording."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import Progress, TextColumn, TimeElapsedColumn

from cell.replay.recorded import Recorded, Then
from cell.replay.replay import replay
from cell.version import commit, machine


def show(path: Path, within: float = 0.0) -> bool:
    """Replay `path` and print the verdict; whether all outputs were identical. Raises CellError.

    Args:
        within: see `replay`.
    """
    recorded = Recorded(path)
    console = Console(stderr=True)
    columns = (TextColumn("replaying tick {task.completed}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("")
        verdict = replay(recorded, lambda number: progress.update(task, completed=number), within)
    print(_origin(recorded.then))
    if verdict.difference is not None:
        print("\n".join(verdict.difference.lines()))
        there = recorded.then.facts.get("machine", "")
        if there != machine():
            print(f"recorded on {there or 'an unknown machine'}; this is {machine()}: see --within")
        return False
    how = f"equal within {within:g}" if within else "identical, byte for byte"
    print(f"{how}: {verdict.ticks} ticks, {verdict.duration:.1f} s")
    if verdict.ended_early:
        print(f"the recording has no end ({verdict.ended_early}); this is all that it holds")
    return True


def _origin(then: Then) -> str:
    facts = then.facts
    what = ", ".join(
        f"{name} {facts[name]}" for name in ("policy", "person", "onions", "seed") if name in facts
    )
    return f"{what}; recorded by {facts.get('commit', 'unknown')}, replayed by {commit()}"
