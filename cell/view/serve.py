"""Runs a page until it is told to end."""

from __future__ import annotations

from collections.abc import Callable

from cell.clock import WallClock
from cell.config import CellConfig
from cell.view.moment import Source
from cell.view.page import Page
from cell.view.web import HOST, make_server, stop_server

_PERIOD = 0.1
"""Between two drawings of what moves [s]."""


def serve(
    config: CellConfig,
    port: int,
    make_source: Callable[[], Source],
    ready: Callable[[str], None],
    ended: Callable[[], bool],
    count: Callable[[int], None] | None = None,
) -> None:
    """Open the page and draw until `ended()`.

    Args:
        port: of the web server. make_source: called once the port is ours.
        ready: told the page's address when it can be opened.
        count: told how many browsers show the page, whenever that changes.

    Raises:
        CellError: the port is taken, or there is no source.
    """
    server = make_server(port)
    clock = WallClock()
    try:
        source = make_source()
        try:
            ready(f"http://{HOST}:{port}")
            page = Page(server, config, source)
            due, browsers = clock.now(), 0
            while not ended():
                page.draw()
                if count is not None and len(server.get_clients()) != browsers:
                    browsers = len(server.get_clients())
                    count(browsers)
                due = max(due + _PERIOD, clock.now() + 0.2 * _PERIOD)  # what was late is left out
                clock.sleep_until(due)
        finally:
            source.close()
    finally:
        stop_server(server)
