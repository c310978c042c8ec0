"""The Client Library's external control program, run natively.

It connects back to three ports of the client, takes commands from the reverse interface, and ends
when the client says so or falls silent. From the script's text only addresses and a few numbers are
read.
"""

from __future__ import annotations

import re
from collections.abc import Generator

from cell.errors import BackendError
from hil.emulator.interfaces import PERIOD, Robot
from hil.emulator.urscript import external_commands, external_trajectory
from hil.emulator.urscript import robot as on
from hil.emulator.urscript.external_modes import MOTIONS, Setpoint
from hil.emulator.urscript.external_state import STOP, Mode, Result, Session, Settings, scaled
from hil.emulator.urscript.external_trajectory import STREAMED
from hil.emulator.urscript.link import Link
from hil.emulator.urscript.robot import Wait, retreat, stop

_INTEGERS, _AT_ONCE = 8, 64
"""Of a message, and messages that one cycle has time for; more stay in the socket."""
_ATTEMPTS, _PAUSE = 5, 0.2
_OPENING = 0.02
"""Time that opening a socket takes [s]."""
_RECEIVE, _CANCEL, _STREAM_START, _STREAM_END = 1, -1, 2, 3
_FREEDRIVE_START, _FREEDRIVE_STOP = 1, -1
_SIZES = {
    "REVERSE_INTERFACE_DATA_DIMENSION": "8",
    "TRAJECTORY_DATA_DIMENSION": "3 * 6 + 1",
    "SCRIPT_COMMAND_DATA_DIMENSION": "28",
}
_SOCKET = r"\(\s*\"([^\"]+)\"\s*,\s*(\d+)\s*,\s*\"{}\""


class ExternalControl:
    """The program.

    Attributes:
        name: of its `def` line. settings: from its text.
    """

    def __init__(self, name: str, settings: Settings) -> None:
        self.name, self.settings = name, settings
        self._session: Session | None = None
        self._main: Wait | None = None
        self._moving: Wait | None = None
        self._trajectory: Wait | None = None
        self._setpoint = Setpoint()

    def start(self, robot: Robot) -> None:
        c = self.settings
        self._session = Session(
            robot,
            c,
            Link("reverse_socket", c.host, c.reverse),
            Link("trajectory_socket", c.host, c.trajectory),
            Link("script_command_socket", c.host, c.command),
        )
        if c.voltage is not None:
            on.set_tool_voltage(robot, c.voltage)
        self._main = self._run(self._session)

    def tick(self, robot: Robot) -> bool:
        assert self._session is not None and self._main is not None
        if next(self._main, "over") is not None:
            self._session.close()
            return False
        if self._session.reverse.connected:
            external_commands.serve(self._session)
        if self._trajectory is not None and next(self._trajectory, "over") is not None:
            self._trajectory = None
        if self._moving is not None and next(self._moving, "over") is not None:
            self._moving = None
        return True

    def stop(self, robot: Robot) -> None:
        if self._session is not None:
            self._session.close()

    # -- the reverse interface ------------------------------------------------------------------------

    def _run(self, s: Session) -> Wait:
        if not (yield from _connect(s)):
            return
        s.robot.message("ExternalControl: External control active")
        timeout, since, taken = 0.0, s.robot.now, 0
        while s.mode > Mode.STOPPED:
            if taken == _AT_ONCE:  # a client that writes without a pause does not hold up the controller
                taken = 0
                yield
            message = s.reverse.integers(_INTEGERS)
            if message is None:
                taken = 0
                if s.reverse.lost or (timeout > 0.0 and s.robot.now - since > timeout):
                    s.robot.message(
                        "Socket timed out waiting for command on reverse_socket. The script will exit now.", 2
                    )
                    break
                yield
                continue
            timeout, taken = message[0] / 1000.0, taken + 1
            yield from self._take(s, message)
            if taken == 1 and s.contact and s.mode != Mode.TOOL_IN_CONTACT:
                yield from self._watch_contact(s)
            since = s.robot.now
        self._moving = self._trajectory = None
        s.mode = Mode.STOPPED
        yield from stop(s.mover, STOP, linear=False)
        s.robot.message("ExternalControl: All threads ended")

    def _take(self, s: Session, message: tuple[int, ...]) -> Wait:
        """One message."""
        mode = message[7]
        if mode != s.mode:
            yield from self._leave(s)
            if s.mode != Mode.TOOL_IN_CONTACT or not s.contact:
                s.mode = mode
            if s.mode in MOTIONS:
                self._setpoint = Setpoint(s.robot.measured.q.tolist())
                self._moving = MOTIONS[s.mode](s, self._setpoint)
            elif s.mode == Mode.TORQUE:
                s.robot.message("Torque control is only supported from software 5.23.0 and upwards.", 1)
        if s.mode == Mode.FORWARD:
            yield from self._forward(s, message)
        elif s.mode == Mode.FREEDRIVE:
            if message[1] == _FREEDRIVE_START:
                s.robot.message("Entering freedrive mode")
                s.mover.freedrive([True] * 6)
            elif message[1] == _FREEDRIVE_STOP:
                s.robot.message("Leaving freedrive mode")
                s.mover.stopj(STOP)
        elif s.mode in MOTIONS:
            self._setpoint.take(s, scaled(message[1:7]))

    def _leave(self, s: Session) -> Wait:
        """End what the present mode does; the arm is at rest then."""
        if s.mode == Mode.FORWARD:
            self._trajectory = None
            given_up = s.left > 0
            yield from external_trajectory.clear(s)
            yield from stop(s.mover, STOP, linear=False)
            if given_up:
                s.trajectory.send_integer(Result.CANCELED)
        elif s.mode in MOTIONS or s.mode == Mode.FREEDRIVE:
            self._moving = None
            yield from stop(s.mover, STOP, linear=False)

    def _forward(self, s: Session, message: tuple[int, ...]) -> Wait:
        action, count = message[1], message[2]
        if action in (_RECEIVE, _STREAM_START):
            self._trajectory = None
            yield from external_trajectory.clear(s)
            yield from stop(s.mover, STOP, linear=False)
            s.streaming = action == _STREAM_START
            s.left = STREAMED if s.streaming else count
            s.robot.message(f"Executing trajectory. Number of points: {s.left}")
            self._trajectory = external_trajectory.run(s)
        elif action == _STREAM_END and s.streaming:
            s.left, s.streaming = count - (STREAMED - s.left), False
        elif action == _CANCEL:
            s.robot.message("cancel received")
            self._trajectory = None
            if s.streaming:
                s.left, s.streaming = count - (STREAMED - s.left), False
            yield from external_trajectory.clear(s)
            yield from stop(s.mover, STOP, linear=False)
            s.trajectory.send_integer(Result.CANCELED)

    def _watch_contact(self, s: Session) -> Wait:
        """Look for a contact along the motion of the tool; if there is one, stop and go back to it."""
        steps = s.mover.memory.contact(s.mover.tool_velocity(s.robot.measured))
        if not steps:
            return
        forwarded = s.mode == Mode.FORWARD
        self._moving = self._trajectory = None
        s.mode = Mode.TOOL_IN_CONTACT
        if forwarded:
            yield from external_trajectory.clear(s)
        yield from retreat(s.robot, steps)
        external_commands.contact_found(s)


def _connect(s: Session) -> Generator[None, None, bool]:
    """Connect to all three; says whether it came about."""
    for link in (s.trajectory, s.command, s.reverse):
        for attempt in range(_ATTEMPTS):
            if attempt:
                yield from _wait(_PAUSE)
            while (outcome := link.connect()) is None:
                yield
            if outcome:
                s.robot.message(f"Successfully connected to {link.name}")
                yield from _wait(_OPENING)  # clients count on the order in which they are connected to
                break
        if not link.connected:
            s.robot.message(
                f"Error connecting to remote: {link.name}. Please check that the external control end at "
                f"{s.settings.host} is running correctly.",
                1,
            )
            return False
    return True


def _wait(t: float) -> Wait:
    for _ in range(round(t / PERIOD)):
        yield


def read(name: str, text: str) -> ExternalControl:
    """The program of a script's text.

    Raises:
        BackendError: it is not as the Client Library 2 writes it.
    """
    for constant, size in _SIZES.items():
        found = re.search(rf"^\s*{constant}\s*=\s*([\d *+]+?)\s*$", text, re.MULTILINE)
        if not found or found[1] != size:
            raise BackendError(
                f"{name}: {constant} must be {size}, got {found[1] if found else 'nothing'}; "
                "scripts of the Client Library 2.14 can be run"
            )
    sockets = {}
    for role in ("reverse", "trajectory", "script_command"):
        found = re.search(_SOCKET.format(f"{role}_socket"), text)
        if not found:
            raise BackendError(f"{name}: the script opens no {role}_socket")
        sockets[role] = found[1], int(found[2])
    servo = re.search(r"lookahead_time=([\d.]+), gain=([\d.]+)", text)
    voltage = re.search(r"^\s*set_tool_voltage\((\d+)\)", text[: text.find("steptime =")], re.MULTILINE)
    host = sockets["reverse"][0]
    settings = Settings(
        host,
        sockets["reverse"][1],
        sockets["trajectory"][1],
        sockets["script_command"][1],
        float(servo[1]) if servo else 0.03,
        float(servo[2]) if servo else 2000.0,
        int(voltage[1]) if voltage else None,
    )
    for port in (settings.reverse, settings.trajectory, settings.command):
        Link(name, host, port)  # says what is wrong with an address
    return ExternalControl(name, settings)
