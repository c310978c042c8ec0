"""The web server under the page: on the loopback interface, and for pages from there only."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from functools import partial
from io import StringIO
from typing import TYPE_CHECKING

from cell.errors import WireError

if TYPE_CHECKING:
    from viser import ViserServer

HOST = "127.0.0.1"
_OURS = re.compile(r"https?://(127\.0\.0\.1|localhost|\[::1\])(:\d+)?")
"""Where a page that may talk to the cell comes from: this machine, by whatever port it was forwarded to.

A browser lets every web page open a WebSocket to this machine, but says whose it is (RFC 6455, 10.2)."""


def make_server(port: int) -> ViserServer:
    """A web server on the loopback interface; raises `WireError` when the port is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise WireError(f"the view cannot use port {port}: {error.strerror}; give another one") from None
    from viser import ViserServer

    with redirect_stdout(StringIO()), _origins_checked():  # it prints a banner
        server = ViserServer(host=HOST, port=port, label="sorting cell", verbose=False)
    if server.get_port() != port:  # another program was quicker; viser goes to the next free one
        stop_server(server)
        raise WireError(f"the view cannot use port {port}: it is in use; give another one")
    return server


def stop_server(server: ViserServer) -> None:
    """End it without a word."""
    with redirect_stdout(StringIO()):
        server.stop()


@contextmanager
def _origins_checked() -> Iterator[None]:
    """Servers that start meanwhile refuse pages from elsewhere; viser has no option for it.

    Programs that are no browser send no origin, and are let in: they can reach the wire itself anyway.
    """
    import websockets.asyncio.server as library

    plain = library.serve
    library.serve = partial(plain, origins=[None, _OURS])  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        library.serve = plain  # type: ignore[misc]
