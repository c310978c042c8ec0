"""`cell recover`: from a stop back to a robot that can be driven, step by step and on purpose.

It never starts a program and moves nothing but the brakes. What made the robot stop must be found
and removed by a person first.
"""

from __future__ import annotations

from collections.abc import Callable

from cell.clock import Clock, WallClock
from cell.errors import BackendError
from hil.ur3e.checks import REACH_TIME, remote_problem
from hil.ur3e.dashboard import Dashboard

READY, NOT_READY = 0, 1
"""Exit codes; an unreachable robot raises `BackendError` instead."""
_FINE = ("NORMAL", "REDUCED")
_E_STOPS = ("ROBOT_EMERGENCY_STOP", "SYSTEM_EMERGENCY_STOP", "EMERGENCY_STOP")
_SAFEGUARDS = (
    "SAFEGUARD_STOP",
    "AUTOMATIC_MODE_SAFEGUARD_STOP",
    "SYSTEM_THREE_POSITION_ENABLING_STOP",
    "TP_THREE_POSITION_ENABLING_STOP",
)
_UNLOCK_TRIES, _UNLOCK_PAUSE = 8, 1.0
"""A protective stop can be unlocked five seconds after it, not before."""
_POWER_TIME, _RESTART_TIME = 20.0, 2.0
"""How long powering on, and at least restarting the safety system, takes [s]."""
_STANDING = ("POWER_OFF", "IDLE", "RUNNING")
_POLL = 0.2


class Recovery:
    """One attempt.

    Args:
        say: told every step.
    """

    def __init__(self, dashboard: Dashboard, say: Callable[[str], None], clock: Clock | None = None) -> None:
        self._dashboard, self._say = dashboard, say
        self._clock: Clock = clock or WallClock()

    def run(self) -> int:
        """The sequence; returns `READY` or `NOT_READY`, having said why."""
        if problem := remote_problem(self._dashboard.ask("is in remote control")):
            return self._refuse(problem)
        status = self._safety()
        self._say(f"safety status {status}, robot {self._mode()}")
        if status in _E_STOPS and not self._released():
            return self._refuse("an emergency stop is pressed; release it by hand, then run this again")
        if status in _SAFEGUARDS:
            return self._refuse("a safeguard is open; close and reset it, then run this again")
        self._step("close safety popup")
        if not (self._clear(status) and self._power()):
            return NOT_READY
        status = self._safety()
        if status not in _FINE:
            return self._refuse(f"the safety status is still {status}")
        self._say("ready: start a run, or send arm/resume to the node that waits")
        return READY

    def _released(self) -> bool:
        """A released emergency stop leaves the robot powered off, and its status behind for a moment."""
        return self._wait(lambda: self._safety() not in _E_STOPS, 2.0)

    def _clear(self, status: str) -> bool:
        if status == "PROTECTIVE_STOP":
            for _ in range(_UNLOCK_TRIES):
                answer = self._step("unlock protective stop")
                if self._wait(lambda: self._safety() in _FINE, 0.5):
                    return True
                self._say("a protective stop is unlocked five seconds after it; trying again")
                self._clock.sleep_until(self._clock.now() + _UNLOCK_PAUSE)
            self._refuse(f"the protective stop cannot be unlocked: {answer}")
            return False
        if status in ("FAULT", "VIOLATION"):
            self._step("restart safety")
            self._clock.sleep_until(self._clock.now() + _RESTART_TIME)
            if not self._wait(lambda: self._safety() in _FINE and self._mode() in _STANDING, _POWER_TIME):
                self._refuse(f"the safety system did not start again; its status is {self._safety()}")
                return False
        elif status == "RECOVERY":
            self._refuse("a joint is outside its safety limits; move it back by hand on the pendant")
            return False
        return True

    def _power(self) -> bool:
        """Through power on and brake release to RUNNING, as far as that is needed."""
        if self._mode() not in ("RUNNING", "IDLE"):
            self._step("power on")
            if not self._wait(lambda: self._mode() in ("IDLE", "RUNNING"), _POWER_TIME):
                self._refuse(f"the robot did not power on; it is {self._mode()}")
                return False
        if self._mode() != "RUNNING":
            self._step("brake release")
            if not self._wait(lambda: self._mode() == "RUNNING", _POWER_TIME):
                self._refuse(f"the brakes were not released; the robot is {self._mode()}")
                return False
        return True

    def _step(self, request: str) -> str:
        answer = self._dashboard.ask(request)
        self._say(f"{request}: {answer}")
        return answer

    def _refuse(self, why: str) -> int:
        self._say(f"not recovered: {why}")
        return NOT_READY

    def _safety(self) -> str:
        return self._dashboard.value("safetystatus").upper()

    def _mode(self) -> str:
        return self._dashboard.value("robotmode").upper()

    def _wait(self, there: Callable[[], bool], seconds: float) -> bool:
        end = self._clock.now() + seconds
        while not there():
            if self._clock.now() >= end:
                return False
            self._clock.sleep_until(self._clock.now() + _POLL)
        return True


def recover(robot_ip: str, say: Callable[[str], None]) -> int:
    """Recover the robot at `robot_ip`; returns the exit code 0 or 1.

    Raises:
        BackendError: nobody answers there, or the connection fails on the way.
    """
    try:
        with Dashboard(robot_ip, REACH_TIME) as dashboard:
            return Recovery(dashboard, say).run()
    except BackendError as error:
        raise BackendError(f"{error}; is the controller on and the address right?") from None


def look(robot_ip: str) -> list[tuple[str, str, str]]:
    """(name, problem, note) per thing that `cell doctor --robot-ip` reports; never raises `BackendError`."""
    from hil.ur3e import checks

    rows = []
    for port, what in {**checks.PORTS, 63352: "gripper URCap"}.items():
        problem = checks.port_problem(robot_ip, port)
        rows.append((f"port {port}", f"{what}: {problem}" if problem else "", f"{what} answers"))
    if rows[0][1]:
        return rows
    try:
        with Dashboard(robot_ip, REACH_TIME) as dashboard:
            version = dashboard.ask("PolyscopeVersion")
            model = dashboard.ask("get robot model")
            remote = dashboard.ask("is in remote control")
            safety, mode = dashboard.value("safetystatus"), dashboard.value("robotmode")
    except BackendError as error:
        return [*rows, ("dashboard", str(error), "")]
    return [
        *rows,
        ("version", checks.version_problem(version), version),
        ("model", checks.model_problem(model), model),
        ("remote", checks.remote_problem(remote), "in remote control"),
        ("safety", checks.safety_problem(safety), safety),
        ("robot mode", checks.mode_problem(mode), mode),
    ]
