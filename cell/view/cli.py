"""`cell view`. Imports of anything slow happen inside the command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cell.errors import ConfigError

_PORT = 8080
_CONNECT = 5.0
"""How long to look for the cell [s]."""


def view(
    file: Annotated[
        Path | None, typer.Argument(help="A recording to show instead of a running cell.")
    ] = None,
    port: Annotated[int, typer.Option(help="Port of the page on this machine.")] = _PORT,
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
        raise ConfigError("recordings: soon")
    try:
        serve(cell, port, source, _tell, lambda: False)
    except KeyboardInterrupt:
        raise typer.Exit(0) from None


def _tell(address: str) -> None:
    print(f"cell: the view is at {address}", flush=True)


def check_port(port: int) -> None:
    """Raise `ConfigError` unless a page may be served on `port`."""
    if not 1024 <= port <= 65535:
        raise ConfigError(f"the view's port must be from 1024 to 65535, got {port}")
