"""`cell calibrate`. Imports of anything slow happen inside the commands."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cell.errors import ConfigError, one_of

if TYPE_CHECKING:
    from cell.calibrate.flow import Found

INTERRUPTED = 130

calibrate = typer.Typer(
    help="Find where the cameras are and how they draw, with a board in the gripper (docs/calibration.md).",
    invoke_without_command=True,
    rich_markup_mode=None,
    add_completion=False,
)

Config = Annotated[Path | None, typer.Option(help="Cell description laid over the shipped one.")]


@calibrate.callback()
def run(
    context: typer.Context,
    backend: Annotated[str, typer.Option(help="What to drive: sim or ur3e.")] = "sim",
    camera: Annotated[str, typer.Option(help="Which: the name of one, or both.")] = "both",
    robot_ip: Annotated[str, typer.Option(help="Address of the real arm's controller.")] = "",
    cameras: Annotated[str, typer.Option(help="With ur3e: real, or sim (of an emulated cell).")] = "",
    views: Annotated[int, typer.Option(help="Views of the board per camera (8 to 60).")] = 15,
    seed: Annotated[int, typer.Option(help="Seed of the poses, and of the simulated cell.")] = 0,
    out: Annotated[Path, typer.Option(help="Configuration to write.")] = Path("calibrated.yaml"),
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures here.")] = None,
    config: Config = None,
) -> None:
    """Move the board through the cameras' views, solve, and write a configuration.

    In simulation the cameras stand a little off (by the seed), and the error is reported.
    Exit code 0: written; 2: a bad set of views, or bad input, and the line says which.
    """
    if context.invoked_subcommand is not None:
        return
    cameras = _surroundings(backend, robot_ip, cameras)
    if not 8 <= views <= 60:
        raise ConfigError(f"--views must be from 8 to 60, got {views}")
    if not 0 <= seed < 2**31:
        raise ConfigError(f"--seed must be from 0 to 2^31 - 1, got {seed}")
    for file in (out, json_file):
        if file is not None and not file.resolve().parent.is_dir():
            raise ConfigError(f"the folder of {file} does not exist")
    if config is not None and out.resolve() == config.resolve():
        raise ConfigError("--out would overwrite --config; give another name")
    from cell.config import load

    cell = load(config)
    names = tuple(cell.cameras) if camera == "both" else (camera,)
    if names[0] not in cell.cameras:
        raise ConfigError(f"--camera: {one_of(camera, [*cell.cameras, 'both'])}")
    if backend == "ur3e":
        robot_ip = robot_ip or cell.ur3e.robot_ip
        if not robot_ip:
            raise ConfigError(
                "the address of the robot's controller is missing; give --robot-ip or ur3e.robot_ip"
            )
    from cell.calibrate import flow, overlay, truth

    if backend == "sim":
        cell = truth.misplaced(cell, seed)
    options = flow.Options(backend, names, views, seed, robot_ip, cameras)
    try:
        found = flow.calibrate(cell, options, lambda text: print(text, flush=True), ask)
    except KeyboardInterrupt:
        print("cell: interrupted; the arm was stopped on its path", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    for one in found:
        print(sentence(one))
    overlay.write(out, config, cell, found)
    print(f"written: {out}")
    if json_file is not None:
        json_file.write_text(json.dumps(overlay.figures(found), indent=2) + "\n")


@calibrate.command("board")
def board(
    out: Annotated[Path, typer.Option(help="SVG to write, of the board's true size.")] = Path("board.svg"),
    config: Config = None,
) -> None:
    """Write the board, to be printed without scaling."""
    from cell.calibrate.overlay import write_board
    from cell.cameras import board_size
    from cell.config import load

    cell = load(config)
    write_board(out, cell)
    across, down = board_size(cell.board)
    print(
        f"written: {out}, {across * 1e3:.1f} x {down * 1e3:.1f} mm. Print it at 100 %, glue it to something "
        f"flat and stiff, measure a square and set board.square (now {cell.board.square * 1e3:.2f} mm)"
    )


def sentence(one: Found) -> str:
    """What was found, in one line."""
    s = one.solution
    text = (
        f"camera {one.name}: {s.views} views, residual {s.residual:.2f} px; {one.moved[0] * 1e3:.1f} mm and "
        f"{one.moved[1] * 1e3:.1f} mrad from where it was configured; known to {s.sd_position * 1e3:.2f} mm, "
        f"{s.sd_rotation * 1e3:.2f} mrad, focal length {s.sd_focal * 100:.2f} % (standard deviations)"
    )
    if one.error is not None:
        e = one.error
        text += (
            f"; against the truth {e.position * 1e3:.2f} mm, {e.rotation * 1e3:.2f} mrad, focal length "
            f"{e.focal * 100:.3f} %, centre {e.centre * 100:.3f} % of the width"
        )
    return text


def ask(text: str) -> Callable[[], bool]:
    """Print a request and wait for Enter in a thread: the arm's loop must go on meanwhile."""
    print(text, flush=True)
    done = threading.Event()

    def wait() -> None:
        sys.stdin.readline()
        done.set()

    threading.Thread(target=wait, name="answer", daemon=True).start()
    return done.is_set


def _surroundings(backend: str, robot_ip: str, cameras: str) -> str:
    if backend not in ("sim", "ur3e"):
        raise ConfigError(f"--backend: {one_of(backend, ['sim', 'ur3e'])}")
    if backend == "sim":
        if robot_ip or cameras not in ("", "sim"):
            raise ConfigError("--robot-ip and --cameras belong to --backend ur3e; the simulation has its own")
        return ""
    if cameras not in ("", "real", "sim"):
        raise ConfigError(f"--cameras: {one_of(cameras, ['real', 'sim'])}")
    return cameras or "real"
