"""Table 1: every method, several training seeds, against the expert and the exact bounds."""

from __future__ import annotations

from functools import partial

from cell.learn import runs
from cell.learn.belief import store
from cell.learn.belief.bank import BeliefBank
from cell.learn.demonstrations import expert, play
from cell.learn.domain.exact import BestResponse, solvable
from cell.learn.domain.experts import without_forcing
from cell.learn.domain.presets import Preset
from cell.learn.domain.vector import make
from cell.learn.job import Job, Tick
from cell.learn.metrics import Statistic, summary
from cell.learn.networks import Actors
from cell.learn.optimise import optimise, true_reward
from cell.learn.ppo import DecPpo
from cell.learn.settings import Settings
from cell.learn.transfer import refine
from cell.learn.yardsticks import TEST_SEED, Row, dp_row, qmdp, row_of

RULES = ("expert", "never-speed-up", "always-industrial")
"""Hand-coded rules of the robot."""
LEARNERS = ("tb-decairl", "dec-airl", "bc", "bc-no-belief")
REFINED = "tb-refined"


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
    for method in RULES:
        played = without_forcing(rules, method)
        result = summary(play(played, bank, expert(played, method), job.episodes, TEST_SEED))
        if method == "expert":
            reference = result["reward_priced"]["mean"]
        rows.append(row_of(base, method, "greedy", 0, [result], reference))
    if solvable(rules):
        rows.append(dp_row(base, BestResponse(rules).value, reference))
        rows.append(row_of(base, "qmdp", "greedy", 0, [qmdp(rules, job.episodes)], reference))
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
    hyper = refine(seed=settings.seed, iterations=min(40, settings.iterations))
    domain = make(rules, 1, 0)
    ppo = DecPpo(domain.features, domain.mask, hyper)
    ppo.actors.load_state_dict(actors.state_dict())
    for _ in optimise(rules, sharp, true_reward(), hyper, ppo, rules.robots):
        pass
    return sharp, ppo.actors
