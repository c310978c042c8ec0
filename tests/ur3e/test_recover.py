"""`cell recover` against a dashboard that behaves like a controller after each kind of stop."""

from __future__ import annotations

import pytest

from cell.clock import StepClock
from cell.errors import BackendError
from hil.ur3e.dashboard import Dashboard
from hil.ur3e.recover import Recovery, look, recover
from tests.test_cli import cell
from tests.ur3e.fakes import LineServer


class Controller:
    """Just enough of one: power, brakes, safety status, and the five seconds after a protective stop."""

    def __init__(self, safety: str = "NORMAL", mode: str = "RUNNING", remote: bool = True) -> None:
        self.safety, self.mode, self.remote = safety, mode, remote
        self.locked_tries = 2
        self.asked: list[str] = []

    def answer(self, request: bytes) -> bytes:
        text = request.decode().strip()
        self.asked.append(text)
        return (self._answer(text) + "\n").encode()

    def _answer(self, text: str) -> str:
        if text == "is in remote control":
            return str(self.remote).lower()
        if text == "safetystatus":
            return f"Safetystatus: {self.safety}"
        if text == "robotmode":
            return f"Robotmode: {self.mode}"
        if text == "unlock protective stop":
            if self.locked_tries:
                self.locked_tries -= 1
                return "Cannot unlock protective stop until 5s after occurrence. Always inspect cause"
            self.safety = "NORMAL"
            return "Protective stop releasing"
        if text == "restart safety":
            self.safety, self.mode = "NORMAL", "POWER_OFF"
            return "Restarting safety"
        if text == "power on":
            self.mode = "IDLE"
            return "Powering on"
        if text == "brake release":
            self.mode = "RUNNING"
            return "Brake releasing"
        return text.replace("close", "closing")


class QuickClock(StepClock):
    """Time passes by waiting, at once."""

    def __init__(self) -> None:
        super().__init__(1.0)
        self.t = 0.0

    def now(self) -> float:
        self.t += 0.01
        return self.t

    def sleep_until(self, t: float) -> None:
        self.t = max(self.t, t)


def run(controller: Controller) -> tuple[int, list[str]]:
    said: list[str] = []
    with (
        LineServer(controller.answer, b"Connected\n") as server,
        Dashboard("127.0.0.1", 2.0, server.port) as dashboard,
    ):
        code = Recovery(dashboard, said.append, QuickClock()).run()
    return code, said


def test_a_protective_stop_is_unlocked_when_its_five_seconds_are_over() -> None:
    controller = Controller("PROTECTIVE_STOP")
    code, said = run(controller)
    assert code == 0 and said[-1].startswith("ready")
    assert controller.asked.count("unlock protective stop") == 3
    assert any("Cannot unlock protective stop" in line for line in said)
    assert "power on" not in controller.asked and "play" not in controller.asked


def test_a_released_emergency_stop_powers_on_and_releases_the_brakes() -> None:
    controller = Controller("NORMAL", "POWER_OFF")
    code, said = run(controller)
    assert code == 0
    steps = [a for a in controller.asked if a in ("close safety popup", "power on", "brake release")]
    assert steps == ["close safety popup", "power on", "brake release"]
    assert "power on: Powering on" in said


def test_a_fault_restarts_the_safety_system_first() -> None:
    controller = Controller("FAULT", "POWER_OFF")
    assert run(controller)[0] == 0
    assert controller.asked.index("restart safety") < controller.asked.index("power on")


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (Controller("ROBOT_EMERGENCY_STOP", "POWER_OFF"), "an emergency stop is pressed; release it by hand"),
        (Controller("SYSTEM_EMERGENCY_STOP", "POWER_OFF"), "an emergency stop is pressed"),
        (Controller("PROTECTIVE_STOP", remote=False), "not in remote control"),
        (Controller("SAFEGUARD_STOP"), "a safeguard is open"),
        (Controller("RECOVERY"), "move it back by hand"),
    ],
    ids=["e-stop", "system e-stop", "local", "safeguard", "recovery"],
)
def test_what_needs_a_person_is_refused_and_nothing_is_switched(controller: Controller, words: str) -> None:
    code, said = run(controller)
    assert code == 1 and words in said[-1]
    assert not {"unlock protective stop", "power on", "brake release", "restart safety"} & set(
        controller.asked
    )


def test_a_ready_robot_is_left_alone() -> None:
    controller = Controller()
    assert run(controller)[0] == 0
    assert not {"unlock protective stop", "power on", "brake release"} & set(controller.asked)


def test_nobody_there() -> None:
    with pytest.raises(BackendError, match="no robot answers"):
        recover("127.0.0.98", print)
    assert look("127.0.0.98")[0][1].startswith("dashboard: Connection refused")
    run_ = cell("recover", "--robot-ip", "127.0.0.98")
    assert run_.returncode == 2 and len(run_.stderr.splitlines()) == 1
