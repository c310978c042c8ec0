"""How the emulator's side channel is named and opened; see `hil.emulator.world_service`."""

from __future__ import annotations

import msgspec
import zenoh

from cell.config import CellConfig
from cell.errors import WireError
from cell.wire import codec
from cell.wire.endpoint import first_line, zenoh_config
from cell.wire.session import Session

PREFIX = "emulator"
WORLD_PORT = 7448
NOBODY = "none"
RESET_TIME = 60.0
"""Building a world anew may take this long [s]."""


def reset_key(persona: str) -> str:
    """Key of the query that brings a new batch and this person; "" is nobody."""
    return f"{PREFIX}/reset/{persona or NOBODY}"


def locator(address: str) -> str:
    """Zenoh's endpoint at an address "host" or "host:port"."""
    host, _, port = address.partition(":")
    return f"tcp/{host}:{port or WORLD_PORT}"


def open_service(config: CellConfig, address: str) -> Session:
    """The emulator's end of the side channel; raises `WireError`, also when the port is taken."""
    codec.warm_up()
    try:
        session = zenoh.open(zenoh_config("peer", [locator(address)], [], 0.0))
    except zenoh.ZError as error:
        if "in use" in str(error):
            raise WireError(
                f"{locator(address)} is in use: another emulator runs at this address; "
                "end it, or choose another with --listen, e.g. 127.0.0.3"
            ) from None
        raise WireError(f"cannot listen on {locator(address)}: {first_line(error)}") from None
    return Session(session, prefixed(config))


def open_world(config: CellConfig, address: str, timeout: float) -> Session:
    """A client's end; raises `WireError` when no emulator answers within `timeout` [s]."""
    codec.warm_up()
    try:
        return Session(zenoh.open(zenoh_config("client", [], [locator(address)], timeout)), prefixed(config))
    except zenoh.ZError:
        raise WireError(
            f"no simulated surroundings at {locator(address)} after {timeout:g} s: is `cell emulate` "
            "running there? A real controller has none: use --cameras real"
        ) from None


def prefixed(config: CellConfig) -> CellConfig:
    """The configuration whose wire keys begin with `PREFIX`."""
    return msgspec.structs.replace(config, name=PREFIX)
