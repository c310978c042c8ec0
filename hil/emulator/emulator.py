"""One emulated controller with all its servers, running on a thread of its own.

Clients that hold the interpreter while they connect (ur-rtde does) need it in another process.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from cell.clock import Clock, WallClock
from cell.errors import BackendError, CellError
from hil.emulator.controller import Controller
from hil.emulator.interfaces import PERIOD, GripperPlant, MoverLike, Plant, Program
from hil.emulator.interfaces_faults import Faults, NoFaults, Server
from hil.emulator.models import Model
from hil.emulator.outputs import Outputs
from hil.emulator.power import Durations
from hil.emulator.safety import SafetyIo
from hil.emulator.servers.dashboard import Dashboard
from hil.emulator.servers.primary import Primary, Realtime
from hil.emulator.servers.robotiq import RobotiqServer
from hil.emulator.servers.rtde import RtdeServer
from hil.emulator.servers.server import Loop, Welcome

_log = logging.getLogger("hil.emulator")
_T = TypeVar("_T")
_RTDE_PATIENCE = 10.0
"""The controller drops an RTDE client that does not read for this long [s]."""
_ANSWER_TIME = 5.0
_END_TIME = 5.0


@dataclass(frozen=True)
class Ports:
    """Where the servers listen; 0 asks for a free port."""

    dashboard: int = 29999
    primary: int = 30001
    secondary: int = 30002
    realtime: int = 30003
    rtde: int = 30004
    gripper: int = 63352


FREE_PORTS = Ports(0, 0, 0, 0, 0, 0)


class Emulator:
    """Wires a controller to its servers.

    Args:
        listen: IPv4 address to serve on. Clients with fixed ports need one address per controller.
        plant: the arm; the emulator's from now on, closed by `stop`.
        mover, recognise, find: see `Controller`, as for the rest of the arguments.
        gripper: served on its port; None: no gripper.
        real_time: ask the system for real-time scheduling of the controller's thread; where it is
            not granted, a busy machine makes cycles late.

    Attributes:
        controller: only its own thread may touch it while it runs, see `do`.
        ports: as served; those that were 0 are known after `start`.
        failure: why the controller ended by itself; empty if it did not.
    """

    def __init__(
        self,
        listen: str,
        model: Model,
        plant: Plant,
        *,
        mover: MoverLike,
        recognise: Callable[[str, str], Program],
        gripper: GripperPlant | None = None,
        faults: Faults | None = None,
        ports: Ports | None = None,
        durations: Durations | None = None,
        safety_io: SafetyIo | None = None,
        find: Callable[[str, str], Program] | None = None,
        power_up: bool = False,
        real_time: bool = True,
        clock: Clock | None = None,
    ) -> None:
        self._real_time = real_time
        self._listen, self._plant, self._gripper = listen, plant, gripper
        self._faults: Faults = faults or NoFaults()
        self._clock: Clock = clock or WallClock()
        self.ports = ports or Ports()
        self.failure = ""
        self.controller = Controller(
            model,
            plant,
            mover,
            recognise,
            durations=durations,
            safety_io=safety_io,
            find=find,
            power_up=power_up,
        )
        self._born = 0.0
        self._loop: Loop | None = None
        self._thread: threading.Thread | None = None
        self._gripper_server: RobotiqServer | None = None
        self._closed = False

    def start(self) -> None:
        """Serve; returns when all ports can be connected to.

        Raises:
            BackendError: a port cannot be had.
        """
        loop = Loop(self._cycle, PERIOD, self._clock, self._faults)
        try:
            found = {
                server.value: loop.listen(server, (self._listen, port), welcome, patience)
                for server, (port, welcome, patience) in self._servers().items()
            }
            found["gripper"] = self._serve_gripper()
        except CellError:
            loop.end()
            loop.run()  # frees what it has got
            raise
        self.ports = Ports(**found)
        self._loop, self._born = loop, self._clock.now()
        self._thread = threading.Thread(target=self._run, args=(loop,), name="controller", daemon=True)
        self._thread.start()

    def do(self, function: Callable[[Controller], _T]) -> _T:
        """Let the controller's own thread call this with the controller, and wait for the answer.

        Raises:
            BackendError: the controller does not run, or does not answer.
        """
        if self._loop is None or self._thread is None or not self._thread.is_alive():
            raise BackendError(f"the controller does not run: {self.failure or 'start it first'}")
        try:
            return self._loop.call(lambda: function(self.controller)).result(_ANSWER_TIME)
        except TimeoutError as error:
            raise BackendError(f"the controller did not answer within {_ANSWER_TIME:.0f} s") from error

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until the controller has ended, at most so long [s]; whether it has."""
        if self._thread is not None:
            self._thread.join(seconds)
        return self._thread is None or not self._thread.is_alive()

    def stop(self) -> None:
        """Close all connections and the plant; harmless when repeated."""
        if self._gripper_server is not None:
            self._gripper_server.stop()
            self._gripper_server = None
        if self._loop is not None:
            self._loop.end()
        if self.wait(_END_TIME) and not self._closed:
            self._closed = True
            self._plant.close()

    @property
    def timing(self) -> tuple[int, int]:
        """(cycles, cycles left out because the machine was late)."""
        return (self._loop.cycles, self._loop.skipped) if self._loop is not None else (0, 0)

    # -- internals --------------------------------------------------------------------------------

    def _servers(self) -> dict[Server, tuple[int, Welcome, float | None]]:
        """Port, who welcomes clients, and how long one may not read."""
        controller, faults, ports = self.controller, self._faults, self.ports
        outputs = Outputs(controller)
        primary = Primary(controller, outputs, faults, messages=True)
        secondary = Primary(controller, outputs, faults, messages=False)
        return {
            Server.DASHBOARD: (ports.dashboard, Dashboard(controller, faults).welcome, None),
            Server.PRIMARY: (ports.primary, primary.welcome, None),
            Server.SECONDARY: (ports.secondary, secondary.welcome, None),
            Server.REALTIME: (ports.realtime, Realtime(controller, outputs).welcome, None),
            Server.RTDE: (ports.rtde, RtdeServer(controller, outputs, faults).welcome, _RTDE_PATIENCE),
        }

    def _serve_gripper(self) -> int:
        if self._gripper is None:
            return self.ports.gripper
        self._gripper_server = RobotiqServer(
            self._listen, self._gripper, self._faults, port=self.ports.gripper, clock=self._clock
        )
        self._gripper_server.start()
        return self._gripper_server.port

    def _run(self, loop: Loop) -> None:
        if self._real_time:
            _ask_for_real_time()
        try:
            loop.run()
        except Exception as error:
            self.failure = f"{type(error).__name__}: {error}"
            _log.exception("the controller failed")

    def _cycle(self) -> float:
        start = self._clock.now()
        now = start - self._born  # not the controller's time, which a slow controller stretches
        late = self._faults.before_cycle(self.controller, now)
        self.controller.tick()
        if late > 0.0:
            self._clock.sleep_until(start + late)  # a slow controller serves nobody meanwhile
        self.controller.execution_time = self._clock.now() - start
        return now


def _ask_for_real_time() -> None:
    """For the calling thread only; what it starts is scheduled as usual."""
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
