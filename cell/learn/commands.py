"""What `cell train`, `cell evaluate` and `cell report` do; each writes files and prints a few lines."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from cell.clock import perf_s
from cell.errors import ConfigError, one_of
from cell.learn import plots, reports, runs
from cell.learn.belief import store
from cell.learn.belief.auc import auc, beliefs
from cell.learn.belief.bank import BeliefBank
from cell.learn.belief.bank import bank as bank_of
from cell.learn.belief.gru import GruBelief, GruNet, save_gru
from cell.learn.belief.pretrain import MIXED, mixed_data, pretrain
from cell.learn.belief.tracker import BeliefTracker, last_gesture
from cell.learn.demonstrations import LABELS, expert, play
from cell.learn.domain.exact import SemiMarkovFilter, solvable
from cell.learn.domain.experts import without_forcing
from cell.learn.domain.presets import Preset, preset
from cell.learn.domain.vector import make
from cell.learn.export import BELIEF_EDGES, acting, expert_table, from_csv, tabulate, to_csv
from cell.learn.job import Job
from cell.learn.metrics import summary
from cell.learn.settings import PRESETS, Settings

EXPERTS = {
    "expert": "expert",
    "expert-never-speed-up": "never-speed-up",
    "expert-always-industrial": "always-industrial",
}
"""Policies of `cell evaluate` that need no file, and the rules behind them."""
REPORTS = tuple(reports.REPORTS)


@contextmanager
def _bar(console: Console | None, what: str, total: int) -> Iterator[Callable[[str], None]]:
    """A progress bar; the callable moves it by one and shows a note."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console or Console(stderr=True), transient=False) as progress:
        task = progress.add_task(what, total=total, note="")
        yield lambda note: progress.update(task, advance=1, note=note)


def settings(name: str, seed: int, iterations: int | None = None) -> Settings:
    """Named hyperparameters with a seed."""
    if name not in PRESETS:
        raise ConfigError(f"--settings: {one_of(name, PRESETS)}")
    chosen = PRESETS[name](seed=seed)
    return chosen if iterations is None else chosen.change(iterations=iterations)


def domain(name: str, recovery: int | None = None, start: str | None = None) -> Preset:
    """A preset with the options of the command line applied."""
    changes: dict[str, Any] = {}
    if recovery is not None:
        changes["recovery"] = recovery
    if start is not None:
        changes["start"] = start
    return preset(name, **changes)


def write_json(path: Path, data: object) -> None:
    """Write a report; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def train_belief(
    preset_name: str, label: str, seed: int, out: Path, updates: int = 1800, console: Console | None = None
) -> Path:
    """`cell train belief`: a GRU on mixed recovery times; writes weights and their test AUC."""
    if label not in LABELS:
        raise ConfigError(f"--label: {one_of(label, LABELS)}")
    runs.single_thread()
    rules = domain(preset_name)
    with _bar(console, f"belief, {preset_name}, {label}", updates) as tick:
        net = pretrain(rules, label, seed=seed, updates=updates, progress=lambda _, loss: tick(f"{loss:.4f}"))
    out.mkdir(parents=True, exist_ok=True)
    target = out / f"{preset_name}-{label}.safetensors"
    about = {"preset": preset_name, "label": label, "seed": str(seed), "updates": str(updates)}
    about["recovery"] = f"{MIXED[0]}..{MIXED[-1]}"
    save_gru(net, target, about)
    write_json(target.with_suffix(".json"), {**about, **tested(rules, label, net, seed + 1_000_000)})
    return target


def tested(rules: Preset, label: str, net: GruNet, seed: int) -> dict[str, dict[str, float]]:
    """AUC over 100 expert episodes at each of several recovery times; beside it, where there is one, that
    of the exact filter, which is told the recovery time."""
    scores: dict[str, dict[str, float]] = {"auc_by_recovery": {}}
    if solvable(rules):
        scores["filter_auc_by_recovery"] = {}
    for recovery in (6, 10, 20, 30, 40):
        test = mixed_data(rules, label, (recovery,), 100, seed)
        trackers: list[BeliefTracker] = [GruBelief(net)]
        if solvable(rules):
            trackers.append(SemiMarkovFilter(replace(rules, recovery=recovery), label))
        for into, tracker in zip(scores.values(), trackers, strict=True):
            into[str(recovery)] = auc(beliefs(tracker, test), test.types[1:])
    return scores


def bank_for(rules: Preset, label: str, weights: Path | None = None) -> BeliefBank:
    """The belief bank of a preset: GRU for people, announcements for robots."""
    return store.gru_bank(rules.agents, store.load(rules.name, label, weights))


def train(
    method: str,
    preset_name: str,
    seed: int,
    out: Path,
    settings_name: str = "tuned",
    iterations: int | None = None,
    recovery: int | None = None,
    label: str = "announced",
    weights: Path | None = None,
    expert_episodes: int = 200,
    commit: str = "unknown",
    console: Console | None = None,
) -> dict[str, object]:
    """`cell train tb-decairl|dec-airl`: resumable; writes checkpoint, CSVs, curve (JSON, PNG), result."""
    rules, hyper = domain(preset_name, recovery), settings(settings_name, seed, iterations)
    bank = bank_for(rules, label, weights)
    demos = runs.demonstrations(rules, bank, expert_episodes)
    run = runs.start(method, rules, bank, demos, hyper)
    out.mkdir(parents=True, exist_ok=True)
    with _bar(console, f"{method}, {preset_name}, seed {seed}", hyper.iterations) as tick:
        curve = runs.train(
            run,
            out / "checkpoint.safetensors",
            evaluate_every=max(1, hyper.iterations // 10),
            report=lambda p: tick(f"reward {p.reward_priced:6.2f}  D {p.accuracy:.2f}"),
        )
    actors = run.ppo.actors
    visits = [runs.rollout_of(rules, bank, actors, d, 500, seed + 500) for d in runs.DECODINGS]
    for agent, name in enumerate(rules.agents if len(rules.agents) == 2 else ()):
        table = tabulate(rules, actors, agent, visits, BELIEF_EDGES)
        about = f"policy={method}-{name} preset={preset_name} seed={seed} commit={commit}"
        (out / f"{name}.csv").write_text(to_csv(table, about), encoding="utf-8")
    reference = summary(play(rules, bank, expert(rules), 1000, 4321))
    result: dict[str, object] = {"preset": preset_name, "method": method, "seed": seed, "expert": reference}
    for decoding in runs.DECODINGS:
        result[decoding] = runs.evaluate(rules, bank, actors, decoding, 1000, 4321)
    write_json(out / "result.json", result)
    if curve.progress:
        write_json(out / "curve.json", curve.as_dict())
        title = f"{method}, {preset_name}, seed {seed}"
        plots.curve(out / "curve.png", curve.as_dict(), title, reference["reward_priced"]["mean"])
    return result


def report(
    what: str,
    json_file: Path,
    presets: tuple[tuple[str, int], ...] = (("released", 5), ("paper", 5), ("paper", 20)),
    seeds: int = 10,
    episodes: int = 1000,
    settings_name: str = "tuned",
    label: str = "announced",
    workers: int = 1,
    console: Console | None = None,
) -> list[dict[str, Any]]:
    """`cell report`: computes, writes JSON and a PNG of the same name, returns the rows."""
    if what not in REPORTS:
        raise ConfigError(f"report: {one_of(what, REPORTS)}")
    runs.single_thread()
    hyper = settings(settings_name, 1)
    job = Job(seeds, episodes, hyper, label, workers)
    rows: list[dict[str, Any]] = []
    picture = json_file.with_suffix(".png")
    json_file.parent.mkdir(parents=True, exist_ok=True)
    with _bar(console, what, reports.steps(what, presets, job)) as tick:
        for name, recovery in presets:
            rules = replace(domain(name), recovery=recovery)
            rows += reports.REPORTS[what](rules, bank_for(rules, label), job, tick)
    reports.draw(what, rows, picture)
    for row in rows:
        row.pop("curve", None)
    write_json(json_file, rows)
    return rows


def evaluate(
    preset_name: str,
    policy: str,
    episodes: int = 1000,
    seed: int = 1,
    start: str | None = None,
    decoding: str = "greedy",
    recovery: int | None = None,
    human: Path | None = None,
    label: str = "announced",
    json_file: Path | None = None,
) -> dict[str, object]:
    """`cell evaluate`: a robot policy beside the expert (or an exported) human.

    Args:
        policy: "expert", "expert-never-speed-up", "expert-always-industrial", or a CSV. human: CSV of
            the person's policy (default: the expert person). label: belief that a CSV is driven by;
            the experts go by what was last announced.
    """
    if decoding not in runs.DECODINGS:
        raise ConfigError(f"--decoding: {one_of(decoding, runs.DECODINGS)}")
    rules = without_forcing(domain(preset_name, recovery, start), EXPERTS.get(policy, ""))
    if policy in EXPERTS and human is None:
        people = [last_gesture() for name in rules.agents if not name.startswith("robot")]
        bank, act = bank_of(rules.agents, people), expert(rules, EXPERTS[policy])
    else:
        if len(rules.agents) != 2:
            raise ConfigError(f"a policy CSV is for two agents; preset {preset_name} has {len(rules.agents)}")
        bank = bank_for(rules, label)
        size = len(make(rules, 1, 0).features)
        kinds = (EXPERTS.get(policy), "expert")
        paths = (None if policy in EXPERTS else Path(policy), human)
        tables = [
            expert_table(rules, agent, kind or "expert") if path is None else from_csv(path, size)
            for agent, (kind, path) in enumerate(zip(kinds, paths, strict=True))
        ]
        act = acting(tables, np.random.default_rng(seed) if decoding == "sampled" else None)
    since = perf_s()
    rollout = play(rules, bank, act, episodes, seed)
    seconds = perf_s() - since
    result: dict[str, object] = {
        "preset": preset_name,
        "policy": policy,
        "episodes": episodes,
        "decoding": decoding,
        "recovery": rules.recovery,
        **summary(rollout),
        "invalid_episodes": int(rollout.invalid.sum()),
        "steps_per_second": episodes * rules.horizon / seconds,
    }
    if json_file is not None:
        write_json(json_file, result)
    return result
