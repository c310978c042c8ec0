"""`python -m hil.emulator.eyes`: the process with the cameras, the person and the truth.

It is started by the emulator (`hil.emulator.surroundings`), which hands it one end of the link to the
plant, and ends when that link does. Configuration comes as one line of JSON on standard input;
"ready" on standard output says that the first batch was sent to the plant. Deliberate errors are one
line on standard error and exit code 2.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import socket
import sys
import warnings
from contextlib import suppress

from cell.clock import perf_s
from cell.config import CellConfig, from_dict
from cell.errors import BackendError, CellError, ConfigError
from cell.wire.session import Session
from hil.emulator.exchange import Exchange, Hand, Snapshot, Touch
from hil.emulator.mirror import MirrorBackend, check_surroundings
from hil.emulator.world_link import open_service
from hil.emulator.world_service import WorldService

_WAKE = 0.005
"""The longest that queries wait while the plant says nothing [s]."""
_MOST_BEHIND = 12
"""Reports that may wait; older ones are skipped [control periods]."""
_MOST = 1000
"""More messages than fit into the link."""
_SWAP_TIME = 5.0
"""How long the plant may take to put a new batch in place [s]."""


class Eyes:
    """The loop of the process."""

    def __init__(
        self, config: CellConfig, backend: MirrorBackend, exchange: Exchange, session: Session
    ) -> None:
        self._backend, self._exchange = backend, exchange
        self._hand: Hand | None = None
        self._seen = 0
        self._service = WorldService(config, backend, session, self._renew)

    def run(self) -> None:
        """Work until the plant's end is closed."""
        self._exchange.send(self._backend.batch())
        while self._exchange.open:
            select.select([self._exchange], [], [], _WAKE)
            self._follow()
            self._service.work()
        self._service.close()

    def _follow(self) -> None:
        messages = self._exchange.receive(_MOST)
        snapshots = [m for m in messages if isinstance(m, Snapshot)][-_MOST_BEHIND:]
        for message in messages:
            if isinstance(message, Touch):
                self._backend.note_contact(message.text)
        for snapshot in snapshots:
            self._seen = snapshot.batch
            self._tell(self._backend.live(snapshot))

    def _tell(self, hand: Hand) -> None:
        """What is held, every time; that nothing is held, once."""
        if hand.onion < 0 and self._hand is not None and self._hand.onion < 0:
            return
        if self._exchange.send(hand):
            self._hand = hand

    def _renew(self, seed: int, onions: int, persona: str) -> None:
        batch = self._backend.renew(seed, onions, persona)
        self._exchange.receive(_MOST)  # what was said meanwhile is about the old batch
        self._hand = None
        self._exchange.send(batch)
        end = perf_s() + _SWAP_TIME
        while self._seen != batch.number:
            if perf_s() > end or not self._exchange.open:
                raise BackendError("the controller's loop did not put the new batch in place")
            select.select([self._exchange], [], [], _WAKE)
            self._follow()


def main() -> int:
    """Run until the emulator is gone; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m hil.emulator.eyes", description=__doc__)
    parser.add_argument("--link", type=int, required=True, help="file descriptor of the link to the plant")
    parser.add_argument("--listen", required=True, help="address of the side channel: host or host:port")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--onions", type=int, default=15)
    parser.add_argument("--persona", default="", help="empty: nobody")
    args = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the emulator's to handle
    warnings.showwarning = lambda message, *_: print(f"warning: {message}", file=sys.stderr)
    exchange = Exchange(socket.socket(fileno=args.link))
    try:
        config = _read_config()
        check_surroundings(args.seed, args.onions, args.persona)
        backend = MirrorBackend(config, args.seed, args.onions, args.persona)
        with open_service(config, args.listen) as session:  # a port in use shows at once
            try:
                backend.connect()
                with suppress(OSError):
                    os.write(1, b"ready\n")
                Eyes(config, backend, exchange, session).run()
            finally:
                backend.close()
    except CellError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    return 0


def _read_config() -> CellConfig:
    try:
        return from_dict(json.loads(sys.stdin.readline()), "standard input")
    except ValueError:
        raise ConfigError("expected the configuration as one line of JSON on standard input") from None


if __name__ == "__main__":
    sys.exit(main())
