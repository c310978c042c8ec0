"""`cell view`. Imports of anything slow happen inside the command."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cell.errors import ConfigError

if TYPE_CHECKING:
    from cell.config import CellConfig

PORT = 8080
_CONNECT = 5.0
"""How long to look for the cell [s]."""
_PATIENCE = 600.0
"""A stopped round that is watched waits so long for somebody to resume it [s]."""
Watched = Callable[[], bool] | None
"""Whether anybody looks at the page now; None: there is no page."""


def view(
    file: Annotated[
        Path | None, typer.Argument(help="A recording to show instead of a running cell.")
    ] = None,
    port: Annotated[int, typer.Option(help="Port of the page on this machine.")] = PORT,
    config: Annotated[Path | None, typer.Option(help="Cell description laid over the shipped one.")] = None,
) -> None:
    """Show a running cell, or a recording, in the browser (docs/view.md); Ctrl-C ends it."""
    check_port(port)
    from cell.view.live import LiveSource
    from cell.view.moment import Source
    from cell.view.serve import serve

    if file is None:
        from cell.config import load

        cell = load(config)

        def source() -> Source:
            return LiveSource(cell, _CONNECT)
    else:
        if config is not None:
            raise ConfigError("--config is for a running cell; a recording brings its own")
        from cell.view.recorded import RecordedSource

        recording = RecordedSource(file)
        cell = recording.config

        def source() -> Source:
            return recording

    try:
        serve(cell, port, source, _tell, lambda: False)
    except KeyboardInterrupt:
        raise typer.Exit(0) from None


@contextmanager
def beside(config: CellConfig, port: int, wanted: bool) -> Iterator[tuple[CellConfig, Watched]]:
    """The view as a process beside a round, if it is wanted: the round's configuration, and who looks on.

    Where somebody can look on, a stopped round waits to be resumed.
    """
    if not wanted:
        yield config, None
        return
    check_port(port)
    from msgspec.structs import replace

    from cell.view.child import ViewProcess

    patience = config.supervisor.stop_patience or _PATIENCE
    config = replace(config, supervisor=replace(config.supervisor, stop_patience=patience))
    with ViewProcess(config, port, _tell) as process:
        yield config, process.watched


def _tell(address: str) -> None:
    print(f"cell: the view is at {address}", file=sys.stderr, flush=True)


def check_port(port: int) -> None:
    """Raise `ConfigError` unless a page may be served on `port`."""
    if not 1024 <= port <= 65535:
        raise ConfigError(f"the view's port must be from 1024 to 65535, got {port}")
