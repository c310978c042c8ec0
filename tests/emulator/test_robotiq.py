"""The gripper's socket, byte for byte, as clients of a 2F-85 know it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.clock import WallClock, perf_s
from cell.config import load
from cell.errors import BackendError
from hil.emulator.faults import make_faults
from hil.emulator.grippers import IdealGripper
from hil.emulator.robotiq import READABLE, Flt, Obj, Robotiq, Sta, counts, width_of
from hil.emulator.servers.robotiq import PORT, RobotiqServer

CONFIG = load().gripper
ADDRESS = "127.0.0.42"


class Device:
    """A gripper in simulated time."""

    def __init__(self) -> None:
        self.fingers = IdealGripper(CONFIG)
        self.robotiq = Robotiq(self.fingers)
        self.now = 0.0

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.01)):
            self.now += 0.01
            self.fingers.advance(0.01)
            self.robotiq.tick(self.now)

    def until(self, name: str, value: int, limit: float = 10.0) -> float:
        """Waits for a variable; how long it took [s]."""
        start = self.now
        while self.robotiq.read(name) != value:
            self.wait(0.01)
            assert self.now < start + limit, f"{name} stays {self.robotiq.read(name)}"
        return self.now - start

    def activate(self) -> None:
        self.robotiq.write({"ACT": 1, "GTO": 1})
        self.until("STA", Sta.ACTIVE)

    def move(self, position: int, speed: int = 255, force: int = 0) -> None:
        self.robotiq.write({"POS": position, "SPE": speed, "FOR": force, "GTO": 1})
        assert self.robotiq.read("PRE") == position and self.robotiq.read("OBJ") == Obj.MOVING


# -- the device ---------------------------------------------------------------------------------------


def test_activation_takes_real_time_and_ends_open() -> None:
    device = Device()
    assert [device.robotiq.read(name) for name in ("ACT", "STA", "FLT", "SID")] == [0, 0, 0, 9]
    device.robotiq.write({"ACT": 1})
    assert device.robotiq.read("STA") == Sta.ACTIVATING
    assert 2 * 0.085 / 0.15 < device.until("STA", Sta.ACTIVE) < 2.0  # shut and open once
    assert device.robotiq.read("POS") == 3 and device.robotiq.read("OBJ") == Obj.AT_DESTINATION
    device.robotiq.write({"ACT": 1})
    assert device.robotiq.read("STA") == Sta.ACTIVE  # once is enough
    device.robotiq.write({"ACT": 0})
    assert device.robotiq.read("STA") == Sta.RESET


def test_open_reads_about_3_and_closed_about_230_counts() -> None:
    device = Device()
    device.activate()
    device.move(255)
    assert device.until("OBJ", Obj.AT_DESTINATION) == pytest.approx(0.085 / 0.15, abs=0.03)
    assert device.robotiq.read("POS") == 230
    device.move(0)
    device.until("OBJ", Obj.AT_DESTINATION)
    assert device.robotiq.read("POS") == 3
    device.move(100)
    device.until("OBJ", Obj.AT_DESTINATION)
    assert device.robotiq.read("POS") == 100
    assert device.fingers.state()[0] == pytest.approx(width_of(100, 0.085), abs=1e-5)


@pytest.mark.parametrize(("speed", "metres_per_second"), [(0, 0.020), (255, 0.150), (128, 0.0853)])
def test_speed_counts(speed: int, metres_per_second: float) -> None:
    device = Device()
    device.activate()
    device.move(255, speed)
    device.wait(0.2)
    assert 0.085 - device.fingers.state()[0] == pytest.approx(0.2 * metres_per_second, rel=0.06)


def test_an_object_stops_the_fingers_either_way() -> None:
    device = Device()
    device.activate()
    device.fingers.object = 0.05
    device.move(255)
    device.until("OBJ", Obj.STOPPED_CLOSING)
    assert device.robotiq.read("POS") == counts(0.05, 0.085)
    device.move(0)
    device.until("OBJ", Obj.AT_DESTINATION)


def test_go_to_off_stops_where_it_is() -> None:
    device = Device()
    device.activate()
    device.move(255, 50)
    device.wait(0.3)
    device.robotiq.write({"GTO": 0})
    device.wait(0.05)
    assert device.robotiq.read("OBJ") == Obj.AT_DESTINATION and device.robotiq.read("PRE") == 255
    width = device.fingers.state()[0]
    device.robotiq.write({"POS": 0})
    device.wait(0.5)
    assert device.fingers.state()[0] == width  # without GTO nothing moves


def test_moves_before_activation_are_faults() -> None:
    device = Device()
    device.robotiq.write({"ACT": 1})
    device.robotiq.write({"POS": 255, "GTO": 1})
    assert device.robotiq.read("FLT") == Flt.WAIT_FOR_ACTIVATION
    device.until("STA", Sta.ACTIVE)
    assert device.robotiq.read("FLT") == Flt.NONE
    device.until("POS", 230)  # done once it can be


def test_automatic_release_opens_slowly_and_needs_a_new_activation() -> None:
    device = Device()
    device.activate()
    device.move(255)
    device.until("POS", 230)
    device.robotiq.write({"ATR": 1, "ADR": 1})
    assert device.robotiq.read("FLT") == Flt.RELEASING
    assert device.until("FLT", Flt.RELEASED) > 4.0
    assert device.robotiq.read("POS") == 3 and device.robotiq.read("STA") == Sta.RESET
    device.robotiq.write({"POS": 255, "GTO": 1})
    device.wait(1.0)
    assert device.robotiq.read("POS") == 3
    device.robotiq.write({"ACT": 0, "ATR": 0})
    device.activate()
    assert device.robotiq.read("FLT") == Flt.NONE


# -- the socket ---------------------------------------------------------------------------------------


@contextmanager
def served(*faults: str) -> Iterator[tuple[RobotiqServer, IdealGripper]]:
    """A server whose fingers move in real time."""
    fingers = IdealGripper(CONFIG)
    server = RobotiqServer(ADDRESS, fingers, make_faults(faults), port=0)
    server.start()
    ended = threading.Event()

    def advance() -> None:
        last = perf_s()
        while not ended.wait(0.005):
            now = perf_s()
            fingers.advance(now - last)
            last = now

    thread = threading.Thread(target=advance, daemon=True)
    thread.start()
    try:
        yield server, fingers
    finally:
        ended.set()
        thread.join()
        server.stop()


@contextmanager
def client(server: RobotiqServer) -> Iterator[Callable[[bytes], bytes]]:
    """Sends bytes and returns what comes next."""
    with socket.create_connection((ADDRESS, server.port), 5.0) as sock:

        def ask(data: bytes) -> bytes:
            sock.sendall(data)
            return sock.recv(1024)

        yield ask


def wait_for(ask: Callable[[bytes], bytes], request: bytes, answer: bytes) -> None:
    clock, end = WallClock(), perf_s() + 10.0
    while (got := ask(request)) != answer:
        assert perf_s() < end, got
        clock.sleep_until(clock.now() + 0.02)


def test_the_usual_port() -> None:
    assert PORT == 63352


def test_bytes_of_the_reference_sequence() -> None:
    with served() as (server, fingers), client(server) as ask:
        assert ask(b"SET ACT 0\n") == b"ack"
        assert ask(b"SET ATR 0\n") == b"ack"
        wait_for(ask, b"GET STA\n", b"STA 0\n")
        assert ask(b"SET ACT 1\n") == b"ack"
        assert ask(b"GET STA\n") == b"STA 1\n"
        wait_for(ask, b"GET STA\n", b"STA 3\n")
        assert ask(b"GET POS\n") == b"POS 3\n"
        assert ask(b"GET FLT\n") == b"FLT 00\n"
        assert ask(b"GET SID\n") == b"SID 9\n"
        fingers.object = 0.07
        assert ask(b"SET POS 255 SPE 255 FOR 50 GTO 1\n") == b"ack"
        assert ask(b"GET PRE\n") == b"PRE 255\n"
        wait_for(ask, b"GET OBJ\n", b"OBJ 2\n")
        assert ask(b"GET POS\n") == b"POS %d\n" % counts(0.07, 0.085)


def test_lines_may_come_in_pieces_and_together() -> None:
    with served() as (server, _), client(server) as ask:
        answers = ask(b"SET FOR 12 SPE 34\nGET FOR\nGET S") + ask(b"PE\n")
        while len(answers) < 17:  # they, too, come in pieces
            answers += ask(b"")
        assert answers == b"ackFOR 12\nSPE 34\n"


def test_both_spellings_of_the_release_direction() -> None:
    with served() as (server, _), client(server) as ask:
        assert ask(b"SET ARD 1\n") == b"ack"
        assert ask(b"GET ADR\n") == b"ADR 1\n"
        assert ask(b"GET ARD\n") == b"ARD 1\n"


@pytest.mark.parametrize(
    "line",
    [b"GET\n", b"GET WHAT\n", b"SET POS\n", b"SET POS 256\n", b"SET POS -1\n", b"SET STA 3\n", b"HELLO\n",
     b"SET\n", b"SET POS 10 SPE\n", b"SET POS 1e1\n", b"\xff\xfe\n"],
)  # fmt: skip
def test_what_cannot_be_understood_changes_nothing(line: bytes) -> None:
    with served() as (server, _), client(server) as ask:
        assert ask(line) == b"?\n"
        assert ask(b"GET POS\n") == b"POS 3\n"


def test_several_clients_see_one_gripper() -> None:
    with served() as (server, _), client(server) as one, client(server) as two:
        assert one(b"SET ACT 1\n") == b"ack"
        wait_for(two, b"GET STA\n", b"STA 3\n")
        assert one(b"GET ACT\n") == two(b"GET ACT\n") == b"ACT 1\n"


def test_a_line_without_end_closes_the_connection() -> None:
    with served() as (server, _), client(server) as ask:
        assert ask(b"GET POS " + 3000 * b"x") == b""


def test_a_port_in_use_is_said_plainly() -> None:
    with served() as (server, fingers):
        second = RobotiqServer(ADDRESS, fingers, port=server.port)
        with pytest.raises(BackendError, match=f"gripper on {ADDRESS}:{server.port}"):
            second.start()


def test_faults_reach_the_gripper_socket() -> None:
    with served("duplicate:port=63352,share=1") as (server, _), client(server) as ask:
        ask(b"GET POS\n")
        assert len(ask(b"GET POS\n")) >= 6  # two answers each
    refused = "refuse:port=gripper"
    # It may end in a reset as well as in an end of file.
    with served(refused) as (server, _), client(server) as ask, suppress(ConnectionError):
        assert ask(b"GET POS\n") == b""


@given(st.lists(st.tuples(st.sampled_from(READABLE), st.integers(0, 255)), min_size=1, max_size=8))
@settings(max_examples=100, deadline=None)
def test_whatever_is_set_every_variable_stays_a_byte(values: list[tuple[str, int]]) -> None:
    device = Device()
    for name, value in values:
        if name in ("STA", "PRE", "OBJ", "FLT", "SID"):
            device.wait(0.1)
        else:
            device.robotiq.write({name: value})
    device.wait(0.2)
    assert all(0 <= device.robotiq.read(name) <= 255 for name in READABLE)
