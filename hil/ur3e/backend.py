"""The real arm: a `hil.backend.Backend` on a UR3e, its gripper and its cameras.

The arm's driver is a process of its own (`hil.ur3e.driver`); gripper and cameras have threads of
their own. Nothing here waits but `connect`, `close` and the real cycle in `advance`. After any stop
of the robot set-points go nowhere until `prepare` and `enable`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import BackendError, CellError, RefusedError
from cell.limits import RefusalCode
from cell.wire.types import ArmStatus, Array, BeltState, CameraInfo, Frame, GripperState, JointState, Truth
from hil.ur3e import checks
from hil.ur3e.block import Measured
from hil.ur3e.camera_set import Cameras, CamerasApart, CameraSet
from hil.ur3e.cameras import make_surroundings
from hil.ur3e.conditions import SILENCE, condition, robot_condition
from hil.ur3e.driver import Driver
from hil.ur3e.lamp import lamp_bits
from hil.ur3e.robotiq import Gripper

INFO, WARN, ERROR = 20, 30, 40
_ARM_TIME = 15.0
"""How long the control program may take to start [s]."""
_PACKETS_BAD = 25
"""Packets lost or late within a second that people should know of: 5 %."""


class Ur3eBackend:
    """See `hil.backend.Backend`; also `NeedsArming`, `TellsNews` and `KnowsTruth` there.

    Args:
        robot_ip: address of the controller; empty: as configured.
        cameras: "real", "sim" (those of an emulated controller's surroundings), or a recording.
        seed, onions, person: the batch and the persona of simulated surroundings.
        apart: the cameras publish their frames themselves, from a process of their own, on the wire of
            `config`, which must be open; `take_frames` is empty then.
    """

    name = "ur3e"
    steppable = False

    def __init__(
        self,
        config: CellConfig,
        robot_ip: str,
        cameras: str = "real",
        *,
        seed: int = 0,
        onions: int = 15,
        person: str = "",
        apart: bool = False,
    ) -> None:
        self._config, self._cameras_from = config, cameras
        self._batch = (seed, onions, person)
        self._robot_ip = checks.robot_address(config, robot_ip)
        self._clock = WallClock()
        self._period = config.arm.control_period
        self._driver = Driver(config, self._robot_ip, self._clock)
        self._gripper = Gripper(config, self._robot_ip, self._clock)
        eyes = CamerasApart if apart else CameraSet
        self._cameras: Cameras = eyes(cameras, config, self._robot_ip, self._clock)
        self._sample: Measured | None = None
        self._begin = self._t = 0.0
        self._ticks = 0
        self._epoch = 0
        self._follow = False
        self._arming: threading.Thread | None = None
        self._arming_problem = ""
        self._news: list[tuple[int, str]] = []
        self._late = self._cycles = 0
        self._worst = 0.0
        self._bad_packets = (0.0, 0)
        self.first_motion_speed = config.ur3e.first_motion_speed
        self._end_surroundings: Callable[[], None] | None = None
        self.truth: Callable[[], Truth] | None = None

    # -- life cycle -----------------------------------------------------------------------------

    def connect(self) -> None:
        if self._sample is not None:
            return
        checks.check_clock(self._cameras_from)
        checks.check_reachable(self._robot_ip)
        checks.check_controller(self._robot_ip)
        try:
            if self._cameras_from == "sim":
                surroundings = make_surroundings(self._config, self._robot_ip)
                self._end_surroundings, self.truth = surroundings.close, surroundings.truth
                surroundings.reset(*self._batch)
            self._cameras.connect()
            self._gripper.connect()
            self._driver = Driver(self._config, self._robot_ip, self._clock)
            self._driver.start()
            checks.check_state(self._newest())
            self._arm()
        except BaseException:
            self.close()
            raise
        self._sample = self._newest()
        self._begin = self._t = self._clock.now()
        self._ticks = 0
        self._follow = True

    def close(self) -> None:
        self._follow = False
        if self._arming is not None:
            self._arming.join(_ARM_TIME)
            self._arming = None
        self._driver.close()
        self._gripper.close()
        self._cameras.close()
        if self._end_surroundings is not None:
            self._end_surroundings()
            self._end_surroundings = self.truth = None
        self._sample = None

    # -- time and commands ------------------------------------------------------------------------

    def now(self) -> float:
        self._connected()
        return self._t

    def command_joints(self, q: Array, qd: Array) -> None:
        if self._follow:
            self._driver.follow(self._epoch, self._t + self._period, q, qd)

    def command_gripper(self, width: float, speed: float, force: float) -> tuple[float, float, float]:
        self._connected()
        return self._gripper.command(width, speed, force)

    def command_light(self, signal: str) -> None:
        self._driver.lamp(lamp_bits(signal))

    def command_belt(self, onions: int, seed: int) -> None:
        del onions, seed
        raise BackendError("the belt stands still and is filled by hand; start a new run for a new batch")

    def advance(self) -> None:
        """Wait for the next cycle; a late one is made up for, as long as the driver bridges the gap."""
        self._connected()
        self._ticks += 1
        self._t = self._begin + self._ticks * self._period
        self._clock.sleep_until(self._t)
        delay = self._clock.now() - self._t
        self._cycles += 1
        if delay > 0.5 * self._period:
            self._late += 1
            self._worst = max(self._worst, delay)
        if delay > self._config.ur3e.patience:
            self._ticks += int(delay / self._period)
            self._t = self._begin + self._ticks * self._period
        self._sample = self._newest()
        if self._follow and self._problem():
            self._follow = False

    # -- measurements -----------------------------------------------------------------------------

    def read_joints(self) -> JointState:
        m = self._connected()
        return JointState(m.t, np.array(m.q), np.array(m.qd), np.array(m.effort))

    def read_status(self) -> ArmStatus:
        self._connected()
        m = self._sample = self._newest()
        return ArmStatus(
            self._t,
            robot_mode=m.robot_mode,
            safety_mode=m.safety_mode,
            speed_scaling=m.scaling,
            stop_reason=self._problem(),
        )

    def read_gripper(self) -> GripperState:
        return self._gripper.state()

    def read_belt(self) -> BeltState:
        return BeltState(self.now(), 1, moving=False, speed=0.0)

    def camera_info(self, camera: str) -> CameraInfo:
        self._connected()
        return self._cameras.info(camera)

    def request_frame(self, camera: str) -> None:
        self._connected()
        self._cameras.request(camera)

    def take_frames(self) -> list[Frame]:
        return self._cameras.take()

    def news(self) -> list[tuple[int, str]]:
        """What driver, gripper and cameras have to say."""
        self._count_packets()
        out, self._news = self._news, []
        out += [(WARN, f"arm driver: {text}") for text in self._driver.news()]
        out += [(ERROR, text) for text in self._cameras.news()]
        return out + [(WARN, text) for text in self._gripper.news()]

    def timing(self) -> str:
        """How well the cycles were kept, in one line."""
        m = self._connected()
        return (
            f"node: {self._late} of {self._cycles} cycles late, at most {self._worst * 1e3:.1f} ms; "
            f"driver: {m.late} of {m.cycles} late, at most {m.worst * 1e3:.1f} ms, "
            f"{m.lost} packets lost, {m.delayed} late"
        )

    # -- arming -----------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Start the control program again if it does not run; see `NeedsArming`."""
        m = self._connected()
        if self._arming is not None:
            if self._arming.is_alive():
                raise RefusedError(RefusalCode.BUSY.value, "the control program is being started; ask again")
            self._arming = None
            if self._arming_problem:
                raise RefusedError(RefusalCode.BACKEND.value, self._arming_problem)
            self._sample = m = self._newest()
        hears = self._clock.now() - m.heard <= SILENCE
        if not self._problem() or (hears and robot_condition(m.safety_mode, m.safety_bits, m.robot_mode)):
            return  # ready, or not for us to mend: the node refuses by the condition's name
        self._arming_problem = ""
        self._arming = threading.Thread(target=self._arm_again, name="arming", daemon=True)
        self._arming.start()
        raise RefusedError(RefusalCode.BUSY.value, "the control program is being started; ask again")

    def enable(self) -> None:
        """Send set-points again; they start at the measured joints."""
        if not self._problem():
            self._follow = True

    def _arm_again(self) -> None:
        """With a new driver: what the old one left in the controller's registers is cleared by that."""
        try:
            checks.check_reachable(self._robot_ip)
            checks.check_controller(self._robot_ip)
            self._driver.close()
            driver = Driver(self._config, self._robot_ip, self._clock)
            driver.start()
            self._driver = driver
            self._arm()
        except CellError as error:
            self._arming_problem = str(error)

    def _arm(self) -> None:
        """Let the driver start the control program; raises `BackendError` when it does not run."""
        self._epoch += 1
        driver, end = self._driver, self._clock.now() + _ARM_TIME
        driver.arm(self._epoch)
        while driver.alive() and self._clock.now() < end:
            measured = driver.measured()
            if measured is not None and measured.armed == self._epoch:
                return
            if measured is not None and measured.failed == self._epoch:
                break
            self._clock.sleep_until(self._clock.now() + 0.005)
        words = driver.news()
        raise BackendError(words[-1] if words else "the control program could not be started")

    # -- internals --------------------------------------------------------------------------------

    def _connected(self) -> Measured:
        if self._sample is None:
            raise BackendError("the robot is not connected; call connect() first")
        return self._sample

    def _newest(self) -> Measured:
        measured = self._driver.measured()
        return self._connected() if measured is None else measured

    def _problem(self) -> str:
        return condition(self._sample, self._clock.now(), self._epoch)

    def _count_packets(self) -> None:
        m = self._connected()
        since, before = self._bad_packets
        if m.beat - since >= 1.0:
            bad = m.lost + m.delayed
            if not since and m.scaling < 0.99:
                text = f"the speed slider stands at {m.scaling * 100:.0f} %"
                self._news.append((WARN, f"{text}: no motion can be changed on its way until it is at 100 %"))
            if since and bad - before > _PACKETS_BAD:
                self._news.append((WARN, f"{bad - before} packets of the robot lost or late within a second"))
            self._bad_packets = m.beat, bad
