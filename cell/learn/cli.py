"""`cell train`, `cell evaluate` and `cell report`. Imports of anything slow happen inside."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import ConfigError, one_of

train = typer.Typer(
    help="Train beliefs and policies.", no_args_is_help=True, rich_markup_mode=None, add_completion=False
)

Preset = Annotated[str, typer.Option("--preset", help="Task: released, paper or cell.")]
Seed = Annotated[int, typer.Option(help="Seed of everything random.")]
Out = Annotated[
    Path | None, typer.Option(help="Folder for what is written; an interrupted run there goes on.")
]
Label = Annotated[str, typer.Option(help="The person's type as: announced, own or hidden.")]
Settings = Annotated[str, typer.Option(help="Hyperparameters: tuned, fast or paper.")]
Recovery = Annotated[int | None, typer.Option(help="Steps (or seconds) of a rest.")]


@train.command("belief")
def train_belief(
    preset: Preset = "paper",
    label: Label = "announced",
    seed: Seed = 1,
    updates: Annotated[int, typer.Option(help="Gradient steps.")] = 1800,
    out: Out = None,
) -> None:
    """Train the GRU belief on the task's own types, over mixed recovery times."""
    _check(seed, updates=updates)
    from cell.learn import commands

    path = commands.train_belief(preset, label, seed, out or Path("runs") / "belief", updates)
    print(path)


@train.command("tb-decairl")
def train_tb_decairl(
    preset: Preset = "paper",
    seed: Seed = 1,
    settings: Settings = "tuned",
    iterations: Annotated[int | None, typer.Option(help="Passes of Algorithm 1.")] = None,
    recovery: Recovery = None,
    label: Label = "announced",
    belief: Annotated[Path | None, typer.Option(help="Weights of a belief of your own.")] = None,
    out: Out = None,
) -> None:
    """Learn policies and reward from expert trajectories, with beliefs over types."""
    _train("tb-decairl", preset, seed, settings, iterations, recovery, label, belief, out)


@train.command("dec-airl")
def train_dec_airl(
    preset: Preset = "paper",
    seed: Seed = 1,
    settings: Settings = "tuned",
    iterations: Annotated[int | None, typer.Option(help="Passes of Algorithm 1.")] = None,
    recovery: Recovery = None,
    out: Out = None,
) -> None:
    """The baseline: the same without types and beliefs."""
    _train("dec-airl", preset, seed, settings, iterations, recovery, "announced", None, out)


def _train(
    method: str,
    preset: str,
    seed: int,
    settings: str,
    iterations: int | None,
    recovery: int | None,
    label: str,
    belief: Path | None,
    out: Path | None,
) -> None:
    _check(seed, iterations=iterations, recovery=recovery)
    from cell.learn import commands
    from cell.version import commit

    folder = out or Path("runs") / f"{method}-{preset}-{seed}"
    result = commands.train(
        method, preset, seed, folder, settings, iterations, recovery, label, belief, commit=commit()
    )
    for decoding in ("greedy", "sampled"):
        _print_rewards(f"{method}, {decoding}", result[decoding])
    _print_rewards("expert", result["expert"])
    print(f"written to {folder}: policies (CSV), curve, result.json")


def evaluate(
    preset: Preset = "paper",
    policy: Annotated[
        str,
        typer.Option(help="expert, expert-never-speed-up, expert-always-industrial, or a policy CSV."),
    ] = "expert",
    human: Annotated[Path | None, typer.Option(help="CSV of the person's policy; else the expert's.")] = None,
    episodes: Annotated[int, typer.Option(help="How many.")] = 1000,
    seed: Seed = 1,
    start: Annotated[str | None, typer.Option(help="fixed or random; else as the preset has it.")] = None,
    decoding: Annotated[str, typer.Option(help="greedy or sampled.")] = "greedy",
    recovery: Recovery = None,
    label: Label = "announced",
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
) -> None:
    """Play episodes of the task with a policy and say how well it does."""
    _check(seed, episodes=episodes, recovery=recovery)
    from cell.learn import commands

    result = commands.evaluate(
        preset, policy, episodes, seed, start, decoding, recovery, human, label, json_file
    )
    if json_file is None:
        print(json.dumps(result, indent=1))
    else:
        _print_rewards(policy, result)


def report(
    what: Annotated[
        str, typer.Argument(help="table1, fig4, theorem1, recovery, transfer, prices or robustness.")
    ],
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write here; a PNG of the same name goes beside it.")
    ] = None,
    preset: Annotated[
        list[str] | None, typer.Option(help="Task and recovery time, as paper:20; may be given often.")
    ] = None,
    seeds: Annotated[int, typer.Option(help="Training seeds 1, 2, ...")] = 10,
    episodes: Annotated[int, typer.Option(help="Evaluation episodes each.")] = 1000,
    settings: Settings = "tuned",
    label: Label = "announced",
    workers: Annotated[int, typer.Option(help="Processes that train; the result is the same.")] = 1,
) -> None:
    """Recompute a table or figure of the paper."""
    _check(0, seeds=seeds, episodes=episodes, workers=workers)
    from cell.learn import commands

    tasks = tuple(_task(text) for text in preset or ("released:5", "paper:5", "paper:20"))
    target = json_file or Path("runs") / f"{what}.json"
    rows = commands.report(what, target, tasks, seeds, episodes, settings, label, workers)
    print(f"{len(rows)} rows written to {target}, picture beside it")


def _check(seed: int, **counts: int | None) -> None:
    """Refuse impossible numbers, and say what is missing for learning."""
    if not 0 <= seed < 2**31:
        raise ConfigError(f"--seed must be from 0 to 2^31 - 1, got {seed}")
    for name, value in counts.items():
        if value is not None and not 1 <= value <= 10_000_000:
            raise ConfigError(f"--{name} must be from 1 to 10000000, got {value}")
    for module in ("torch", "matplotlib"):
        if find_spec(module) is None:
            raise ConfigError(f"learning needs {module}: pip install 'sorting-cell[learn]' (or -e .[learn])")


def _task(text: str) -> tuple[str, int]:
    """("paper", 20) from "paper:20"."""
    name, _, recovery = text.partition(":")
    if name not in ("released", "paper", "cell"):
        raise ConfigError(f"--preset: {one_of(name, ['released:N', 'paper:N', 'cell:N'])}")
    if not recovery.isdecimal() or not 1 <= int(recovery) <= 10_000:
        raise ConfigError(f"--preset {text}: give the recovery time after a colon, as {name}:20")
    return name, int(recovery)


def _print_rewards(name: str, result: Any) -> None:
    words = [
        f"{key.replace('_', ' ')} {result[key]['mean']:.2f} +- {result[key]['ci95']:.2f}"
        for key in ("onions", "reward_truth", "reward_priced", "priced_steps")
    ]
    print(f"{name}: {', '.join(words)}")
