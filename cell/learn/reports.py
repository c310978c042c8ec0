"""The tables and figures: Table 1, Fig. 4, Theorem 1, and the sweep over recovery times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from cell.learn import plots, runs, theory
from cell.learn.belief import store
from cell.learn.belief.auc import auc, beliefs, roc
from cell.learn.belief.bank import BeliefBank
from cell.learn.belief.ladder import ladder
from cell.learn.demonstrations import LABELS, expert, play, type_data
from cell.learn.domain.exact import BestResponse
from cell.learn.domain.experts import without_forcing
from cell.learn.domain.presets import Preset
from cell.learn.domain.vector import make
from cell.learn.metrics import Statistic, summary
from cell.learn.networks import Actors
from cell.learn.optimise import optimise, true_reward
from cell.learn.ppo import DecPpo
from cell.learn.settings import Settings
from cell.learn.transfer import refine
from cell.learn.yardsticks import KEYS, TEST_SEED, Row, qmdp, row_of, transfer_rows

Tick = Callable[[str], None]
RULES = {"expert": "expert", "never-speed-up": "never-speed-up", "always-industrial": "always-industrial"}
LEARNERS = ("tb-decairl", "dec-airl", "bc", "bc-no-belief")
REFINED = "tb-refined"


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


def steps(what: str, presets: tuple[tuple[str, int], ...], job: Job) -> int:
    """Ticks a report makes, for its progress bar."""
    per = {
        "table1": job.seeds * (len(LEARNERS) + 1),
        "fig4": len(LABELS),
        "theorem1": 2 * job.seeds,
        "recovery": 3,
    }
    return per[what] * len(presets)


def learned(method: str, rules: Preset, bank: BeliefBank, settings: Settings) -> Actors:
    """Actors of one method, trained from nothing."""
    demos = runs.demonstrations(rules, bank)
    if method == "bc" or method == "bc-no-belief":
        return runs.cloned(rules, demos, settings.change(beliefs=method == "bc"))
    run = runs.start(method, rules, bank, demos, settings)
    runs.train(run)
    return run.ppo.actors


def table1(rules: Preset, bank: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """Rows of Table 1 for one preset; learners' statistics are over seeds' means."""
    rows: list[Row] = []
    base: Row = {"preset": rules.name, "recovery": rules.recovery}
    reference = 1.0
    for method, kind in RULES.items():
        played = without_forcing(rules, kind)
        result = summary(play(played, bank, expert(played, kind), job.episodes, TEST_SEED))
        if method == "expert":
            reference = result["reward_priced"]["mean"]
        rows.append(row_of(base, method, "greedy", 0, [result], reference))
    if not rules.published:
        bound = BestResponse(rules).value
        exact: Row = {
            **base,
            "method": "dp",
            "decoding": "greedy",
            "seeds": 0,
            "ratio_to_expert": bound / reference,
        }
        exact |= {key: None for key in KEYS} | {"reward_priced": {"mean": bound, "sd": 0.0, "ci95": 0.0}}
        rows += [row_of(base, "qmdp", "greedy", 0, [qmdp(rules, job.episodes)], reference), exact]
    methods = learners(rules)
    work = [(m, seed) for m in methods for seed in range(1, job.seeds + 1)]
    per: dict[tuple[str, str], list[dict[str, Statistic]]] = {}
    train = partial(_scores, rules, job)
    for (method, seed), scores in zip(work, job.map(train, work), strict=True):
        for decoding, result in scores.items():
            per.setdefault((method, decoding), []).append(result)
        ratio = scores["greedy"]["reward_priced"]["mean"] / reference
        tick(f"{method} seed {seed}: {ratio:.3f} of the expert")
    for (method, decoding), results in per.items():
        rows.append(row_of(base, method, decoding, job.seeds, results, reference))
    return rows


def learners(rules: Preset) -> tuple[str, ...]:
    """Methods of Table 1 that are trained; refining needs a robot that may choose."""
    return LEARNERS if rules.published else (*LEARNERS, REFINED)


def _scores(rules: Preset, job: Job, what: tuple[str, int]) -> dict[str, dict[str, Statistic]]:
    """Train one method with one seed and evaluate it both ways; runs in any process."""
    runs.single_thread()
    method, seed = what
    settings = job.settings.change(seed=seed)
    bank = store.gru_bank(rules.agents, store.load(rules.name, job.label))
    if method == REFINED:
        bank, actors = refined(rules, bank, settings)
    else:
        actors = learned(method, rules, bank, settings)
    return {d: runs.evaluate(rules, bank, actors, d, job.episodes, TEST_SEED) for d in runs.DECODINGS}


def refined(rules: Preset, bank: BeliefBank, settings: Settings) -> tuple[BeliefBank, Actors]:
    """TB-DecAIRL's robot, optimised further for the true reward on (s, b).

    Its belief is that of the hidden type, which is known before the person announces it.
    """
    actors = learned("tb-decairl", rules, bank, settings)
    sharp = store.gru_bank(rules.agents, store.load(rules.name, "hidden"))
    hyper = refine(seed=settings.seed)
    domain = make(rules, 1, 0)
    ppo = DecPpo(domain.features, domain.mask, hyper)
    ppo.actors.load_state_dict(actors.state_dict())
    for _ in optimise(rules, sharp, true_reward(), hyper, ppo, rules.robots):
        pass
    return sharp, ppo.actors


def fig4(rules: Preset, bank: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """The belief ladder: AUC on 100 held-out expert episodes, per label and tracker."""
    rows: list[Row] = []
    for label in LABELS:
        trackers = ladder(rules, label, bank if label == job.label else None)
        test = type_data(rules, label, 100, 2_000_003)
        for name, tracker in trackers.items():
            score = beliefs(tracker, test)
            fpr, tpr = roc(score, test.types[1:])
            rows.append(
                {
                    "preset": rules.name,
                    "recovery": rules.recovery,
                    "label": label,
                    "belief": name,
                    "auc": auc(score, test.types[1:]),
                    "curve": (fpr.tolist(), tpr.tolist()),
                }
            )
        rows.append(
            {
                "preset": rules.name,
                "recovery": rules.recovery,
                "label": label,
                "belief": "oracle",
                "auc": 1.0,
                "curve": ([0.0, 0.0, 1.0], [0.0, 1.0, 1.0]),
            }
        )
        tick(label)
    return rows


def theorem1(rules: Preset, bank: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """Theorem 1's terms for TB-DecAIRL and Dec-AIRL, one row per method and seed."""
    rows: list[Row] = []
    demos = runs.demonstrations(rules, bank)
    held_out = play(rules, bank, expert(rules), 200, TEST_SEED)
    for method in runs.METHODS:
        for seed in range(1, job.seeds + 1):
            run = runs.start(method, rules, bank, demos, job.settings.change(seed=seed))
            runs.train(run)
            own = runs.rollout_of(rules, bank, run.ppo.actors, "sampled", 200, TEST_SEED)
            terms = theory.measure(run.discriminator, run.ppo.actors, held_out, own)
            rows.append(
                {"preset": rules.name, "recovery": rules.recovery, "method": method, "seed": seed}
                | terms.as_dict()
            )
            tick(f"{method} seed {seed}: eps {terms.eps_mean:.3f}, gap {terms.policy_gap:.2f}")
    return rows


def recovery(rules: Preset, bank: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """One policy per method, trained at the preset's recovery time, evaluated over all of them."""
    rows: list[Row] = []
    trained = {m: learned(m, rules, bank, job.settings) for m in ("tb-decairl", "dec-airl", "bc")}
    for method, actors in trained.items():
        for time in (5, 10, 20, 30, 40):
            there = replace(rules, recovery=time)
            reference = summary(play(there, bank, expert(there), job.episodes, TEST_SEED))
            result = runs.evaluate(there, bank, actors, "greedy", job.episodes, TEST_SEED)
            base: Row = {"preset": rules.name, "trained_at": rules.recovery, "recovery": time}
            rows.append(row_of(base, method, "greedy", 1, [result], reference["reward_priced"]["mean"]))
        tick(method)
    if rules.agents == ("robot", "human") and not rules.published:
        rows += transfer_rows(rules, job.settings, job.episodes)
    return rows


REPORTS: dict[str, Callable[[Preset, BeliefBank, Job, Tick], list[Row]]] = {
    "table1": table1,
    "fig4": fig4,
    "theorem1": theorem1,
    "recovery": recovery,
}
"""By the name of the command."""


def draw(what: str, rows: list[Row], path: Path) -> None:
    """The PNG of a report, for the last preset in it."""
    last = [r for r in rows if (r["preset"], r["recovery"]) == (rows[-1]["preset"], rows[-1]["recovery"])]
    title = f"{rows[-1]['preset']}, recovery {rows[-1]['recovery']}"
    if what == "table1":
        values = {
            f"{r['method']} ({r['decoding']})": (r["reward_priced"]["mean"], r["reward_priced"]["ci95"])
            for r in last
        }
        plots.bars(path, values, "reward per episode (priced)", title)
    elif what == "fig4":
        shown = [r for r in last if r["label"] == "hidden"]
        plots.rocs(path, {r["belief"]: (*r["curve"], r["auc"]) for r in shown}, f"{title}, hidden type")
    elif what == "theorem1":
        bounds = {f"{r['method']} {r['seed']}": (r["policy_gap"], 0.0) for r in last}
        plots.bars(path, bounds, "log-likelihood gap (discounted)", title)
    else:
        series: dict[str, list[tuple[float, float]]] = {}
        for r in rows:
            series.setdefault(r["method"], []).append((float(r["recovery"]), r["ratio_to_expert"]))
        plots.lines(
            path, series, "recovery time [steps]", "reward / expert's", f"trained at {rows[0]['trained_at']}"
        )
