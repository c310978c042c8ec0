"""`python -m hil`: the node as a process of its own.

It reads its configuration as one line of JSON from standard input, prints "ready" when it
serves, and ends, with the arm stopped on its path, when standard input closes (its parent is
gone) or on SIGTERM. Deliberate errors are one line on standard error and exit code 2; a backend
that fails later is one line, too, and exit code 1.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
import warnings
from contextlib import suppress
from types import FrameType

from cell.config import CellConfig, from_dict
from cell.errors import BackendError, CellError, ConfigError
from cell.wire.session import Session
from hil.backend import make_backend
from hil.node import Node
from hil.real_time import prefer_process


def main() -> int:
    """Run a node until told to end; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m hil", description=__doc__)
    parser.add_argument("--backend", default="sim")
    parser.add_argument("--lock-step", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--onions", type=int, default=15)
    parser.add_argument("--person", default="", help="persona of the simulated person; empty: nobody")
    parser.add_argument("--robot-ip", default="", help="address of the real arm's controller")
    parser.add_argument("--cameras", default="", help="of the real arm: real, sim, or a recording")
    args = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the supervisor's to handle
    warnings.showwarning = lambda message, *_: print(f"warning: {message}", file=sys.stderr)
    try:
        config = _read_config()
        backend = make_backend(
            args.backend,
            config,
            seed=args.seed,
            onions=args.onions,
            person=args.person,
            robot_ip=args.robot_ip,
            cameras=args.cameras,
            apart=True,
        )
        if not backend.steppable:
            prefer_process()
        with Session.listen(config, patient=args.lock_step) as session:  # a port in use shows at once
            try:
                backend.connect()
                return _serve(Node(config, backend, session, lock_step=args.lock_step))
            finally:
                backend.close()
    except CellError as error:
        return _say_why(error, 2)


def _serve(node: Node) -> int:
    """Run the node until its parent is gone or SIGTERM; 1 when the backend failed."""

    def on_term(number: int, frame: FrameType | None) -> None:
        del number, frame
        node.end()

    def watch_parent() -> None:
        while os.read(0, 4096):
            pass
        node.end()

    signal.signal(signal.SIGTERM, on_term)
    threading.Thread(target=watch_parent, name="parent", daemon=True).start()
    with suppress(OSError):  # a parent that died meanwhile shows on standard input
        os.write(1, b"ready\n")
    try:
        node.run()
    except BackendError as error:
        return _say_why(error, 1)
    return 0


def _say_why(error: CellError, code: int) -> int:
    print(" ".join(str(error).split()), file=sys.stderr)
    return code


def _read_config() -> CellConfig:
    line = b""
    while not line.endswith(b"\n"):  # unbuffered: the watcher of standard input reads on
        byte = os.read(0, 1)
        if not byte:
            break
        line += byte
    try:
        return from_dict(json.loads(line), "standard input")
    except ValueError:
        raise ConfigError("expected the configuration as one line of JSON on standard input") from None


if __name__ == "__main__":
    sys.exit(main())
