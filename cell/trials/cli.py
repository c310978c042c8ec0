"""`cell trials`. Imports of anything slow happen inside the commands."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import ConfigError

FAILED, INTERRUPTED = 1, 130
_PREDICTS = 0.10
"""Goal for the abstract task's error, as a share of the measured sort time."""

trials = typer.Typer(
    help="Run the published experiment in simulation, headless; a stopped campaign continues.",
    invoke_without_command=True,
    rich_markup_mode=None,
    add_completion=False,
)

Folder = Annotated[Path, typer.Argument(help="Folder of a campaign.")]


@trials.callback()
def run(
    context: typer.Context,
    people: Annotated[str, typer.Option(help="How many of the simulated people, or names: ana,bo.")] = "5",
    rounds: Annotated[int, typer.Option(help="Rounds per person, shared evenly by the policies.")] = 6,
    policies: Annotated[
        str, typer.Option(help="Commas between: tb, dec, a shipped policy, a CSV; POLICY@BELIEF; oracle.")
    ] = "tb,dec",
    onions: Annotated[int, typer.Option(help="Onions in a round (1 to 15).")] = 15,
    seed: Annotated[int, typer.Option(help="Seed of the campaign.")] = 0,
    workers: Annotated[int, typer.Option(help="Rounds at a time; results do not depend on it.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder of the campaign.")] = Path("runs/trials"),
    backend: Annotated[
        str, typer.Option(help="sim, or ur3e: the emulated controller, in real time.")
    ] = "sim",
    perception: Annotated[
        str, typer.Option(help="full, or truth: quick, the person is told, not seen.")
    ] = "full",
    shard: Annotated[str, typer.Option(help="i/n: only the i-th of n parts of the rounds.")] = "",
    scheduler: Annotated[str, typer.Option(help="Address of a Dask scheduler, as tcp://host:8786.")] = "",
    record: Annotated[bool, typer.Option("--record", help="Also an MCAP file per round (large).")] = False,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write plots and report.html.")] = True,
    config: Annotated[Path | None, typer.Option(help="Cell description laid over the shipped one.")] = None,
) -> None:
    """Run rounds of all people with all policies, and report.

    Exit code 0: every round is done and complete, nothing dropped; 1: not so; 2: bad input.
    """
    if context.invoked_subcommand is not None:
        return
    if not 1 <= workers <= 256:
        raise ConfigError(f"--workers must be from 1 to 256, got {workers}")
    from cell.config import load
    from cell.trials import plots, settings
    from cell.trials.campaign import Campaign, read
    from cell.trials.schedule import schedule
    from cell.trials.schedule import shard as part
    from cell.trials.show import Console, show, watched
    from cell.trials.workers import Cluster, Local, Workers

    if report:
        plots.check()
    chosen = settings.Settings(
        settings.people(people), rounds, settings.contenders(policies, perception), onions, seed, backend,
        perception, settings.cell_data(load(config)),
    )  # fmt: skip
    specs = part(schedule(chosen), shard)
    team: Workers = Cluster(scheduler) if scheduler else Local(workers)
    campaign = Campaign(out, chosen)
    console = Console(stderr=True)

    def complain(line: str) -> None:
        console.print(f"[red]not run: {line}[/red]", highlight=False)

    try:
        with watched(console, campaign, specs, workers) as tell:
            campaign.run(specs, team, record, tell, complain)
    except KeyboardInterrupt:
        print(f"cell: interrupted; the same command continues in {out}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    summary = _write(out, report)
    show(console, summary, out)
    mine = {spec.id for spec in specs}
    records = [r for r in read(out).records if r["id"] in mine]
    raise typer.Exit(0 if len(records) == len(specs) and all(map(_good, records)) else FAILED)


@trials.command("report")
def rebuild(folder: Folder) -> None:
    """Write the tables, plots and report.html of a campaign again."""
    from cell.trials.show import Console, show

    show(Console(stderr=True), _write(folder, True), folder)


@trials.command()
def calibrate(
    source: Annotated[Path, typer.Option("--from", help="Folder of a campaign.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for what is written; else inside the other.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the training.")] = 1,
    iterations: Annotated[int | None, typer.Option(help="Passes of training; else the tuned number.")] = None,
    install: Annotated[bool, typer.Option("--install", help="Ship the result with the package.")] = False,
) -> None:
    """Measure the actions' durations, train the policies anew on them, say how well the task predicts.

    Exit code 1 when the task's sort times are more than 10 % off for a policy.
    """
    from importlib.util import find_spec

    if find_spec("torch") is None:
        raise ConfigError("training needs torch: pip install 'sorting-cell[learn]' (or -e .[learn])")
    if not 0 <= seed < 2**31:
        raise ConfigError(f"--seed must be from 0 to 2^31 - 1, got {seed}")
    if iterations is not None and not 1 <= iterations <= 100_000:
        raise ConfigError(f"--iterations must be from 1 to 100000, got {iterations}")
    from cell.trials import calibrate as chain
    from cell.trials.campaign import read

    folder = out or source / "calibration"
    found = chain.calibrate(read(source), folder, seed, iterations, lambda text: print(text, flush=True))
    for row in found["rows"]:
        print(
            f"{row['policy']}: measured {row['measured_s']:.1f} s, predicted {row['predicted_s']:.1f} s "
            f"({100 * row['error_share']:+.1f} %); onions by the person {row['by_human_measured']:.1f}, "
            f"predicted {row['by_human_predicted']:.1f}"
        )
    for path in chain.install(folder) if install else ():
        print(f"installed {path}")
    raise typer.Exit(0 if all(abs(row["error_share"]) <= _PREDICTS for row in found["rows"]) else FAILED)


def _write(folder: Path, report: bool) -> dict[str, Any]:
    from cell.trials import report as html
    from cell.trials import tables
    from cell.trials.campaign import read

    return html.build(read(folder)) if report else tables.write(read(folder))


def _good(record: dict[str, Any]) -> bool:
    result = record["result"]
    return not result["failure"] and not result["dropped"] and result["sorted"] >= result["onions"]
