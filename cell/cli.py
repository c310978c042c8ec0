"""The command line. Imports of anything slow happen inside the commands."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from cell.calibrate import cli as calibrating
from cell.errors import CellError, ConfigError, one_of
from cell.learn import cli as learning
from cell.trials import cli as trying
from cell.view import cli as viewing

BAD_INPUT, FAILED, INTERRUPTED = 2, 1, 130
BACKENDS = ("sim", "ur3e")
PERSONS = ("sim", "real", "none")

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
    backend: Annotated[str, typer.Option(help="What to drive: sim or ur3e.")] = "sim",
    robot_ip: Annotated[str, typer.Option(help="Address of the real arm's controller.")] = "",
    cameras: Annotated[
        str, typer.Option(help="With ur3e: real, sim (of an emulated cell), or a recording.")
    ] = "",
    policy: Annotated[str, typer.Option(help="Policy CSV, or the name of a shipped one.")] = "tb-decairl",
    person: Annotated[
        str, typer.Option(help="Who works beside the robot: sim, real or none; as the cameras are.")
    ] = "",
    persona: Annotated[str, typer.Option(help="Which simulated person: ana, bo, chen, dana or efe.")] = "ana",
    onions: Annotated[int, typer.Option(help="Onions in the batch (1 to 15).")] = 15,
    seed: Annotated[int, typer.Option(help="Seed of the batch.")] = 0,
    headless: Annotated[bool, typer.Option("--headless", help="Lock-step, as fast as possible.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
    record: Annotated[Path | None, typer.Option(help="Record everything to this MCAP file.")] = None,
    record_lossless: Annotated[
        bool, typer.Option("--record-lossless", help="With every pixel of the person camera (large).")
    ] = False,
    view: Annotated[
        bool, typer.Option("--view", help="Also a live page in the browser (docs/view.md).")
    ] = False,
    view_port: Annotated[int, typer.Option(help="Port of that page on this machine.")] = viewing.PORT,
    config: Annotated[Path | None, typer.Option(help="Cell description laid over the shipped one.")] = None,
) -> None:
    """Sort one batch of onions.

    Exit code 0: every onion handled, nothing dropped; 1: the round ran and failed; 2: bad input.
    """
    from rich.console import Console

    from cell.config import load
    from cell.decision.policy import load as load_policy

    cameras, person = _surroundings(backend, robot_ip, cameras, person, headless)
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
    elif record_lossless:
        raise ConfigError("--record-lossless says how --record FILE records; give that too")
    cell_config = load(config)
    table = load_policy(policy)
    if backend == "ur3e":
        from hil.ur3e.checks import check_reachable, robot_address

        check_reachable(robot_address(cell_config, robot_ip))  # before anything slow is started

    from cell.run.display import Progress, summary
    from cell.run.result import RoundResult
    from cell.run.round import REAL_PERSON, RoundOptions
    from cell.run.rounds import run_rounds

    console = Console(stderr=True)
    options = RoundOptions(
        backend,
        lock_step=headless,
        seed=seed,
        onions=onions,
        record=record,
        record_lossless=record_lossless,
        person={"sim": persona, "real": REAL_PERSON, "none": ""}[person],
        robot_ip=robot_ip,
        cameras=cameras,
    )

    def report(result: RoundResult) -> None:
        summary(console, result)
        if json_file is not None:
            result.write(json_file)

    def show(options: RoundOptions) -> Progress:
        return Progress(console, options.onions, cell_config.gripper.length)

    try:
        with viewing.beside(cell_config, view_port, view) as (cell_config, watched):
            result = run_rounds(cell_config, table, options, show, report, watched)
    except KeyboardInterrupt:  # here, because what the option parser makes of it varies
        print("cell: interrupted; the arm was stopped on its path", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    raise typer.Exit(0 if result.succeeded else FAILED)


@app.command()
def emulate(
    listen: Annotated[str, typer.Option(help="Address to serve on, with the true ports.")] = "127.0.0.2",
    model: Annotated[str, typer.Option(help="The arm: ur3e or ur5e.")] = "ur3e",
    persona: Annotated[str, typer.Option(help="Who works in the simulated cell, or none.")] = "ana",
    onions: Annotated[int, typer.Option(help="Onions in the first batch (0 to 15).")] = 15,
    seed: Annotated[int, typer.Option(help="Seed of the batch, the person and the faults.")] = 0,
    fault: Annotated[list[str] | None, typer.Option(help="kind[:key=value,...]; may be repeated.")] = None,
    running: Annotated[bool, typer.Option("--running/--powered-off", help="State at the start.")] = True,
    bare: Annotated[bool, typer.Option("--bare", help="No cell around the arm.")] = False,
    linked: Annotated[bool, typer.Option("--linked", help="End when standard input closes.")] = False,
    programs: Annotated[Path | None, typer.Option(help="Folder of what the dashboard can load.")] = None,
    config: Annotated[Path | None, typer.Option(help="Cell description laid over the shipped one.")] = None,
) -> None:
    """Run an emulated UR controller on its true ports, for tests without a robot (docs/emulator.md)."""
    from cell.config import load
    from hil.emulator.run import EmulateOptions, emulate

    who = "" if persona == "none" else persona
    options = EmulateOptions(
        listen, model, seed, onions, who, tuple(fault or ()), running, bare, linked, programs
    )
    emulate(load(config), options, lambda line: print(f"cell: {line}", flush=True))


def _surroundings(backend: str, robot_ip: str, cameras: str, person: str, headless: bool) -> tuple[str, str]:
    """(cameras, person) with what follows from one another filled in; raises `ConfigError`."""
    if backend not in BACKENDS:
        raise ConfigError(f"--backend: {one_of(backend, BACKENDS)}")
    if person and person not in PERSONS:
        raise ConfigError(f"--person: {one_of(person, PERSONS)}")
    if backend == "sim":
        if robot_ip or cameras not in ("", "sim"):
            raise ConfigError("--robot-ip and --cameras belong to --backend ur3e; the simulation has its own")
        if person == "real":
            raise ConfigError("--person real needs real cameras (--backend ur3e)")
        return "", person or "sim"
    if headless:
        raise ConfigError("--headless: a real arm has a clock of its own and cannot run in lock-step")
    cameras = cameras or "real"
    if cameras not in ("real", "sim") and not Path(cameras).exists():
        raise ConfigError(f"--cameras: {one_of(cameras, ['sim', 'real', 'a recording that exists'])}")
    person = person or ("sim" if cameras == "sim" else "real")
    if (person == "sim") != (cameras == "sim") and person != "none":
        raise ConfigError(
            f"--person {person} does not go with --cameras {cameras}: they are sim or real together"
        )
    return cameras, person


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(help="Recording of a round (.mcap).")],
    within: Annotated[
        float, typer.Option(help="Numbers this close count as equal (recordings of other machines).")
    ] = 0.0,
) -> None:
    """Put a recording's inputs through today's supervisor and compare what it decides (docs/recordings.md).

    Exit code 0: identical, byte for byte; 1: it differs, and where first; 2: the file cannot be replayed.
    """
    from cell.replay.show import show

    if not 0.0 <= within < 1.0:
        raise ConfigError(f"--within must be from 0 to below 1, got {within}")
    raise typer.Exit(0 if show(file, within) else FAILED)


app.add_typer(trying.trials, name="trials")
app.add_typer(calibrating.calibrate, name="calibrate")
app.add_typer(learning.train, name="train")
app.command()(viewing.view)
app.command()(learning.evaluate)
app.command()(learning.report)


@app.command()
def doctor(
    config: Annotated[Path | None, typer.Option(help="Cell description laid over the shipped one.")] = None,
    robot_ip: Annotated[str, typer.Option(help="Also look at the controller at this address.")] = "",
) -> None:
    """Say what this machine lacks, and what the robot's controller does."""
    from cell.doctor import examine

    robot = (lambda: _robot_rows(robot_ip)) if robot_ip else None
    raise typer.Exit(0 if examine(config, renderer_problem=_renderer_problem, robot=robot) else FAILED)


@app.command()
def recover(
    robot_ip: Annotated[str, typer.Option(help="Address of the controller.")] = "",
    config: Annotated[Path | None, typer.Option(help="Cell description laid over the shipped one.")] = None,
) -> None:
    """Bring the real arm back after a stop, step by step; starts no motion.

    Exit code 0: the robot is ready; 1: it is not, and the last line says why; 2: nobody answers.
    """
    from cell.config import load
    from hil.ur3e.checks import robot_address
    from hil.ur3e.recover import recover as recover_robot

    address = robot_address(load(config), robot_ip)
    raise typer.Exit(recover_robot(address, lambda text: print(text, flush=True)))


def _robot_rows(robot_ip: str) -> list[tuple[str, str, str]]:
    from hil.ur3e.recover import look

    return look(robot_ip)


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
