"""What may go wrong on purpose, as the emulated controller and its servers ask for it.

An `Emulator` is given one `Faults`. Its servers ask it about every new connection and about every
whole message of the connections it wants to disturb; the controller asks it before each cycle.
All calls come from the controller's own thread (those of the gripper's server from its own).
`now` is the controller's time since boot [s]; delays are real time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from hil.emulator.interfaces import Robot


class Server(StrEnum):
    """The servers of one controller."""

    DASHBOARD = "dashboard"
    PRIMARY = "primary"
    SECONDARY = "secondary"
    REALTIME = "realtime"
    RTDE = "rtde"
    GRIPPER = "gripper"


@dataclass(frozen=True)
class Delivery:
    """Bytes to hand on.

    Attributes:
        data: usually the message itself.
        delay: how much later [s]; order is kept, so what comes after waits, too.
    """

    data: bytes
    delay: float = 0.0


class LinkFaults(Protocol):
    """Disturbs one connection. A message is one whole RTDE or state packet, one dashboard or gripper
    line, one script text.

    Returning one `Delivery(message)` leaves it alone, none drops it, two duplicate it. A connection
    is frozen by long delays or by dropping everything: it stays open.
    """

    def incoming(self, message: bytes, now: float) -> Sequence[Delivery]:
        """From the client."""
        ...

    def outgoing(self, message: bytes, now: float) -> Sequence[Delivery]:
        """To the client."""
        ...

    def cut(self, now: float) -> bool:
        """Asked once a cycle; True closes the connection at once, unsent bytes are lost."""
        ...


class Panel(Robot, Protocol):
    """What may be done to a controller from outside: its buttons, its input terminals, its limits.

    Only from the controller's own thread; from elsewhere through `Emulator.do`.
    """

    remote_control: bool

    def emergency_stop(self, pressed: bool) -> None:
        """The button on the pendant: ends powered off; released, it may be powered on again."""
        ...

    def safeguard_stop(self, open_: bool) -> None:
        """The safeguard input: pauses on the path, goes on when closed (see `SafetyIo.reset`)."""
        ...

    def violation(self, reason: str) -> None:
        """A safety limit was broken: powered off, and the safety system must be restarted."""
        ...

    def digital_input(self, bit: int, high: bool) -> None:
        """Set an input terminal. Bits 0-7 standard, 8-15 configurable, 16-17 tool."""
        ...


class Faults(Protocol):
    """All disturbances of one emulated controller."""

    def version(self) -> tuple[int, int, int, int] | None:
        """Announce this version (major, minor, bugfix, build); None: the true one."""
        ...

    def remote_control(self) -> bool | None:
        """What the dashboard says of remote control; None: the truth."""
        ...

    def in_use(self, name: str) -> bool:
        """Report this RTDE input as taken by somebody else."""
        ...

    def before_cycle(self, panel: Panel, now: float) -> float:
        """May press buttons, trigger stops. Returns how long the cycle takes too long [s].

        Args:
            now: time since the controller's start by the machine's clock [s].
        """
        ...

    def refuse(self, server: Server, peer: str) -> bool:
        """Close a new connection at once. peer: "host:port"."""
        ...

    def link(self, server: Server, peer: str) -> LinkFaults | None:
        """Disturb this new connection; None leaves it alone."""
        ...


class NoFaults:
    """Everything works."""

    def version(self) -> tuple[int, int, int, int] | None:
        return None

    def remote_control(self) -> bool | None:
        return None

    def in_use(self, name: str) -> bool:
        del name
        return False

    def before_cycle(self, panel: Panel, now: float) -> float:
        del panel, now
        return 0.0

    def refuse(self, server: Server, peer: str) -> bool:
        del server, peer
        return False

    def link(self, server: Server, peer: str) -> LinkFaults | None:
        del server, peer
        return None
