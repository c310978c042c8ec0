"""The other reports: Fig. 4, Theorem 1, recovery times, prices, gestures that are missed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cell.errors import ConfigError
from cell.learn import runs, theory
from cell.learn.belief import store
from cell.learn.belief.auc import auc, beliefs, roc
from cell.learn.belief.bank import BeliefBank
from cell.learn.belief.bank import bank as bank_of
from cell.learn.belief.eq3 import fit_kernel
from cell.learn.belief.ladder import ladder
from cell.learn.belief.tracker import BeliefTracker, last_gesture
from cell.learn.demonstrations import LABELS, expert, play, type_data
from cell.learn.domain.exact import BestResponse, SemiMarkovFilter, solvable
from cell.learn.domain.presets import Preset
from cell.learn.domain.vector import make
from cell.learn.job import Job, Tick
from cell.learn.metrics import Statistic, statistic, summary
from cell.learn.table1 import learned
from cell.learn.yardsticks import RECOVERIES, TEST_SEED, Row, dp_row, pooled_rows, row_of, transfer_rows

MISSED = (0.0, 0.1, 0.2, 0.3, 0.4)
"""Shares of thumbs that the camera takes for No-op."""
PRICES = (0.0, 0.25, 0.5, 1.0)
"""Of a step in industrial mode beside a person at work."""


def fig4(rules: Preset, _: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """The belief ladder: AUC on 100 held-out expert episodes, per label and tracker.

    "reward_priced" is what the expert's rule earns when it goes by that belief instead of the truth.
    """
    rows: list[Row] = []
    for label in LABELS:
        known = store.shipped(rules.name, label).is_file()
        mixed = store.gru_bank(rules.agents, store.load(rules.name, label)) if known else None
        trackers = ladder(rules, label, mixed)
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
                    "reward_priced": _earned(rules, tracker, job.episodes),
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
                "reward_priced": statistic(knowing(rules, label, job.episodes)),
                "curve": ([0.0, 0.0, 1.0], [0.0, 1.0, 1.0]),
            }
        )
        tick(label)
    return rows


def _earned(rules: Preset, tracker: BeliefTracker, episodes: int) -> Statistic:
    """Priced reward of the expert's rule under a belief."""
    bank = bank_of(rules.agents, [tracker])
    return summary(play(rules, bank, expert(rules), episodes, TEST_SEED))["reward_priced"]


def knowing(rules: Preset, label: str, episodes: int) -> NDArray[np.float64]:
    """Priced reward per episode (E,) of the expert's rule that is told the human's type."""
    domain, act = make(rules, episodes, TEST_SEED), expert(rules)
    local, reward = domain.reset(), np.zeros(episodes)
    belief = np.zeros((episodes, domain.n_agents, domain.n_agents - 1), np.float32)
    for _ in range(domain.horizon):
        step = domain.step(act(local, belief))
        local = step.local
        reward += step.reward_priced
        belief[:, 0, 0] = getattr(step, f"type_{label}")[:, 1]
    return reward


def theorem1(rules: Preset, bank: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """Theorem 1's terms for TB-DecAIRL and Dec-AIRL, one row per method and seed."""
    rows: list[Row] = []
    demos = runs.demonstrations(rules, bank)
    held_out = play(rules, bank, expert(rules), 200, TEST_SEED)
    contraction = {}
    for label in LABELS:
        data = type_data(rules, label, 400, TEST_SEED)
        contraction[label] = theory.contraction(fit_kernel(data.observed, data.types))
    for method in runs.METHODS:
        for seed in range(1, job.seeds + 1):
            run = runs.start(method, rules, bank, demos, job.settings.change(seed=seed))
            runs.train(run)
            own = runs.rollout_of(rules, bank, run.ppo.actors, "sampled", 200, TEST_SEED)
            terms = theory.measure(run.discriminator, run.ppo.actors, held_out, own)
            rows.append(
                {"preset": rules.name, "recovery": rules.recovery, "method": method, "seed": seed}
                | terms.as_dict()
                | {"kernel_contraction": contraction}
            )
            tick(f"{method} seed {seed}: eps {terms.eps_mean:.3f}, gap {terms.policy_gap:.2f}")
    return rows


def recovery(rules: Preset, bank: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """One policy per method, trained at the preset's recovery time, evaluated over all of them."""
    rows: list[Row] = []
    trained = {m: learned(m, rules, bank, job.settings) for m in ("tb-decairl", "dec-airl", "bc")}
    for method, actors in trained.items():
        for time in RECOVERIES:
            there = replace(rules, recovery=time)
            reference = summary(play(there, bank, expert(there), job.episodes, TEST_SEED))
            result = runs.evaluate(there, bank, actors, "greedy", job.episodes, TEST_SEED)
            base: Row = {"preset": rules.name, "trained_at": rules.recovery, "recovery": time}
            rows.append(row_of(base, method, "greedy", 1, [result], reference["reward_priced"]["mean"]))
        tick(method)
    if solvable(rules) and not rules.published:
        rows += _hidden_beliefs(rules, job.episodes)
        rows += transfer_rows(rules, job.settings, job.episodes)
    return rows


def _hidden_beliefs(rules: Preset, episodes: int) -> list[Row]:
    """The expert's rule by the belief of the hidden type: the GRU, which is not told how long rests last,
    and the exact filter, which is."""
    rows: list[Row] = []
    mixed = store.gru_bank(rules.agents, store.load(rules.name, "hidden"))
    for time in RECOVERIES:
        there = replace(rules, recovery=time)
        banks = {"GRU": mixed, "filter": bank_of(rules.agents, [SemiMarkovFilter(there, "hidden")])}
        found = {k: summary(play(there, b, expert(there), episodes, TEST_SEED)) for k, b in banks.items()}
        reference = _earned(there, last_gesture(), episodes)["mean"]
        base: Row = {"preset": rules.name, "trained_at": rules.recovery, "recovery": time}
        for name, result in found.items():
            row = row_of(base, f"expert's rule, {name} of the hidden type", "greedy", 1, [result], reference)
            row["ratio_to_filter"] = (
                result["reward_priced"]["mean"] / found["filter"]["reward_priced"]["mean"]
            )
            rows.append(row)
    return rows


def transfer(rules: Preset, _: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """Reward transfer from demonstrations at several recovery times.

    Raises:
        ConfigError: a preset without an exact optimum, or whose robot has nothing to choose.
    """
    if not solvable(rules) or rules.published:
        raise ConfigError(
            f"report transfer is for one robot that chooses its mode, in steps; not {rules.name}"
        )
    return pooled_rows(rules, job.settings, job.episodes, tick)


def prices(rules: Preset, bank: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """What adapting is worth over recovery times and prices, learners trained at the preset's own.

    Neither what happens nor what is demonstrated depends on the price, so a policy plays once at each
    recovery time and is charged afterwards. Only the exact optimum depends on it.
    """
    trained = {m: learned(m, rules, bank, job.settings) for m in runs.METHODS}
    rows: list[Row] = []
    for time in RECOVERIES:
        there = replace(rules, recovery=time)
        played = {"expert": play(there, bank, expert(there), job.episodes, TEST_SEED)}
        for method, actors in trained.items():
            played[method] = runs.rollout_of(there, bank, actors, "greedy", job.episodes, TEST_SEED)
        for price in PRICES:
            base: Row = {"preset": rules.name, "trained_at": rules.recovery, "recovery": time, "price": price}
            charged = {k: r.returns("truth") - price * r.priced_steps for k, r in played.items()}
            for name, reward in charged.items():
                result = summary(played[name]) | {"reward_priced": statistic(reward)}
                rows.append(row_of(base, name, "greedy", 1, [result], float(charged["expert"].mean())))
            if solvable(there):
                best = BestResponse(replace(there, price=price)).value
                rows.append(dp_row(base, best, float(charged["expert"].mean())))
        tick(f"recovery {time}")
    return rows


def robustness(rules: Preset, bank: BeliefBank, job: Job, tick: Tick) -> list[Row]:
    """Reward when the camera misses thumbs: policies trained without, beliefs as they are."""
    trained = {m: learned(m, rules, bank, job.settings) for m in ("tb-decairl", "dec-airl")}
    rows: list[Row] = []
    for missed in MISSED:
        there = replace(rules, missed_gestures=missed)
        told = bank_of(rules.agents, [last_gesture()])
        base: Row = {"preset": rules.name, "recovery": rules.recovery, "missed_gestures": missed}
        found = {"expert, last gesture": summary(play(there, told, expert(there), job.episodes, TEST_SEED))}
        found["expert, GRU"] = summary(play(there, bank, expert(there), job.episodes, TEST_SEED))
        for method, actors in trained.items():
            found[method] = runs.evaluate(there, bank, actors, "greedy", job.episodes, TEST_SEED)
        if not rules.published:
            sharp = bank_of(rules.agents, [SemiMarkovFilter(there)])
            found["tb-decairl, exact filter"] = runs.evaluate(
                there, sharp, trained["tb-decairl"], "greedy", job.episodes, TEST_SEED
            )
        reference = found["expert, last gesture"]["reward_priced"]["mean"]
        rows += [row_of(base, name, "greedy", 1, [result], reference) for name, result in found.items()]
        tick(f"{missed:.0%} missed")
    return rows
