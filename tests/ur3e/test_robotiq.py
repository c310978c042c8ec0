"""The gripper's client against a byte-level 2F-85."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.clock import WallClock, perf_s
from cell.config import CellConfig, load
from cell.errors import BackendError
from hil.ur3e.robotiq import Counts, Gripper, Wire
from tests.test_cli import free_port
from tests.ur3e.fakes import LineServer
from tests.wire_helpers import pause, until

CONFIG = load()
G = CONFIG.gripper


class Device:
    """A 2F-85's registers; fingers are at once where they are sent, or at an object."""

    def __init__(self) -> None:
        self.values = dict.fromkeys(("ACT", "GTO", "ATR", "FOR", "SPE", "STA", "PRE", "FLT"), 0)
        self.values.update(POS=3, OBJ=3)
        self.object_at: int | None = None
        self.sets: list[str] = []

    def answer(self, request: bytes) -> bytes | None:
        words = request.decode().split()
        if words[0] == "GET":
            return f"{words[1]} {self.values[words[1]]}\n".encode()
        self.sets.append(request.decode())
        pairs = dict(zip(words[1::2], map(int, words[2::2]), strict=True))
        self.values.update({k: v for k, v in pairs.items() if k != "POS"})
        if "ACT" in pairs:
            self.values["STA"] = 3 if pairs["ACT"] else 0
        if "POS" in pairs:
            target = self.values["PRE"] = pairs["POS"]
            met = self.object_at is not None and target > self.object_at
            self.values["POS"] = self.object_at if met and self.object_at is not None else target
            self.values["OBJ"] = 2 if met else 3
        return b"ack"


def configured(port: int) -> CellConfig:
    return msgspec.structs.replace(CONFIG, ur3e=msgspec.structs.replace(CONFIG.ur3e, gripper_port=port))


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture
def server(device: Device) -> Iterator[LineServer]:
    with LineServer(device.answer) as server:
        yield server


@pytest.fixture
def gripper(server: LineServer) -> Iterator[Gripper]:
    gripper = Gripper(configured(server.port), "127.0.0.1", WallClock())
    gripper.connect()
    yield gripper
    gripper.close()


def test_it_is_activated_once(gripper: Gripper, device: Device) -> None:
    assert device.sets == ["SET ACT 0 ATR 0\n", "SET ACT 1\n"]
    gripper.close()
    gripper.connect()
    assert len(device.sets) == 2


def test_a_command_goes_out_in_counts_and_comes_back_in_metres(gripper: Gripper, device: Device) -> None:
    began = perf_s()
    assert gripper.command(0.03, 0.1, 40.0) == (0.03, 0.1, 40.0)
    assert gripper.state().moving and perf_s() - began < 0.02
    until(lambda: not gripper.state().moving)
    assert device.sets[-1] == "SET POS 150 SPE 157 FOR 24 GTO 1\n"
    state = gripper.state()
    assert state.width == pytest.approx(0.03, abs=3e-4) and state.target == 0.03 and not state.holding
    first = state.t
    until(lambda: gripper.state().t > first)


def test_an_object_is_held(gripper: Gripper, device: Device) -> None:
    device.object_at = 60
    gripper.command(0.0, 0.1, 40.0)
    until(lambda: gripper.state().holding)
    state = gripper.state()
    assert state.width == pytest.approx(0.0636, abs=1e-3) and state.target == 0.0


def test_values_outside_are_clipped_and_said(gripper: Gripper) -> None:
    assert gripper.command(9.0, 9.0, 9e4) == (G.stroke, G.max_speed, G.max_force)
    assert gripper.command(0.0, 0.0, 0.0) == (0.0, G.min_speed, G.min_force)


def test_a_lost_connection_is_told_and_no_old_command_is_repeated(
    gripper: Gripper, server: LineServer, device: Device
) -> None:
    gripper.command(0.03, 0.1, 40.0)
    until(lambda: not gripper.state().moving)
    sent = len(device.sets)
    server.cut()
    told: list[str] = []
    until(lambda: bool(told.extend(gripper.news()) or any("connected again" in t for t in told)), 6.0)
    assert "trying to connect again" in told[0]
    pause(0.1)
    assert len(device.sets) == sent
    gripper.command(0.05, 0.1, 40.0)
    until(lambda: len(device.sets) == sent + 1)


@given(st.floats(0.0, G.stroke), st.floats(G.min_speed, G.max_speed), st.floats(G.min_force, G.max_force))
def test_counts_stay_within_a_byte_and_width_survives_them(width: float, speed: float, force: float) -> None:
    counts = Counts(CONFIG)
    assert 3 <= counts.position(width) <= 230
    assert counts.width(counts.position(width)) == pytest.approx(width, abs=2.5e-4)
    assert 0 <= counts.speed(speed) <= 255 and 0 <= counts.force(force) <= 255


@pytest.mark.parametrize("answer", [b"POS ?\n", b"", b"STA 3\n", b"\xff\xfe"])
def test_a_strange_answer_is_one_line(answer: bytes) -> None:
    with LineServer(lambda request: answer or None) as server:
        wire = Wire("127.0.0.1", server.port)
        with pytest.raises(BackendError, match="gripper at 127"):
            wire.get("POS")


def test_no_gripper_there_says_what_to_look_at() -> None:
    gripper = Gripper(configured(free_port()), "127.0.0.1", WallClock())
    with pytest.raises(BackendError, match=r"no gripper answers .* Robotiq URCap"):
        gripper.connect()
    with pytest.raises(BackendError, match="not connected"):
        gripper.state()
