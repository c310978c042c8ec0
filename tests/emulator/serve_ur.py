"""As `serve`, with the controller's own mover and programs: `python -m tests.emulator.serve_ur ADDRESS`."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from hil.emulator.emulator import Emulator
from hil.emulator.models import UR3E
from hil.emulator.mover import Mover
from hil.emulator.programs import recognise
from tests.emulator.ideal import QUICK, IdealPlant

_UNLOCKED_SOON = replace(QUICK, unlock=0.5)


@contextmanager
def served(address: str) -> Iterator[subprocess.Popen[str]]:
    """On the ports that clients have built in, powered on."""
    command = [sys.executable, "-m", "tests.emulator.serve_ur", address]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            assert process.stdout.readline().strip() == "ready"
            yield process
        finally:
            process.stdin.close()
            process.wait(10)


def main() -> None:
    plant, mover = IdealPlant(), Mover(UR3E)
    emulator = Emulator(
        sys.argv[1], UR3E, plant, mover=mover, recognise=recognise, durations=_UNLOCKED_SOON, power_up=True
    )
    emulator.start()
    print("ready", flush=True)
    sys.stdin.read()
    emulator.stop()


if __name__ == "__main__":
    main()
