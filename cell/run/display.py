"""What a person at the terminal sees: one live line per round, a table at its end."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from cell.clock import perf_s
from cell.decision.io import Inputs, Outputs
from cell.limits import tcp_positions
from cell.run.result import RoundResult
from cell.wire.vocabulary import Action, Mode, Prediction

_REDRAW = 0.1
"""Least time between two redraws of the live line [s]."""
_COLOURS = {Mode.COLLABORATIVE: "green", Mode.INDUSTRIAL: "yellow", Mode.STOPPED: "red"}


class Progress:
    """Live progress in a terminal; plain lines per sorted onion elsewhere."""

    def __init__(self, console: Console, onions: int, gripper_length: float) -> None:
        self._console, self._onions, self._length = console, onions, gripper_length
        self._live = (
            Live(console=console, refresh_per_second=10, transient=True) if console.is_terminal else None
        )
        self._drawn = 0.0
        self._sorted = 0
        self._last: tuple[float, object] | None = None

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def __call__(self, inputs: Inputs, outputs: Outputs) -> None:
        """Take in one tick."""
        state = outputs.state
        for event in outputs.events:
            if event.level >= 30:
                self._console.print(f"[yellow]{event.t:7.2f} s  {event.text}[/yellow]", highlight=False)
        if self._live is None:
            if state.sorted > self._sorted:
                self._sorted = state.sorted
                self._console.print(
                    f"{state.t:7.2f} s  {state.sorted}/{self._onions} sorted, {state.in_bin} in the bin",
                    highlight=False,
                )
            return
        p_WT = tcp_positions(inputs.joints.q[None, :], self._length)[0]
        speed = 0.0
        if self._last is not None and inputs.t > self._last[0]:
            before = self._last[1]
            speed = float(((p_WT - before) ** 2).sum() ** 0.5) / (inputs.t - self._last[0])
        self._last = (inputs.t, p_WT)
        if perf_s() - self._drawn < _REDRAW:
            return
        self._drawn = perf_s()
        mode = Mode(state.mode)
        line = Text.assemble(
            (f"{state.t:7.2f} s  ", "dim"),
            (f"{mode.name.lower():<13}", _COLOURS.get(mode, "white")),
            f"{Action(state.action).name.lower():<18}",
            f"{Prediction(state.prediction).name.lower():<12}",
            f"tool {speed:4.2f} of {state.speed_cap:4.2f} m/s   ",
            (f"{state.sorted}/{self._onions} sorted", "bold"),
            f"  ({state.in_bin} in the bin, {state.on_conveyor} back on the belt)",
        )
        self._live.update(line)


def summary(console: Console, result: RoundResult) -> None:
    """Print the round's result as a table, and its misses."""
    table = Table(title="Round", show_header=False, title_justify="left")
    table.add_column(style="dim")
    table.add_column()
    speed = result.max_tcp_speed_m_s
    rows = [
        ("sorted", f"{result.sorted} of {result.onions}"),
        (
            "misplaced / dropped",
            "not known" if result.dropped is None else f"{result.misplaced}{_own(result)} / {result.dropped}",
        ),
        (
            "sort time",
            f"{result.sort_time_s:.1f} s ({result.sort_time_s / max(result.sorted, 1):.1f} s an onion)",
        ),
        (
            "fastest tool",
            f"{speed['collaborative']:.3f} m/s collaborative, {speed['industrial']:.3f} m/s industrial",
        ),
        ("in industrial mode", f"{result.industrial_s:.1f} s"),
        ("real-time factor", f"{result.real_time_factor:.2f}"),
        ("policy, seed", f"{result.policy}, {result.seed}"),
    ]
    for name, value in rows:
        table.add_row(name, value)
    console.print(table)
    for line in result.misses:
        console.print(f"[yellow]{line}[/yellow]", highlight=False)
    if result.failure:
        console.print(f"[red]The round did not complete: {result.failure}[/red]", highlight=False)


def _own(result: RoundResult) -> str:
    """Whose mistakes the misplaced ones are, where the person made any."""
    return f" ({result.misplaced_by_human} by the person)" if result.misplaced_by_human else ""
