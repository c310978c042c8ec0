"""RTDE as clients meet it: recipes, rates, ownership of inputs, slow readers, faults."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator, Sequence
from itertools import pairwise

import pytest

from cell.clock import WallClock
from cell.errors import BackendError
from hil.emulator import emulator as emulator_module
from hil.emulator.emulator import Emulator, Ports
from hil.emulator.interfaces import PERIOD
from hil.emulator.interfaces_faults import Delivery, LinkFaults, NoFaults, Panel, Server
from hil.rtde import codec
from hil.rtde.client import RtdeClient
from hil.rtde.codec import Kind
from hil.rtde.fields import fields
from tests.emulator.ideal import HOME, SWEEP
from tests.emulator.rig import LATEST, eventually, running, take, until


@pytest.fixture(scope="module")
def emulator() -> Iterator[Emulator]:
    with running() as served:
        yield served


@pytest.fixture
def client(emulator: Emulator) -> Iterator[RtdeClient]:
    with connect(emulator) as connected:
        yield connected


def connect(emulator: Emulator) -> RtdeClient:
    return RtdeClient("127.0.0.1", emulator.ports.rtde, LATEST)


class Raw:
    """Frames by hand."""

    def __init__(self, emulator: Emulator) -> None:
        self.socket = socket.create_connection(("127.0.0.1", emulator.ports.rtde), LATEST)

    def ask(self, kind: int, payload: bytes = b"") -> bytes:
        self.socket.sendall(codec.frame(kind, payload))
        while True:
            got, answer = self.next()
            if got == kind:
                return answer

    def next(self) -> tuple[int, bytes]:
        size, kind = struct.unpack(">HB", take(self.socket, 3))
        return kind, take(self.socket, size - 3)


def test_the_version_is_one_that_clients_take_for_an_e_series(client: RtdeClient) -> None:
    assert client.version()[:2] == (5, 22)


def test_answers_to_recipes_name_the_exact_types(emulator: Emulator) -> None:
    raw = Raw(emulator)
    names = [name for name, field in fields().items() if not field.input and field.since < (5, 23)]
    names.remove("target_base_wrench")
    number, types = codec.decode_recipe(raw.ask(Kind.OUTPUTS, codec.encode_outputs(125, names)))
    assert number == 1 and list(types) == [fields()[name].type for name in names]
    asked = ["timestamp", "no_such_field", "actual_current_as_torque"]
    refused = codec.decode_recipe(raw.ask(Kind.OUTPUTS, codec.encode_outputs(125, asked)))
    assert refused == (0, ("DOUBLE", "NOT_FOUND", "NOT_FOUND"))
    for rate in (0.0, -1.0, float("nan")):
        assert raw.ask(Kind.OUTPUTS, codec.encode_outputs(rate, ["timestamp"]))[0] == 0
    with_comma = struct.pack(">d", 10.0) + b"timestamp,"
    assert codec.decode_recipe(raw.ask(Kind.OUTPUTS, with_comma)) == (1, ("DOUBLE",))
    assert raw.ask(Kind.INPUTS, b"timestamp") == b"\x00NOT_FOUND"
    assert raw.ask(Kind.VERSION, b"\x00\x01") == b"\x00" and raw.ask(Kind.VERSION, b"\x00\x02") == b"\x01"
    raw.socket.close()


def test_values_are_those_of_the_controller(client: RtdeClient) -> None:
    client.subscribe(["timestamp", "actual_q", "robot_mode", "joint_mode", "runtime_state"])
    values = client.read()
    assert values["actual_q"] == pytest.approx(HOME.tolist())
    assert (values["robot_mode"], values["runtime_state"]) == (7, 1)
    assert values["joint_mode"] == (253,) * 6


@pytest.mark.parametrize("rate", [500.0, 125.0, 100.0, 1000.0])
def test_each_client_has_its_own_rate(client: RtdeClient, rate: float) -> None:
    client.subscribe(["timestamp"], rate)
    stamps = [float(client.read()["timestamp"]) for _ in range(30)]  # type: ignore[arg-type]
    steps = [b - a for a, b in pairwise(stamps)]
    assert steps == pytest.approx([max(PERIOD, 1.0 / rate)] * 29, abs=1e-9)


def test_a_pause_ends_the_stream_and_a_start_takes_it_up(emulator: Emulator) -> None:
    raw = Raw(emulator)
    assert raw.ask(Kind.START) == b"\x00", "nothing is set up"
    raw.ask(Kind.OUTPUTS, codec.encode_outputs(500, ["timestamp"]))
    assert raw.ask(Kind.START) == b"\x01"
    assert raw.next()[0] == Kind.DATA
    assert raw.ask(Kind.PAUSE) == b"\x01"
    raw.socket.settimeout(0.05)
    with pytest.raises(TimeoutError):
        raw.next()
    raw.socket.settimeout(LATEST)
    assert raw.ask(Kind.START) == b"\x01" and raw.next()[0] == Kind.DATA
    raw.socket.close()


def test_inputs_are_taken_before_the_start_in_any_length(emulator: Emulator, client: RtdeClient) -> None:
    number = client.claim(["input_int_register_30", "input_double_register_30", "input_double_register_31"])
    client.write(number, [7, 1.5, 2.5])
    until(emulator, lambda c: c.registers.in_double[31] == 2.5)
    short = struct.pack(">Bid", number, 8, 3.5)
    client._send(codec.frame(Kind.DATA, short))
    client._send(codec.frame(Kind.DATA, struct.pack(">Bi2d", number, 8, 3.5, 4.5) + bytes(48)))
    until(emulator, lambda c: c.registers.in_double[31] == 4.5)
    assert emulator.do(lambda c: (c.registers.in_int[30], c.registers.in_double[30])) == (8, 3.5)


def test_input_registers_may_be_read_by_anybody(emulator: Emulator, client: RtdeClient) -> None:
    client.write(client.claim(["input_int_register_40"]), [99])
    with connect(emulator) as other:
        other.subscribe(["input_int_register_40"])
        eventually(lambda: other.read()["input_int_register_40"] == 99)


def test_an_input_belongs_to_one_client_until_it_goes(emulator: Emulator) -> None:
    first = connect(emulator)
    assert first.claim(["input_int_register_24", "speed_slider_mask"]) == 1
    assert first.claim(["input_int_register_24"]) == 2, "its owner may have it in several recipes"
    with connect(emulator) as second:
        with pytest.raises(BackendError, match="input_int_register_24 IN_USE"):
            second.claim(["input_int_register_24"])
        first.close()

        def free() -> bool:
            try:
                return second.claim(["input_int_register_24"]) == 1
            except BackendError:
                return False

        eventually(free)


def test_outputs_show_up_in_the_stream(emulator: Emulator, client: RtdeClient) -> None:
    client.subscribe(["actual_digital_output_bits"], 500)
    number = client.claim(["standard_digital_output_mask", "standard_digital_output"])
    client.write(number, [0b10, 0b10])
    eventually(lambda: client.read()["actual_digital_output_bits"] == 0b10)
    client.write(number, [0b10, 0])


def test_texts_reach_the_clients(emulator: Emulator) -> None:
    raw = Raw(emulator)
    emulator.do(lambda c: c.message("too early, it would be taken for an answer", 2))
    raw.ask(Kind.OUTPUTS, codec.encode_outputs(500, ["timestamp"]))
    raw.socket.sendall(codec.frame(Kind.START))
    assert raw.next()[0] == Kind.START
    emulator.do(lambda c: c.message("something to know", 2))
    emulator.do(lambda c: c.message("something is wrong", 1))
    kind, payload = raw.next()
    while kind == Kind.DATA:
        kind, payload = raw.next()
    assert codec.decode_text(payload) == ("something is wrong", "Controller", 1)
    raw.socket.close()


@pytest.mark.parametrize("garbage", [b"\x00\x01V", b"\x00\x05O\x00\x00", b"\x00\x06I\xff\xfe\xfd"])
def test_garbage_ends_the_connection_and_nothing_else(emulator: Emulator, garbage: bytes) -> None:
    raw = Raw(emulator)
    raw.socket.sendall(garbage)
    assert raw.socket.recv(100) == b""
    with connect(emulator) as other:
        assert other.version()[0] == 5


def test_a_slow_reader_holds_up_nobody_and_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emulator_module, "_RTDE_PATIENCE", 0.3)
    with running() as served:
        sleeper = socket.socket()
        sleeper.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sleeper.connect(("127.0.0.1", served.ports.rtde))
        names = [name for name in fields() if name.startswith("output_double")] * 8
        sleeper.sendall(codec.frame(Kind.OUTPUTS, codec.encode_outputs(500, names)))
        sleeper.sendall(codec.frame(Kind.START))
        eventually(lambda: _clients(served) == 1)
        with connect(served) as reader:
            reader.subscribe(["timestamp"], 500)
            start = float(reader.read()["timestamp"])  # type: ignore[arg-type]
            stamps = [start]
            while _clients(served) == 2 and stamps[-1] - start < LATEST:
                stamps.append(float(reader.read()["timestamp"]))  # type: ignore[arg-type]
            assert _clients(served) == 1, "the sleeper was kept"
            steps = [b - a for a, b in pairwise(stamps)]
            assert steps == pytest.approx([PERIOD] * len(steps), abs=1e-9)
        sleeper.close()


def _clients(served: Emulator) -> int:
    assert served._loop is not None
    return served._loop.clients(Server.RTDE)


def test_packets_are_never_sent_twice_in_a_cycle() -> None:
    class Slow(NoFaults):
        def before_cycle(self, panel: Panel, now: float) -> float:
            del panel
            return 0.007 if round(now / PERIOD) % 10 == 0 else 0.0

    with running(faults=Slow()) as served, connect(served) as client:
        client.subscribe(["timestamp", "actual_execution_time"], 500)
        clock, arrivals, stamps, slowest = WallClock(), [], [], 0.0
        for _ in range(200):
            values = client.read()
            arrivals.append(clock.now())
            stamps.append(float(values["timestamp"]))  # type: ignore[arg-type]
            slowest = max(slowest, float(values["actual_execution_time"]))  # type: ignore[arg-type]
        assert all(b - a == pytest.approx(PERIOD) for a, b in pairwise(stamps))
        assert arrivals[-1] - arrivals[0] > 1.15 * 200 * PERIOD, "late cycles were made up for"
        assert slowest >= 7.0
        assert served.timing[1] >= 3 * 15


class _Link:
    """Drops, delays and doubles data packets; freezes nothing."""

    def __init__(self) -> None:
        self.count = 0
        self.is_cut = False

    def incoming(self, message: bytes, now: float) -> Sequence[Delivery]:
        return [Delivery(message)]

    def outgoing(self, message: bytes, now: float) -> Sequence[Delivery]:
        if message[2] != Kind.DATA:
            return [Delivery(message)]
        self.count += 1
        if self.count == 3:
            return []
        if self.count == 5:
            return [Delivery(message), Delivery(message)]
        return [Delivery(message, 0.05 if self.count == 8 else 0.0)]

    def cut(self, now: float) -> bool:
        return self.count >= 20


class _Faults(NoFaults):
    def version(self) -> tuple[int, int, int, int]:
        return (5, 8, 0, 1)

    def in_use(self, name: str) -> bool:
        return name == "input_int_register_23"

    def link(self, server: Server, peer: str) -> LinkFaults | None:
        return _Link() if server is Server.RTDE else None


def test_faults_disturb_what_they_are_asked_about() -> None:
    with running(faults=_Faults()) as served, connect(served) as client:
        assert client.version() == (5, 8, 0, 1)
        with pytest.raises(BackendError, match="ft_raw_wrench NOT_FOUND"):
            client.subscribe(["ft_raw_wrench"])
        with pytest.raises(BackendError, match="IN_USE"):
            client.claim(["input_int_register_23"])
        client.subscribe(["timestamp"], 500)
        stamps = []
        with pytest.raises(BackendError, match="closed the connection"):
            while True:
                stamps.append(float(client.read()["timestamp"]))  # type: ignore[arg-type]
        cycles = [round((stamp - stamps[0]) / PERIOD) + 1 for stamp in stamps]
        assert cycles[:7] == [1, 2, 4, 5, 5, 6, 7]
        assert cycles == sorted(cycles), "a delay may not change the order"


def test_a_refused_client_meets_a_closed_door() -> None:
    class Closed(NoFaults):
        def refuse(self, server: Server, peer: str) -> bool:
            return server is Server.RTDE

    with running(faults=Closed()) as served, pytest.raises(BackendError, match=r"closed the connection|gone"):
        connect(served)


def test_a_taken_port_is_said_in_one_line(emulator: Emulator) -> None:
    said = r"cannot serve rtde on 127\.0\.0\.1:\d+: Address already in use"
    with pytest.raises(BackendError, match=said), running(ports=Ports(0, 0, 0, 0, emulator.ports.rtde, 0)):
        pass


def test_the_arm_moves_in_the_stream(emulator: Emulator, client: RtdeClient) -> None:
    client.subscribe(["actual_q", "actual_qd", "runtime_state", "robot_status_bits"], 500)
    emulator.do(lambda c: c.upload(SWEEP, "test"))
    values = client.read()
    while values["actual_qd"][0] < 0.499:  # type: ignore[index,operator]
        values = client.read()
    assert (values["runtime_state"], values["robot_status_bits"]) == (2, 3)
    emulator.do(lambda c: c.runtime.stop())
    until(emulator, lambda c: not c.mover.moving)
