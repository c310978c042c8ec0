"""`cell emulate`: one emulated controller with its cell, until it is told to end."""

from __future__ import annotations

import gc
import ipaddress
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from cell.clock import WallClock, perf_s
from cell.config import CellConfig
from cell.errors import BackendError, ConfigError
from hil.emulator.emulator import Emulator
from hil.emulator.faults import make_faults
from hil.emulator.interfaces import RobotMode
from hil.emulator.mirror import check_surroundings
from hil.emulator.models import Model, model
from hil.emulator.mover import Mover
from hil.emulator.plant import IdealPlant, WorldPlant
from hil.emulator.programs import recognise
from hil.emulator.shelf import Shelf
from hil.emulator.surroundings import Surroundings
from hil.emulator.world_link import WORLD_PORT
from hil.real_time import ask_for_real_time

_LOOK = 0.1
"""How often it is looked whether everything still runs [s]."""
_SWITCH = 0.0005
"""Longest that the gripper's thread keeps the interpreter from the controller's [s]."""
_PRIORITY = 1
_POWER_UP_TIME, _FAULTY_TIME = 20.0, 6.0
"""How long the arm may take to power up, without faults and with them [s]."""


@dataclass(frozen=True)
class EmulateOptions:
    """What to emulate.

    Attributes:
        listen: IPv4 address of this machine; all ports are the controller's true ones.
        model: "ur3e" or "ur5e".
        seed, onions, persona: the simulated cell around it; persona "": nobody.
        faults: as in `fault_syntax`.
        running: power on, release the brakes, before it is said to be ready.
        bare: no cell around the arm, no physics.
        linked: standard input belongs to the program that started it; its end is the emulator's, too.
        programs: folder of what the dashboard can load; see `Shelf`.
    """

    listen: str = "127.0.0.2"
    model: str = "ur3e"
    seed: int = 0
    onions: int = 15
    persona: str = ""
    faults: tuple[str, ...] = ()
    running: bool = True
    bare: bool = False
    linked: bool = False
    programs: Path | None = None


def emulate(config: CellConfig, options: EmulateOptions, say: Callable[[str], None]) -> None:
    """Run until Ctrl-C, SIGTERM or the end of what it is linked to, then end everything that was started.

    Args:
        say: told the line that says it is ready, and the last one.

    Raises:
        CellError: it could not start, or ended by itself.
    """
    check_surroundings(options.seed, options.onions, options.persona)
    check_address(options.listen)
    arm, faults = model(options.model), make_faults(options.faults, options.seed)
    shelf = Shelf(options.programs)
    bare = options.bare or options.model != "ur3e"  # the simulated cell is built around a UR3e
    with ExitStack() as stack:
        told = stack.enter_context(_told_to_end(options.linked))
        surroundings: Surroundings | None = None
        plant: IdealPlant | WorldPlant
        if bare:
            plant = IdealPlant(config)
        else:
            surroundings = Surroundings(config, options.listen, options.seed, options.onions, options.persona)
            stack.callback(surroundings.close)
            plant = WorldPlant(config, surroundings.exchange)
        emulator = Emulator(
            options.listen, arm, plant, mover=Mover(arm), recognise=recognise, gripper=plant.gripper,
            faults=faults, find=shelf, power_up=options.running,
        )  # fmt: skip
        stack.callback(emulator.stop)
        emulator.start()
        gc.freeze()  # the world's many objects live as long as the process: no need to look at them
        sys.setswitchinterval(_SWITCH)
        ask_for_real_time(_PRIORITY)  # this thread only waits, but needs the interpreter's lock for it
        if surroundings is not None:
            surroundings.wait_ready(told)
        if options.running:
            _await_running(emulator, told, bool(options.faults))
        say(_ready(arm, emulator, options, with_cell=not bare))
        while not told():
            _look(emulator, surroundings)
    cycles, skipped = emulator.timing
    say(f"ended after {cycles} cycles; {skipped} more were left out because the machine was late")


def check_address(listen: str) -> None:
    """Raises `ConfigError` unless it is an IPv4 address to listen on."""
    try:
        address = ipaddress.IPv4Address(listen)
    except ValueError:
        raise ConfigError(
            f"--listen must be an IPv4 address of this machine, e.g. 127.0.0.2, got {listen!r}"
        ) from None
    if address.is_multicast or address.is_unspecified:
        raise ConfigError(f"--listen must be one address, e.g. 127.0.0.2, got {listen}")


def _ready(arm: Model, emulator: Emulator, options: EmulateOptions, with_cell: bool) -> str:
    ports = emulator.ports
    cell = f", surroundings {WORLD_PORT}" if with_cell else ""
    return (
        f"{options.model} emulated at {options.listen}: dashboard {ports.dashboard}, "
        f"primary {ports.primary}, secondary {ports.secondary}, realtime {ports.realtime}, "
        f"rtde {ports.rtde}, gripper {ports.gripper}{cell}; Ctrl-C ends it"
    )


def _await_running(emulator: Emulator, told: Callable[[], bool], faulty: bool) -> None:
    """Wait until the arm is powered up; one with faults may never be, and is ready all the same."""
    end = perf_s() + (_FAULTY_TIME if faulty else _POWER_UP_TIME)
    while emulator.do(lambda controller: controller.robot_mode) is not RobotMode.RUNNING and not told():
        _look(emulator, None)
        if perf_s() > end:
            if faulty:
                return
            raise BackendError(f"the emulated controller did not power up within {_POWER_UP_TIME:g} s")


def _look(emulator: Emulator, surroundings: Surroundings | None) -> None:
    """Wait a little; raises `BackendError` when something ended by itself."""
    clock = WallClock()
    clock.sleep_until(clock.now() + _LOOK)
    if emulator.wait(0.0):
        raise BackendError(f"the emulated controller failed: {emulator.failure}")
    if surroundings is not None and not surroundings.alive:
        raise BackendError(f"the simulated surroundings ended: {surroundings.last_words()}")


@contextmanager
def _told_to_end(linked: bool) -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or SIGTERM came, or standard input ended, if `linked`.

    Nothing is interrupted: a thread's `join` would not survive it.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        del frame
        came.append(number)

    def read() -> None:
        while sys.stdin.read(4096):
            pass
        came.append(0)

    if linked:
        threading.Thread(target=read, name="link", daemon=True).start()

    before = {each: signal.signal(each, note) for each in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(came)
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
