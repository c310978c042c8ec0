"""Rounds that nobody ran: the files of a job, made up from its seed, for tests of everything around."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from cell.config import from_dict, load
from cell.run.result import RoundResult
from cell.trials.durations import durations
from cell.trials.log import Log
from cell.trials.metrics import figures
from cell.trials.one_round import EVENTS, RESULT, TICKS, Job
from cell.trials.settings import Settings, cell_data, contenders, people
from cell.trials.workers import Done
from cell.wire.types import ShownGesture
from cell.wire.vocabulary import Action, Mode

CELL = cell_data(load())


def settings(**changes: Any) -> Settings:
    """A small campaign's settings."""
    given: dict[str, Any] = {"who": "5", "rounds": 6, "policies": "tb,dec", "onions": 15, "seed": 1} | changes
    return Settings(
        people(given["who"]), given["rounds"], contenders(given["policies"], "full"), given["onions"],
        given["seed"], "sim", "full", given.get("config", CELL),
    )  # fmt: skip


def made_files(job: Job, **changes: Any) -> dict[str, bytes]:
    """The files of one round; dec takes 150 s or so, tb a quarter less."""
    rng = np.random.default_rng(job.spec.seed)
    seconds = rng.normal(150.0, 6.0) * (0.75 if job.contender.name == "tb" else 1.0)
    log = _log(float(seconds), fast=job.contender.name == "tb")
    result = RoundResult(
        backend="sim", policy=job.contender.policy, seed=job.spec.seed, person=job.spec.persona,
        onions=job.onions, sorted=job.onions, by_robot=job.onions - 5, by_human=5, misplaced=0, dropped=0,
        sort_time_s=round(float(seconds), 3), mode_switches=2, industrial_s=30.0, min_separation_m=0.1,
        max_tcp_speed_m_s={"collaborative": 0.24, "industrial": 0.95}, gesture_delay_s=1.2,
        real_time_factor=float(rng.uniform(1, 9)), commit="made", version="0",
    )  # fmt: skip
    record = {
        **asdict(job.spec), "contender": job.contender.name, "belief": "gru", "perception": job.perception,
        "result": asdict(result) | changes, "figures": figures(log, from_dict({**job.config, "port": 7447})),
        "durations": durations(log),
        "machine": {"wall_s": 50.0, "cpu_s": 60.0, "cpu_node_s": 30.0, "memory_mb": 700.0,
                    "real_time_factor": 3.0, "host": "here"},
    }  # fmt: skip
    return {EVENTS: b"", TICKS: log.to_bytes(), RESULT: json.dumps(record).encode()}


class Made:
    """`Workers` that make rounds up; stops after `most`, in reverse order if told so."""

    def __init__(self, most: int = 10_000, backwards: bool = False, **changes: Any) -> None:
        self._most, self._backwards, self._changes = most, backwards, changes
        self.asked: list[str] = []

    def run(self, jobs: Sequence[Job]) -> Iterator[Done]:
        for job in (jobs[::-1] if self._backwards else jobs)[: self._most]:
            self.asked.append(job.spec.id)
            yield job, made_files(job, **self._changes)
        if len(jobs) > self._most:
            raise KeyboardInterrupt


def _log(seconds: float, fast: bool) -> Log:
    """Robot and person work in cycles; the person rests once, and a fast robot is fast then."""
    t = 0.04 * np.arange(round(seconds / 0.04))
    robot_cycle = np.repeat([1, 3, 4, 6, 1, 3, 6], [12, 75, 110, 60, 12, 75, 60])
    human_cycle = np.repeat([1, 3, 4, 6, 1, 3, 4, 5], [20, 30, 50, 30, 20, 30, 50, 30])
    columns: dict[str, Any] = {"t": t, "robot": np.resize(robot_cycle, len(t)).astype(float)}
    human = np.resize(human_cycle, len(t)).astype(float)
    away = (t > 40.0) & (t < 62.0)
    human[(t > 36.0) & (t < 66.0)] = Action.NO_OP
    human[(t > 37.0) & (t < 39.0)] = Action.SLOW_DOWN
    human[(t > 63.0) & (t < 65.0)] = Action.SPEED_UP
    quick = away & fast & (t > 41.0)
    columns |= {
        "human": human, "fatigued": ((t > 36.0) & (t < 60.0)).astype(float),
        "sign": np.where((t > 37.0) & (t < 39.0), 2.0, np.where((t > 63.0) & (t < 65.0), 1.0, 0.0)),
        "true_separation": np.where(away, 1.6, 0.4), "separation": np.where(away, 1.6, 0.4),
        "mode": np.where(quick, float(Mode.INDUSTRIAL), float(Mode.COLLABORATIVE)),
        "requested": (t > 38.0) & (t < 64.0) & fast, "own_type": (t > 38.0) & (t < 64.0) & fast,
        "permitted": away, "cap": np.where(quick, 0.95, 0.25), "speed": np.where(quick, 0.8, 0.2),
        "belief": ((t > 38.0) & (t < 64.0)).astype(float), "human_seen": human, "sorted": np.floor(t / 12.0),
        "robot_moving": np.ones(len(t)),
    }  # fmt: skip
    columns["sign_seen"] = columns["sign"]
    shown = (ShownGesture("down", 37.0, 38.5), ShownGesture("up", 63.0, 64.2))
    return Log({k: np.asarray(v, float) for k, v in columns.items()}, shown)
