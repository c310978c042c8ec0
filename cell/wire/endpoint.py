"""The one place where Zenoh is configured and opened.

The node listens as a peer; everybody else connects to it as a client. The difference
matters: Zenoh peers pass nothing on for other peers, so a recorder that is a peer of the
node would never see the supervisor, while clients of one peer see each other through it.
Discovery is off; nothing leaves the loopback interface.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass

import zenoh

from cell.config import CellConfig
from cell.errors import WireError

HOST = "127.0.0.1"

#: Sequence number, source time [ns], random number of the sending session; little endian.
ATTACHMENT = struct.Struct("<QqQ")

# A frozen receiver must never hold up the sender's control loop, so published samples are
# dropped when a link is congested, at the price of a gap that the reader counts. A busy
# machine may not run the sending thread for some milliseconds: wait that long first.
_DROP_WAIT_US = 4000
_IMAGE_DROP_WAIT_US = 20_000


@dataclass(frozen=True)
class Quality:
    """How one kind of message is sent.

    Attributes:
        priority: Zenoh's class; each has its own queue, so images never delay joint states.
        express: send at once instead of waiting for more to fill a batch.
    """

    priority: zenoh.Priority
    express: bool


SMALL = Quality(zenoh.Priority.INTERACTIVE_HIGH, express=True)
BULK = Quality(zenoh.Priority.DATA_LOW, express=False)


def locator(config: CellConfig) -> str:
    """The node's Zenoh endpoint."""
    return f"tcp/{HOST}:{config.port}"


def zenoh_config(mode: str, listen: list[str], connect: list[str], timeout: float) -> zenoh.Config:
    """Zenoh's configuration for a session with these endpoints and nothing else.

    Args:
        mode: "peer" or "client".
        timeout: how long opening may try to connect [s].
    """
    out = zenoh.Config()
    values: dict[str, object] = {
        "mode": mode,
        "listen/endpoints": listen,
        "listen/exit_on_failure": True,
        "connect/endpoints": connect,
        "connect/timeout_ms": round(timeout * 1000),
        "connect/exit_on_failure": True,
        # Zenoh's own 1 s and growing is long for a node that was restarted.
        "connect/retry": {"period_init_ms": 20, "period_max_ms": 500, "period_increase_factor": 1.5},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/queue/congestion_control/drop": {
            "wait_before_drop": _DROP_WAIT_US,
            "max_wait_before_drop_fragments": _IMAGE_DROP_WAIT_US,
        },
    }
    for key, value in values.items():
        out.insert_json5(key, json.dumps(value))
    return out


def open_listener(config: CellConfig) -> zenoh.Session:
    """Open the node's end; raises WireError, naming the remedy if the port is taken."""
    try:
        return zenoh.open(zenoh_config("peer", [locator(config)], [], 0.0))
    except zenoh.ZError as error:
        if "in use" in str(error):
            raise WireError(
                f"port {config.port} is in use: another cell is running, or another program has it; "
                "choose another with 'port:' in the configuration"
            ) from None
        raise WireError(f"cannot listen on {locator(config)}: {first_line(error)}") from None


def open_client(config: CellConfig, timeout: float) -> zenoh.Session:
    """Connect to the node within `timeout` [s]; raises WireError."""
    try:
        return zenoh.open(zenoh_config("client", [], [locator(config)], timeout))
    except zenoh.ZError as error:
        if "Unable to connect" in str(error):
            raise WireError(
                f"nothing answers at {locator(config)} after {timeout:g} s: is the cell's node running, "
                "and with the same 'port:' in its configuration?"
            ) from None
        raise WireError(f"cannot connect to {locator(config)}: {first_line(error)}") from None


def first_line(error: Exception) -> str:
    """Zenoh's message without the place in its source where it arose."""
    return str(error).split(" at /")[0].strip()
