"""An emulated controller without a cell, in a process of its own, whose buttons tests press.

As a program: `python -m tests.ur3e.arm_process ADDRESS`. It says "ready" and then answers one line per
line of its input: the name of a method of `Buttons` and its arguments.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

from cell.config import load
from hil.emulator.controller import Controller
from hil.emulator.emulator import Emulator
from hil.emulator.interfaces_faults import Delivery, LinkFaults, Server
from hil.emulator.models import model
from hil.emulator.mover import Mover
from hil.emulator.plant import IdealPlant
from hil.emulator.power import Durations
from hil.emulator.programs import recognise
from tests.wire_helpers import until


class Cable:
    """Faults that are switched on and off at will; see `hil.emulator.interfaces_faults.Faults`."""

    def __init__(self) -> None:
        self.silent = self.pulled = False
        self.local = False

    def version(self) -> tuple[int, int, int, int] | None:
        return None

    def remote_control(self) -> bool | None:
        return False if self.local else None

    def in_use(self, name: str) -> bool:
        del name
        return False

    def before_cycle(self, panel: object, now: float) -> float:
        del panel, now
        return 0.0

    def refuse(self, server: Server, peer: str) -> bool:
        del server, peer
        return self.pulled

    def link(self, server: Server, peer: str) -> LinkFaults | None:
        del server, peer
        return _Link(self)


class _Link:
    def __init__(self, cable: Cable) -> None:
        self._cable = cable

    def incoming(self, message: bytes, now: float) -> Sequence[Delivery]:
        return self._pass(message)

    def outgoing(self, message: bytes, now: float) -> Sequence[Delivery]:
        return self._pass(message)

    def _pass(self, message: bytes) -> Sequence[Delivery]:
        return [] if self._cable.silent else [Delivery(message)]

    def cut(self, now: float) -> bool:
        del now
        return self._cable.pulled


class Buttons:
    """What tests may do, on the controller's own thread."""

    def __init__(self, cable: Cable) -> None:
        self._cable = cable

    def protective_stop(self, c: Controller) -> None:
        c.protective_stop("pressed by a test")

    def safeguard(self, c: Controller, open_: bool) -> None:
        c.safeguard_stop(open_)

    def emergency(self, c: Controller, pressed: bool) -> None:
        c.emergency_stop(pressed)

    def fault(self, c: Controller) -> None:
        c.fault("by a test")

    def slider(self, c: Controller, value: float) -> None:
        c.io.speed_slider = value

    def silence(self, c: Controller, on: bool) -> None:
        self._cable.silent = on

    def pull(self, c: Controller, on: bool) -> None:
        self._cable.pulled = on

    def local(self, c: Controller, on: bool) -> None:
        self._cable.local = on

    def state(self, c: Controller) -> dict[str, Any]:
        return {
            "q": c.measured.q.tolist(),
            "qd": c.measured.qd.tolist(),
            "mode": int(c.robot_mode),
            "runtime": int(c.runtime_state),
            "command": c.registers.in_int[0],
            "digital_out": c.io.digital_out,
        }


class ArmProcess:
    """The process; `press` calls a method of `Buttons`."""

    def __init__(self, address: str) -> None:
        self.address = address
        command = [sys.executable, "-m", "tests.ur3e.arm_process", address]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline().strip() == "ready"
        until(lambda: self.press("state")["mode"] == 7, 10.0)

    def press(self, name: str, *args: object) -> Any:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps([name, *args]) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10.0)


def main() -> None:
    arm = model("ur3e")
    cable = Cable()
    plant = IdealPlant(load())
    emulator = Emulator(
        sys.argv[1],
        arm,
        plant,
        mover=Mover(arm),
        recognise=recognise,
        gripper=plant.gripper,
        faults=cable,
        durations=Durations(),
        power_up=True,
    )
    buttons = Buttons(cable)
    emulator.start()
    print("ready", flush=True)
    for line in sys.stdin:
        name, *args = json.loads(line)
        button: Callable[..., Any] = getattr(buttons, name)
        answer = emulator.do(lambda c, press=button, values=args: press(c, *values))  # type: ignore[misc]
        print(json.dumps(answer), flush=True)
    emulator.stop()


if __name__ == "__main__":
    main()
