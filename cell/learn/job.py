"""How much a report computes, and in how many processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

from cell.learn.settings import Settings

Tick = Callable[[str], None]
"""Told of every finished part, for a progress bar."""


@dataclass(frozen=True)
class Job:
    """How much to compute: training seeds 1..n, evaluation episodes, hyperparameters, belief label,
    processes."""

    seeds: int
    episodes: int
    settings: Settings
    label: str
    workers: int = 1

    def map(self, function: Callable[[Any], Any], work: Sequence[Any]) -> Iterator[Any]:
        """Results in order; they do not depend on the number of processes."""
        if self.workers == 1:
            yield from map(function, work)
            return
        with ProcessPoolExecutor(self.workers, mp_context=get_context("spawn")) as pool:
            yield from pool.map(function, work)
