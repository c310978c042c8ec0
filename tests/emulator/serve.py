"""An emulated controller in a process of its own: ur-rtde holds the interpreter while it connects.

As a program: `python -m tests.emulator.serve ADDRESS`; it says "ready", and ends when its input does.
Lines of its input act on it: "stop" triggers a protective stop.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from hil.emulator.emulator import Emulator
from hil.emulator.interfaces import RobotMode
from hil.emulator.models import UR3E
from hil.emulator.mover import Mover
from hil.emulator.power import Durations
from hil.emulator.programs import recognise
from tests.emulator.ideal import IdealPlant
from tests.emulator.rig import until

UNLOCK_AFTER = 0.5
"""Protective stops can be lifted sooner than on a real robot [s]."""


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
    durations = Durations(boot=0.01, power_on=0.01, brake_release=0.01, unlock=UNLOCK_AFTER)
    emulator = Emulator(
        sys.argv[1],
        UR3E,
        IdealPlant(),
        mover=Mover(UR3E),
        recognise=recognise,
        durations=durations,
        power_up=True,
    )
    emulator.start()
    until(emulator, lambda c: c.robot_mode is RobotMode.RUNNING)
    print("ready", flush=True)
    for line in sys.stdin:
        if line.strip() == "stop":
            emulator.do(lambda c: c.protective_stop("asked for by the test"))
    emulator.stop()
    cycles, skipped = emulator.timing
    print(f"{cycles} cycles, {skipped} left out", flush=True)


if __name__ == "__main__":
    main()
