"""`python -m cell.view`: the view that `cell run --view` starts beside itself.

It reads the configuration as one line of JSON from standard input, prints the page's address when it
can be opened and then how many browsers show it, and ends when standard input closes. A page that is
slow, or dies, is nobody's concern.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
from contextlib import suppress

from cell.config import from_dict
from cell.errors import CellError, ConfigError, WireError
from cell.view.child import ADDRESS, WATCHED
from cell.view.live import LiveSource
from cell.view.serve import serve
from cell.view.web import HOST

_NICE = 10
_TRY = 2.0
"""How long one attempt to find the cell takes [s]."""


def main() -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m cell.view", description=__doc__)
    parser.add_argument("--port", type=int, required=True)
    args = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the round's to handle
    os.nice(_NICE)
    ended = threading.Event()
    try:
        try:
            config = from_dict(json.loads(sys.stdin.readline()), "standard input")
        except ValueError:
            raise ConfigError("expected the configuration as one line of JSON") from None

        def watch_parent() -> None:
            while sys.stdin.read(4096):
                pass
            ended.set()

        threading.Thread(target=watch_parent, name="parent", daemon=True).start()

        def source() -> LiveSource:
            print(f"{ADDRESS}{HOST}:{args.port}", flush=True)
            while True:
                try:
                    return LiveSource(config, _TRY)
                except WireError:
                    if ended.is_set():
                        raise

        def count(browsers: int) -> None:
            with suppress(OSError):  # whoever reads it may be gone
                print(f"{WATCHED}{browsers}", flush=True)

        serve(config, args.port, source, lambda address: None, ended.is_set, count)
    except CellError as error:
        if not ended.is_set():
            print(" ".join(str(error).split()), file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
