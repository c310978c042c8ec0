"""What learned policies and rewards are measured against: QMDP, the DP bound, reward transfer."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.learn import runs
from cell.learn.belief.bank import BeliefBank
from cell.learn.belief.bank import bank as bank_of
from cell.learn.belief.tracker import last_gesture
from cell.learn.demonstrations import expert, play
from cell.learn.discriminator import Reward
from cell.learn.domain.exact import BestResponse, QmdpRobot, SemiMarkovFilter
from cell.learn.domain.presets import Preset
from cell.learn.job import Tick
from cell.learn.metrics import Statistic, statistic, summary
from cell.learn.optimise import learned_reward, optimised
from cell.learn.rollout import greedy
from cell.learn.settings import Settings
from cell.learn.transfer import PooledAirl, Task, best_response, refine

Row = dict[str, Any]
KEYS = ("onions", "reward_truth", "reward_priced", "reward_shaped", "priced_steps")
TEST_SEED = 4321
"""Of all evaluation episodes in the tables: every method meets the same people and onions."""
RECOVERIES = (5, 10, 20, 30, 40)
"""Recovery times that the reports show [steps]."""
DEMONSTRATED, UNSEEN = (5, 20, 40), (3, 7, 10, 30, 50)
"""Recovery times of the reward learnt from several: inside and outside of what was demonstrated."""


def row_of(
    base: Row, method: str, decoding: str, seeds: int, results: list[dict[str, Statistic]], reference: float
) -> Row:
    """One row of a table: statistics of one evaluation, or of the means of several seeds."""
    row: Row = {**base, "method": method, "decoding": decoding, "seeds": seeds}
    for key in KEYS:
        means = [r[key]["mean"] for r in results]
        row[key] = results[0][key] if len(results) == 1 else statistic(means)
    ratios = [r["reward_priced"]["mean"] / reference for r in results]
    row["ratio_to_expert"] = float(np.mean(ratios))
    row["ratio_by_seed"] = ratios
    return row


def dp_row(base: Row, value: float, reference: float) -> Row:
    """The row of the exact optimum, which has an expected reward and nothing else."""
    row: Row = {**base, "method": "dp", "decoding": "greedy", "seeds": 0} | dict.fromkeys(KEYS)
    return row | {
        "reward_priced": {"mean": value, "sd": 0.0, "ci95": 0.0},
        "ratio_to_expert": value / reference,
    }


class _Watcher:
    """Shows a QMDP robot what its partner does, in the place of a belief tracker."""

    def __init__(self, robot: QmdpRobot) -> None:
        self._robot = robot

    def reset(self, n_envs: int) -> NDArray[np.float32]:
        self._robot.reset(n_envs)
        return np.zeros(n_envs, np.float32)

    def update(self, observed: NDArray[np.int8]) -> NDArray[np.float32]:
        self._robot.update(observed)
        return np.zeros(len(observed), np.float32)


def qmdp(rules: Preset, episodes: int) -> dict[str, Statistic]:
    """Statistics of QMDP on the exact filter beside the expert human."""
    robot, others = QmdpRobot(rules), expert(rules)

    def act(local: NDArray[np.int16], belief: NDArray[np.float32]) -> NDArray[np.int8]:
        chosen = others(local, belief)
        chosen[:, 0] = robot.act(local[:, 0])
        return chosen

    return summary(play(rules, bank_of(rules.agents, [_Watcher(robot)]), act, episodes, TEST_SEED))


def transfer_rows(rules: Preset, settings: Settings, episodes: int) -> list[Row]:
    """Rewards learnt at the preset's recovery time, frozen, and optimised afresh at all of them.

    "imitated": from the hand-coded expert with beliefs by what was announced.
    "best response": from robots optimised for the true reward, under the exact filter of the hidden type.
    """
    times, rows = RECOVERIES, list[Row]()
    filters = {
        t: bank_of(rules.agents, [SemiMarkovFilter(replace(rules, recovery=t), "hidden")]) for t in times
    }
    told = {t: bank_of(rules.agents, [last_gesture()]) for t in times}
    for name, banks in (("imitated", told), ("best response", filters)):
        home = banks.get(rules.recovery, banks[20])
        at = replace(rules, recovery=rules.recovery if rules.recovery in banks else 20)
        demos = runs.demonstrations(at, home)
        if name == "best response":
            robot = best_response(at, home, refine(seed=settings.seed))
            demos = play(at, home, greedy(robot.actors), 200, 77).transitions()
        run = runs.start("tb-decairl", at, home, demos, settings)
        runs.train(run)
        for time in times:
            base: Row = {"preset": rules.name, "trained_at": at.recovery, "recovery": time}
            there = replace(rules, recovery=time)
            rows.append(
                base | _afresh(there, banks[time], run.discriminator.f, f"reward, {name}", settings, episodes)
            )
    return rows


def pooled_rows(rules: Preset, settings: Settings, episodes: int, tick: Tick) -> list[Row]:
    """One reward from demonstrations at several recovery times, frozen, and optimised afresh at others.

    The demonstrators are robots optimised for the true reward at each of `DEMONSTRATED`.
    """
    times = sorted((*DEMONSTRATED, *UNSEEN))
    filters = {
        t: bank_of(rules.agents, [SemiMarkovFilter(replace(rules, recovery=t), "hidden")]) for t in times
    }
    tasks: list[Task] = []
    for time in DEMONSTRATED:
        at = replace(rules, recovery=time)
        robot = best_response(at, filters[time], refine(seed=settings.seed))
        shown = play(at, filters[time], greedy(robot.actors), 200, 77)
        tasks.append(Task(at, filters[time], shown.transitions()))
        tick(f"demonstrations at {time}")
    run = PooledAirl(tasks, settings)
    for _ in run.iterate():
        pass
    tick("one reward for all")
    rows: list[Row] = []
    for time in times:
        there = replace(rules, recovery=time)
        base: Row = {"preset": rules.name, "trained_at": list(DEMONSTRATED), "recovery": time}
        base["demonstrated"] = time in DEMONSTRATED
        row = _afresh(there, filters[time], run.discriminator.f, "reward, several times", settings, episodes)
        rows.append(base | row)
        tick(f"recovery {time}: {row['ratio_to_dp']:.3f} of the optimum")
    return rows


def _afresh(
    there: Preset, beliefs: BeliefBank, reward: Reward, name: str, settings: Settings, episodes: int
) -> Row:
    """What new networks reach at a recovery time on a frozen reward, against the expert and the optimum."""
    hyper = settings.change(seed=settings.seed + 1, entropy=0.02, iterations=40)
    ppo = optimised(there, beliefs, learned_reward(reward), hyper)
    result = runs.evaluate(there, beliefs, ppo.actors, "greedy", episodes, TEST_SEED)
    told = bank_of(there.agents, [last_gesture()])
    reference = summary(play(there, told, expert(there), episodes, TEST_SEED))["reward_priced"]["mean"]
    row = row_of({}, name, "greedy", 1, [result], reference)
    return row | {"ratio_to_dp": result["reward_priced"]["mean"] / BestResponse(there).value}
