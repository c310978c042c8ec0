"""What the driver's loop needs of a robot, and how ur-rtde provides it.

Only this module knows ur-rtde. `read`, `servo`, `kick` and `outputs` return within microseconds;
the others talk to the control program on the controller and may take seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from cell.clock import WallClock
from cell.errors import BackendError
from hil.real_time import ask_for_real_time, threads
from hil.ur3e.block import Six
from hil.ur3e.conditions import PLAYING

PERIOD = 0.002
"""The controller's cycle [s]."""
_FIELDS = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "target_moment",
    "robot_mode",
    "safety_mode",
    "safety_status_bits",
    "runtime_state",
    "speed_scaling",
    "target_speed_fraction",
    "robot_status_bits",
    "actual_digital_output_bits",
]
_LEAST_RATE = 10.0
"""The control program ends by itself when nothing comes from here this often [Hz]."""
_PRIORITY = 3
"""Of the threads that receive packets, where the system grants it."""
_START = 5.0
"""How long the control program may take to run [s]."""


@dataclass(frozen=True)
class Packet:
    """One state packet; see `hil.ur3e.block.Measured`."""

    stamp: float
    q: Six
    qd: Six
    effort: Six
    robot_mode: int
    safety_mode: int
    safety_bits: int
    runtime: int
    scaling: float


class ArmLink(Protocol):
    """A connected controller."""

    def read(self) -> Packet:
        """The newest packet; raises RuntimeError when the connection is gone."""
        ...

    def servo(self, q: Six) -> bool:
        """Next set-point [rad] of the running control program; False when it was not taken."""
        ...

    def kick(self) -> None:
        """Keep the control program alive without moving."""
        ...

    def outputs(self, bits: int, mask: int) -> None:
        """Set the standard digital outputs in `mask`."""
        ...

    def start(self) -> str:
        """Run the control program and tell it payload and TCP; why that failed, else empty."""
        ...

    def brake(self) -> None:
        """Stop the motion, then end the control program; the arm stays where it stops."""
        ...

    def close(self) -> None: ...


class UrRtde:
    """An `ArmLink` by ur-rtde; the constructor uploads the control program.

    Args:
        robot_ip: of the controller.
        lookahead, gain: of servoj. deceleration: of the tool when braking [m/s^2].
        payload, cog: on the flange [kg], [m]. tcp: position [m] and axis-angle [rad] in the flange.

    Raises:
        BackendError: ur-rtde is not installed, or the controller did not play along.
    """

    def __init__(
        self,
        robot_ip: str,
        *,
        lookahead: float,
        gain: float,
        deceleration: float,
        payload: float,
        cog: tuple[float, float, float],
        tcp: Six,
    ) -> None:
        try:
            from rtde_control import RTDEControlInterface
            from rtde_io import RTDEIOInterface
            from rtde_receive import RTDEReceiveInterface
        except ImportError as error:
            raise BackendError(
                f"the real arm needs ur-rtde ({error}); install it with: pip install 'sorting-cell[ur3e]'"
            ) from None
        self._lookahead, self._gain, self._deceleration = lookahead, gain, deceleration
        self._payload, self._cog, self._tcp = payload, list(cog), list(tcp)
        self._clock = WallClock()
        rate = 1.0 / PERIOD
        try:
            self._receive: Any = RTDEReceiveInterface(robot_ip, rate, _FIELDS)
            self._control: Any = RTDEControlInterface(robot_ip, rate)
            self._io: Any = RTDEIOInterface(robot_ip)
        except RuntimeError as error:
            raise BackendError(f"{robot_ip}: {_one_line(error)}") from None
        for thread in threads():  # the library's own, which receive packets
            ask_for_real_time(_PRIORITY, thread)

    def read(self) -> Packet:
        r = self._receive
        for _ in range(3):  # a packet that comes in between would mix two
            stamp = r.getTimestamp()
            packet = Packet(
                stamp,
                tuple(r.getActualQ()),
                tuple(r.getActualQd()),
                tuple(r.getTargetMoment()),
                r.getRobotMode(),
                r.getSafetyMode(),
                r.getSafetyStatusBits(),
                r.getRuntimeState(),
                r.getSpeedScaling() * r.getTargetSpeedFraction(),
            )
            if r.getTimestamp() == stamp:
                break
        return packet

    def servo(self, q: Six) -> bool:
        return bool(self._control.servoJ(list(q), 0.5, 0.5, PERIOD, self._lookahead, self._gain))

    def kick(self) -> None:
        self._control.kickWatchdog()

    def outputs(self, bits: int, mask: int) -> None:
        for bit in range(8):
            if mask >> bit & 1:
                self._io.setStandardDigitalOut(bit, bool(bits >> bit & 1))

    def start(self) -> str:
        control = self._control
        try:
            if not control.isConnected():
                return "the connection to the controller is gone"
            if self.read().runtime != PLAYING and not control.reuploadScript():
                return "the control program could not be sent"
            end = self._clock.now() + _START
            while self.read().runtime != PLAYING:
                if self._clock.now() > end:
                    return f"the control program did not run within {_START:g} s"
                self._clock.sleep_until(self._clock.now() + 0.01)
            if not control.setPayload(self._payload, self._cog):
                return f"the payload of {self._payload:g} kg was not taken"
            if not control.setTcp(self._tcp):
                return "the TCP was not taken"
            active = control.getTCPOffset()
            if len(active) != 6 or max(abs(a - b) for a, b in zip(active, self._tcp, strict=True)) > 1e-4:
                return f"the controller's TCP is {active}, not {self._tcp}"
            if not control.setWatchdog(_LEAST_RATE):
                return "the watchdog of the control program could not be set"
        except RuntimeError as error:
            return _one_line(error)
        return ""

    def brake(self) -> None:
        if self.read().runtime == PLAYING:
            self._control.servoStop(self._deceleration)
            self._control.stopScript()

    def close(self) -> None:
        for part in (self._control, self._io, self._receive):
            part.disconnect()


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
