"""Rounds one after the other, as an operator orders them; without an operator it is one."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from pathlib import Path

from cell.clock import WallClock
from cell.config import CellConfig
from cell.decision.policy import PolicyTable, load
from cell.errors import CellError
from cell.run.desk import Desk
from cell.run.link import Link
from cell.run.result import RoundResult
from cell.run.round import RoundOptions, Watcher, run_round

_IDLE = 0.03
"""Between two exchanges with the node while nothing is to be decided [s]."""
Show = Callable[[RoundOptions], AbstractContextManager[Watcher]]
"""Makes what shows a round's progress."""


def run_rounds(
    config: CellConfig,
    policy: PolicyTable,
    options: RoundOptions,
    show: Show,
    report: Callable[[RoundResult], None],
    watched: Callable[[], bool] | None = None,
) -> RoundResult:
    """Run a round and those that are ordered to follow it; the last one's result.

    Args:
        report: told every round's result, as soon as there is one.
        watched: whether somebody looks on, who may order another round; None: nobody can.

    Raises:
        CellError, KeyboardInterrupt: see `run_round`.
    """
    desk = Desk(config, again=watched is not None)

    def after(result: RoundResult, link: Link) -> None:
        report(result)
        if watched is not None:
            _wait(link, lambda: desk.next is None and watched())

    number, record = 1, options.record
    while True:
        with show(options) as watch:
            result = run_round(config, policy, options, watch, desk=desk, after=after)
        order, desk.next = desk.next, None
        if order is None:
            return result
        number += 1
        policy = load(order.policy)
        options = replace(
            options, onions=order.onions, seed=order.seed, record=record and _numbered(record, number)
        )


def _wait(link: Link, more: Callable[[], bool]) -> None:
    """Keep the lease while `more()`; an interruption or a lost node ends it."""
    clock = WallClock()
    with suppress(KeyboardInterrupt, CellError):
        while more():
            link.exchange(())
            clock.sleep_until(clock.now() + _IDLE)


def _numbered(path: Path, number: int) -> Path:
    """round.mcap -> round-2.mcap."""
    return path.with_stem(f"{path.stem}-{number}")
