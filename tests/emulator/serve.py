"""An emulated controller in a process of its own: ur-rtde holds the interpreter while it connects.

As a program: `python -m tests.emulator.serve ADDRESS`; it says "ready", and ends when its input does.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from hil.emulator.emulator import Emulator
from hil.emulator.models import UR3E
from tests.emulator.ideal import QUICK, IdealMover, IdealPlant, recognise


@contextmanager
def served(address: str) -> Iterator[subprocess.Popen[str]]:
    """On the ports that clients have built in."""
    command = [sys.executable, "-m", "tests.emulator.serve", address]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            assert process.stdout.readline().strip() == "ready"
            yield process
        finally:
            process.stdin.close()
            process.wait(10)


def main() -> None:
    plant = IdealPlant()
    emulator = Emulator(
        sys.argv[1], UR3E, plant, mover=IdealMover(), recognise=recognise, durations=QUICK, power_up=True
    )
    emulator.start()
    print("ready", flush=True)
    sys.stdin.read()
    emulator.stop()
    cycles, skipped = emulator.timing
    print(f"{cycles} cycles, {skipped} left out", flush=True)


if __name__ == "__main__":
    main()
