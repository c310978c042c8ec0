"""Whole runs: train by method, evaluate, and measure when a run got how far."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch

from cell.clock import perf_s
from cell.errors import ConfigError, one_of
from cell.learn import checkpoint
from cell.learn.belief.bank import BeliefBank
from cell.learn.cloning import clone
from cell.learn.dec_airl import dec_airl
from cell.learn.demonstrations import demonstrate, play
from cell.learn.discriminator import Transitions
from cell.learn.domain.presets import Preset
from cell.learn.domain.vector import make
from cell.learn.metrics import Statistic, summary
from cell.learn.networks import Actors, generator
from cell.learn.rollout import Rollout, greedy, sampling
from cell.learn.settings import Settings
from cell.learn.tb_decairl import Progress, TbDecAirl

METHODS = ("tb-decairl", "dec-airl")
DECODINGS = ("greedy", "sampled")


@dataclass
class Curve:
    """What happened during training, one entry per iteration, plus evaluations (see `train`)."""

    progress: list[Progress] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    evaluations: list[dict[str, float]] = field(default_factory=list)

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            "progress": [asdict(p) for p in self.progress],
            "seconds": self.seconds,
            "evaluations": self.evaluations,
        }

    @staticmethod
    def load(path: Path, iterations: int) -> Curve:
        """What `as_dict` gave, up to an iteration: the part that came before a checkpoint.

        Raises:
            ConfigError: the file is no learning curve.
        """
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            progress = [Progress(**p) for p in data["progress"]][:iterations]
            seconds = [float(s) for s in data["seconds"]][:iterations]
            last = progress[-1].env_steps if progress else 0
            shown = [dict(e) for e in data["evaluations"] if e["env_steps"] <= last]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ConfigError(f"cannot read learning curve {path}: {error}") from None
        return Curve(progress, seconds, shown)


def single_thread() -> None:
    """One thread, so that sums are always added in the same order: same seed, same bits."""
    torch.set_num_threads(1)


def rollout_of(
    preset: Preset, beliefs: BeliefBank, actors: Actors, decoding: str, episodes: int, seed: int
) -> Rollout:
    """Episodes of trained actors."""
    if decoding not in DECODINGS:
        raise ConfigError(f"decoding: {one_of(decoding, DECODINGS)}")
    act = greedy(actors)
    if decoding == "sampled":
        act = sampling(actors, make(preset, 1, 0).horizon, episodes, generator(seed, 21))
    return play(preset, beliefs, act, episodes, seed)


def evaluate(
    preset: Preset, beliefs: BeliefBank, actors: Actors, decoding: str, episodes: int, seed: int
) -> dict[str, Statistic]:
    """Statistics of `episodes` episodes of trained actors."""
    return summary(rollout_of(preset, beliefs, actors, decoding, episodes, seed))


def start(
    method: str, preset: Preset, beliefs: BeliefBank, expert: Transitions, settings: Settings
) -> TbDecAirl:
    """A fresh run of a method."""
    if method not in METHODS:
        raise ConfigError(f"method: {one_of(method, METHODS)}")
    single_thread()
    made = dec_airl if method == "dec-airl" else TbDecAirl
    return made(preset, beliefs, expert, settings)


def train(
    run: TbDecAirl,
    save_to: Path | None = None,
    save_every: int = 10,
    evaluate_every: int = 0,
    episodes: int = 200,
    report: Callable[[Progress], None] | None = None,
) -> Curve:
    """Run Algorithm 1 to the end.

    Args:
        save_to: checkpoint file; an existing one is continued, and with it the curve in the JSON file of
            the same name. evaluate_every: iterations between
            evaluations of `episodes` episodes, greedy and sampled (0: none; their time is not counted).
        report: told of every iteration.
    """
    curve = Curve()
    if save_to is not None and save_to.is_file():
        checkpoint.restore(run, save_to)
        if save_to.with_suffix(".json").is_file():
            curve = Curve.load(save_to.with_suffix(".json"), run.iteration)
    spent, since = (curve.seconds or [0.0])[-1], perf_s()
    for progress in run.iterate():
        spent += perf_s() - since
        curve.progress.append(progress)
        curve.seconds.append(spent)
        last = progress.iteration == run.settings.iterations
        if evaluate_every and (progress.iteration % evaluate_every == 0 or last):
            row: dict[str, float] = {"env_steps": progress.env_steps, "seconds": spent}
            for decoding in DECODINGS:
                result = evaluate(run.preset, run.beliefs, run.ppo.actors, decoding, episodes, 1_000_003)
                row |= {f"{decoding}_{key}": result[key]["mean"] for key in ("reward_priced", "reward_truth")}
            curve.evaluations.append(row)
        if save_to is not None and (progress.iteration % save_every == 0 or last):
            save_to.with_suffix(".json").write_text(json.dumps(curve.as_dict()), encoding="utf-8")
            checkpoint.save(run, save_to)  # last: a curve that is ahead of its checkpoint is cut
        if report is not None:
            report(progress)
        since = perf_s()
    return curve


def cloned(preset: Preset, expert: Transitions, settings: Settings, updates: int = 1000) -> Actors:
    """Behaviour cloning with the settings' seed, sizes and belief switch."""
    single_thread()
    domain = make(preset, 1, 0)
    return clone(domain.features, domain.mask, expert, settings, updates)


def demonstrations(preset: Preset, beliefs: BeliefBank, episodes: int = 200, seed: int = 77) -> Transitions:
    """The standard demonstrations: same expert episodes for every seed and method."""
    return demonstrate(preset, beliefs, episodes, seed)
