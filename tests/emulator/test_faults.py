"""Faults on purpose: how they are written, and what each does to messages, connections and the panel."""

from __future__ import annotations

import math
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from cell.clock import WallClock, perf_s
from cell.config import load
from cell.errors import ConfigError
from hil.emulator.emulator import FREE_PORTS, Emulator
from hil.emulator.fault_syntax import KINDS, parse_fault
from hil.emulator.faults import PlannedFaults, make_faults
from hil.emulator.interfaces import SafetyMode
from hil.emulator.interfaces_faults import Delivery, LinkFaults, Server
from hil.emulator.models import model
from hil.emulator.mover import Mover
from hil.emulator.plant import IdealPlant
from hil.emulator.programs import recognise

DOC = Path(__file__).resolve().parents[2] / "docs" / "emulator.md"


class Pressed:
    """Stands in for the panel and notes what is pressed on it."""

    def __init__(self) -> None:
        self.log: list[tuple[str, Any]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda value: self.log.append((name, value))


def link(*texts: str, server: Server = Server.RTDE, seed: int = 0) -> LinkFaults:
    found = make_faults(texts, seed).link(server, "127.0.0.1:5")
    assert found is not None
    return found


def run(faults: PlannedFaults, end: float, step: float = 0.5) -> list[tuple[float, str, Any]]:
    """What is pressed and when."""
    out = []
    for k in range(round(end / step) + 1):
        panel = Pressed()
        faults.before_cycle(panel, k * step)  # type: ignore[arg-type]
        out += [(k * step, *entry) for entry in panel.log]
    return out


# -- syntax -------------------------------------------------------------------------------------------


def test_a_fault_with_keys_and_one_without() -> None:
    fault = parse_fault("cut:port=30004,at=8")
    assert fault.kind == "cut"
    assert (fault["port"], fault["at"], fault["every"]) == (Server.RTDE, 8.0, 0.0)
    assert parse_fault("drop")["share"] == 0.05
    assert parse_fault("drop:port=dashboard")["port"] is Server.DASHBOARD
    assert parse_fault("version:is=3.15.8")["is"] == (3, 15, 8, 0)
    assert parse_fault("freeze:at=2")["for"] == math.inf


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "explode",
            "--fault: got 'explode'; legal values: delay, drop, duplicate, freeze, cut, refuse, slow, ",
        ),
        ("", "--fault: got ''; legal values: delay"),
        ("cut:when=3", "--fault cut: got key 'when'; legal keys: port, at, every"),
        ("local_control:at=3", "--fault local_control: got key 'at'; legal keys: none"),
        ("cut:at", "--fault cut: at needs a value, as in at=..."),
        ("cut:at=soon", "--fault cut: at=soon: could not convert string to float"),
        ("cut:at=-1", "--fault cut: at=-1: must be 0 or more seconds"),
        ("cut:at=nan", "--fault cut: at=nan: must be 0 or more seconds"),
        ("cut:port=80", "--fault cut: port=80: got '80'; legal values: 29999, 30001, "),
        ("cut:port=usb", "--fault cut: port=usb: got 'usb'; legal values: 29999, 30001, "),
        ("drop:share=2", "--fault drop: share=2: must be from 0 to 1"),
        ("drop:way=up", "--fault drop: way=up: got 'up'; legal values: out, in, both"),
        ("version", "--fault version needs is=..., as in version:is=3.15.8"),
        ("version:is=new", "--fault version: is=new: must look like 5.22 or 3.15.8.106339"),
        ("in_use", "--fault in_use needs name=..., as in in_use:name=speed_slider_mask"),
        ("in_use:name=", "--fault in_use: name=: must be the name of an RTDE input"),
    ],
)
def test_mistakes_are_said_in_one_line(text: str, line: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse_fault(text)
    assert str(error.value).startswith(line) and "\n" not in str(error.value)


def test_every_kind_and_key_is_documented() -> None:
    rows = [line for line in DOC.read_text().splitlines() if line.startswith("| `")]
    for kind, keys in KINDS.items():
        row = next((line for line in rows if line.startswith(f"| `{kind}`")), "")
        assert row, f"{kind} is missing in {DOC.name}"
        for key in set(keys) - {"port", "at", "for", "way"}:
            assert f"`{key}`" in row, f"{kind}: {key} is missing in {DOC.name}"


# -- messages -----------------------------------------------------------------------------------------


def test_only_the_named_server_is_disturbed() -> None:
    faults = make_faults(["drop:port=30004,share=1", "protective_stop:at=5"])
    assert faults.link(Server.DASHBOARD, "x:1") is None
    assert faults.link(Server.RTDE, "x:1") is not None
    assert all(make_faults(["freeze"]).link(server, "x:1") is not None for server in Server)


def test_delay_drop_duplicate_freeze() -> None:
    assert list(link("delay:by=0.02").outgoing(b"m", 1.0)) == [Delivery(b"m", 0.02)]
    assert list(link("delay:by=0.02").incoming(b"m", 1.0)) == [Delivery(b"m")]
    assert list(link("delay:by=0.02,way=in").incoming(b"m", 1.0)) == [Delivery(b"m", 0.02)]
    assert list(link("drop:share=1").outgoing(b"m", 1.0)) == []
    assert list(link("duplicate:share=1").outgoing(b"m", 1.0)) == [Delivery(b"m"), Delivery(b"m")]
    frozen = link("freeze:at=2,for=3")
    assert [len(frozen.outgoing(b"m", t)) for t in (1.9, 2.0, 4.9, 5.0)] == [1, 0, 0, 1]
    assert [len(frozen.incoming(b"m", t)) for t in (1.9, 2.0, 4.9, 5.0)] == [1, 0, 0, 1]


def test_faults_of_one_link_add_up() -> None:
    both = link("duplicate:share=1", "delay:by=0.01,way=both")
    assert list(both.outgoing(b"m", 0.0)) == [Delivery(b"m", 0.01)] * 2


def test_chance_comes_from_the_seed() -> None:
    def lost(seed: int) -> list[int]:
        it = link("drop:share=0.3", seed=seed)
        return [k for k in range(500) if not it.outgoing(b"m", 0.0)]

    assert lost(1) == lost(1) != lost(2)
    assert 0.2 < len(lost(1)) / 500 < 0.4
    jitter = link("delay:by=0.01,jitter=0.02")
    delays = [jitter.outgoing(b"m", 0.0)[0].delay for _ in range(200)]
    assert 0.01 <= min(delays) < 0.012 and 0.028 < max(delays) <= 0.03


# -- connections --------------------------------------------------------------------------------------


def test_a_cut_closes_what_is_open_then_and_nothing_later() -> None:
    before = link("cut:at=8")
    assert [before.cut(t) for t in (0.0, 7.99, 8.0)] == [False, False, True]
    after = link("cut:at=8")
    assert not any(after.cut(t) for t in (8.1, 9.0, 100.0))
    again = link("cut:at=8,every=5")
    assert [again.cut(t) for t in (9.0, 12.9, 13.0)] == [False, False, True]


def test_refusing_connections_for_a_while() -> None:
    faults = make_faults(["refuse:port=30002,at=2,for=1"])
    said = []
    for now in (1.0, 2.0, 2.9, 3.0):
        faults.before_cycle(Pressed(), now)  # type: ignore[arg-type]
        said.append((faults.refuse(Server.SECONDARY, "x:1"), faults.refuse(Server.RTDE, "x:1")))
    assert said == [(False, False), (True, False), (True, False), (False, False)]


# -- the controller -----------------------------------------------------------------------------------


def test_buttons_are_pressed_once_and_let_go() -> None:
    assert run(make_faults(["protective_stop:at=2"]), 5.0) == [(2.0, "protective_stop", "a fault on purpose")]
    assert run(make_faults(["violation:at=1"]), 5.0) == [(1.0, "violation", "a fault on purpose")]
    assert run(make_faults(["emergency_stop:at=1,for=2"]), 5.0) == [
        (1.0, "emergency_stop", True),
        (3.0, "emergency_stop", False),
    ]
    assert run(make_faults(["safeguard_stop:at=1"]), 5.0) == [(1.0, "safeguard_stop", True)]


def test_a_slow_controller() -> None:
    faults = make_faults(["slow:at=1,for=1,by=0.006"])
    panel: Any = Pressed()
    assert [faults.before_cycle(panel, t) for t in (0.9, 1.0, 1.9, 2.0)] == [0.0, 0.006, 0.006, 0.0]
    sometimes = make_faults(["slow:share=0.25"], seed=3)
    late = [sometimes.before_cycle(panel, 0.0) > 0.0 for _ in range(1000)]
    assert 200 < sum(late) < 300


def test_what_the_controller_says_of_itself() -> None:
    quiet = make_faults([])
    assert (
        quiet.version() is None and quiet.remote_control() is None and not quiet.in_use("speed_slider_mask")
    )
    faults = make_faults(["version:is=3.15", "in_use:name=speed_slider_mask", "local_control"])
    assert faults.version() == (3, 15, 0, 0) and faults.remote_control() is False
    assert faults.in_use("speed_slider_mask") and not faults.in_use("input_int_register_24")


# -- on a controller ----------------------------------------------------------------------------------


@contextmanager
def running(*faults: str) -> Iterator[Emulator]:
    """A bare arm with its servers on free ports."""
    arm, plant = model("ur3e"), IdealPlant(load())
    emulator = Emulator(
        "127.0.0.44", arm, plant, mover=Mover(arm), recognise=recognise, gripper=plant.gripper,
        faults=make_faults(faults), ports=FREE_PORTS, power_up=True,
    )  # fmt: skip
    emulator.start()
    try:
        yield emulator
    finally:
        emulator.stop()


def wait_for(condition: Callable[[], object]) -> None:
    clock, end = WallClock(), perf_s() + 20.0
    while not condition():
        assert perf_s() < end, "waited in vain"
        clock.sleep_until(clock.now() + 0.02)


def test_a_planned_stop_on_a_running_controller() -> None:
    began = perf_s()
    with running("protective_stop:at=2") as emulator:
        wait_for(lambda: emulator.do(lambda c: c.safety_mode) is SafetyMode.PROTECTIVE_STOP)
        assert perf_s() - began >= 2.0


def test_a_slow_controller_is_so_for_the_time_that_was_asked_for() -> None:
    """Not for as many cycles as fit into it: 250 of them would take 25 s."""
    with running("slow:for=0.5,by=0.1") as emulator:
        wait_for(lambda: emulator.do(lambda c: c.cycles) >= 500)
        cycles, left_out = emulator.timing
        assert left_out >= 100, "it was never slow"
        assert cycles + left_out < 5000, "it was slow for far too long"


def test_a_planned_cut_of_a_running_server() -> None:
    with running("cut:port=dashboard,at=1.5") as emulator:
        began = perf_s()
        with socket.create_connection(("127.0.0.44", emulator.ports.dashboard), 5.0) as sock:
            if perf_s() - began > 1.4:
                pytest.skip("the machine was too busy to connect in time")
            sock.settimeout(20.0)
            assert sock.recv(100).startswith(b"Connected")
            assert sock.recv(100) == b""
        with socket.create_connection(("127.0.0.44", emulator.ports.dashboard), 5.0) as sock:
            assert sock.recv(100).startswith(b"Connected")


def test_a_false_version_on_the_dashboard() -> None:
    with (
        running("version:is=3.15.8", "local_control") as emulator,
        socket.create_connection(("127.0.0.44", emulator.ports.dashboard), 5.0) as sock,
    ):
        sock.recv(100)
        sock.sendall(b"PolyscopeVersion\n")
        assert b"3.15.8" in sock.recv(100)
        sock.sendall(b"is in remote control\n")
        assert sock.recv(100) == b"false\n"
