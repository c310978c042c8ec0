"""The command line. Imports of anything slow happen inside the commands."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from cell.errors import CellError, ConfigError, one_of
from cell.learn import cli as learning

BAD_INPUT, FAILED, INTERRUPTED = 2, 1, 130
PERSONS = ("sim", "none")

app = typer.Typer(
    name="cell",
    help="Cell controller for human-robot sorting with a UR3e. Not a safety-rated system.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # plain help needs no rich, and answers in a fraction of the time
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        from cell import __version__

        print(f"cell {__version__}")
        raise typer.Exit


@app.command()
def run(
    backend: Annotated[str, typer.Option(help="What to drive: sim.")] = "sim",
    policy: Annotated[str, typer.Option(help="Policy CSV, or the name of a shipped one.")] = "tb-decairl",
    person: Annotated[str, typer.Option(help="Who works beside the robot: sim or none.")] = "sim",
    persona: Annotated[str, typer.Option(help="Which simulated person: ana, bo, chen, dana or efe.")] = "ana",
    onions: Annotated[int, typer.Option(help="Onions in the batch (1 to 15).")] = 15,
    seed: Annotated[int, typer.Option(help="Seed of the batch.")] = 0,
    headless: Annotated[bool, typer.Option("--headless", help="Lock-step, as fast as possible.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
    record: Annotated[Path | None, typer.Option(help="Record the wire to this MCAP file.")] = None,
    config: Annotated[Path | None, typer.Option(help="Cell description laid over the shipped one.")] = None,
) -> None:
    """Sort one batch of onions.

    Exit code 0: every onion handled, nothing dropped; 1: the round ran and failed; 2: bad input.
    """
    from rich.console import Console

    from cell.config import load
    from cell.decision.policy import load as load_policy

    if backend != "sim":
        raise ConfigError(f"--backend: {one_of(backend, ['sim'])}")
    if person not in PERSONS:
        raise ConfigError(f"--person: {one_of(person, PERSONS)}")
    if not 1 <= onions <= 15:
        raise ConfigError(f"--onions must be from 1 to 15, got {onions}")
    if not 0 <= seed < 2**63:
        raise ConfigError(f"--seed must be from 0 to 2^63 - 1, got {seed}")
    for file in (json_file, record):
        if file is not None and not file.resolve().parent.is_dir():
            raise ConfigError(f"the folder of {file} does not exist")
        if file is not None and file.is_dir():
            raise ConfigError(f"{file} is a folder; give the name of a file")
    if record is not None:
        from cell.record.mcap_writer import check_target

        check_target(record)
    cell_config = load(config)
    table = load_policy(policy)

    from cell.run.display import Progress, summary
    from cell.run.round import RoundOptions, run_round

    console = Console(stderr=True)
    who = persona if person == "sim" else ""
    options = RoundOptions(backend, lock_step=headless, seed=seed, onions=onions, record=record, person=who)
    try:
        with Progress(console, onions, cell_config.gripper.length) as progress:
            result = run_round(cell_config, table, options, progress)
    except KeyboardInterrupt:  # here, because what the option parser makes of it varies
        print("cell: interrupted; the arm was stopped on its path", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    summary(console, result)
    if json_file is not None:
        result.write(json_file)
    raise typer.Exit(0 if result.succeeded else FAILED)


app.add_typer(learning.train, name="train")
app.command()(learning.evaluate)
app.command()(learning.report)


@app.command()
def doctor(
    config: Annotated[Path | None, typer.Option(help="Cell description laid over the shipped one.")] = None,
) -> None:
    """Say what this machine lacks."""
    from cell.doctor import examine

    raise typer.Exit(0 if examine(config, renderer_problem=_renderer_problem) else FAILED)


def _renderer_problem() -> str:
    from hil.sim.render.renderer import gl_problem

    return gl_problem()


def main() -> NoReturn:
    """Entry point: deliberate errors become one line and exit code 2."""
    try:
        app()
    except CellError as error:
        print(f"cell: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    sys.exit(0)


if __name__ == "__main__":
    main()
