"""Trains a policy on the calibrated task and writes it as `cell run` reads it."""

from __future__ import annotations

from pathlib import Path

from cell.learn import runs
from cell.learn.commands import bank_for, settings, write_json
from cell.learn.demonstrations import expert, play
from cell.learn.domain.presets import Preset
from cell.learn.export import tabulate, to_csv
from cell.learn.metrics import summary
from cell.version import commit

_TEST_SEED = 4321


def retrain(
    method: str, rules: Preset, seed: int, out: Path, iterations: int | None = None, episodes: int = 1000
) -> Path:
    """Train, resuming from a checkpoint in `out`; writes robot.csv, human.csv, result.json.

    Args:
        method: one of `runs.METHODS`. iterations: passes of Algorithm 1; None: the tuned number.
        episodes: of the evaluation; half as many look where the policy comes, a fifth are demonstrations.

    Returns:
        the robot's table.
    """
    out.mkdir(parents=True, exist_ok=True)
    bank = bank_for(rules, "announced")
    demos = runs.demonstrations(rules, bank, max(1, episodes // 5))
    run = runs.start(method, rules, bank, demos, settings("tuned", seed, iterations))
    runs.train(run, out / "checkpoint.safetensors")
    actors = run.ppo.actors
    visits = [
        runs.rollout_of(rules, bank, actors, d, max(1, episodes // 2), seed + 500) for d in runs.DECODINGS
    ]
    for agent, name in enumerate(rules.agents):
        about = f"policy={method}-{name} preset={rules.name} seed={seed} commit={commit()}"
        (out / f"{name}.csv").write_text(to_csv(tabulate(rules, actors, agent, visits), about))
    result = {"expert": summary(play(rules, bank, expert(rules), episodes, _TEST_SEED))}
    for decoding in runs.DECODINGS:
        result[decoding] = runs.evaluate(rules, bank, actors, decoding, episodes, _TEST_SEED)
    write_json(out / "result.json", {"method": method, "seed": seed, "recovery": rules.recovery, **result})
    return out / "robot.csv"
