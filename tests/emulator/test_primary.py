"""Primary, secondary and realtime interface: packets byte by byte, and script text."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.errors import DecodeError
from hil.emulator import programs
from hil.emulator.emulator import Emulator
from hil.emulator.interfaces import Program, RobotMode, RuntimeState
from hil.emulator.models import UR3E
from hil.emulator.servers.scripts import split_script
from tests.emulator.ideal import HOME, SWEEP, recognise
from tests.emulator.rig import LATEST, running, take, until

_STATE, _MESSAGE = 16, 20


@pytest.fixture(scope="module")
def emulator() -> Iterator[Emulator]:
    with running() as served:
        yield served


def connect(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), LATEST)


def package(sock: socket.socket) -> tuple[int, bytes]:
    size, kind = struct.unpack(">iB", take(sock, 5))
    return kind, take(sock, size - 5)


def parts(state: bytes) -> dict[int, bytes]:
    """Sub-packets by type."""
    found, at = {}, 0
    while at < len(state):
        size, kind = struct.unpack_from(">IB", state, at)
        found[kind] = state[at + 5 : at + size]
        at += size
    assert at == len(state)
    return found


def state_of(emulator: Emulator, port: int) -> dict[int, bytes]:
    with connect(port) as sock:
        while True:
            kind, content = package(sock)
            if kind == _STATE:
                return parts(content)


def test_the_first_packet_is_the_version(emulator: Emulator) -> None:
    with connect(emulator.ports.primary) as sock:
        kind, content = package(sock)
    stamp, source, message, length = struct.unpack_from(">QbBB", content)
    assert (kind, message) == (_MESSAGE, 3) and stamp > 0 and source == -2
    assert content[11 : 11 + length] == b"URControl"
    assert struct.unpack_from(">BBi", content, 11 + length) == (5, 22, 0)


def test_the_state_has_all_parts_in_full(emulator: Emulator) -> None:
    for port in (emulator.ports.primary, emulator.ports.secondary):
        found = state_of(emulator, port)
        assert {kind: len(content) for kind, content in found.items()} == {
            0: 42,  # robot mode
            1: 246,  # joints
            3: 70,  # masterboard, without a Euromap interface
            4: 96,  # cartesian
            5: 220,  # kinematics
            6: 440,  # configuration
        }
        assert struct.unpack(">I", found[5][-4:]) == (2,)  # calibrated, as clients ask for it
        modes = struct.unpack_from(">Q7?bB3d", found[0])
        assert modes[1:8] == (True, True, True, False, False, False, False)
        assert modes[8] == RobotMode.RUNNING and modes[10:] == (1.0, 1.0, 1.0)
        joints = [struct.unpack_from(">3d4fB", found[1], 41 * i) for i in range(6)]
        assert [joint[0] for joint in joints] == pytest.approx(HOME.tolist())
        assert {joint[7] for joint in joints} == {253}
        pose = struct.unpack_from(">6d", found[4])
        assert np.linalg.norm(pose[:3]) < 0.7
        theta, a, d, alpha = np.array(struct.unpack_from(">24d", found[5], 24)).reshape(4, 6)
        assert not theta.any() and a.tolist() == UR3E.a.tolist()
        assert d.tolist() == UR3E.d.tolist() and alpha.tolist() == UR3E.alpha.tolist()
        limits = np.array(struct.unpack_from(">24d", found[6])).reshape(2, 6, 2)
        assert limits[0, :, 1].tolist() == UR3E.q_max.tolist()
        assert limits[1, :, 0].tolist() == UR3E.qd_max.tolist()
        assert struct.unpack_from(">4i", found[6], len(found[6]) - 16)[2] == 3


def test_states_come_ten_times_a_second(emulator: Emulator) -> None:
    with connect(emulator.ports.secondary) as sock:
        stamps = []
        while len(stamps) < 5:
            kind, content = package(sock)
            if kind == _STATE:
                stamps.append(struct.unpack_from(">Q", parts(content)[0])[0])
    assert np.diff(stamps[1:]).tolist() == [100_000] * 3


def test_realtime_packets(emulator: Emulator) -> None:
    with connect(emulator.ports.realtime) as sock:
        packets = [take(sock, 1220) for _ in range(5)]
    sizes = {struct.unpack_from(">i", packet)[0] for packet in packets}
    rows = np.array([struct.unpack_from(">152d", packet, 4) for packet in packets])
    assert sizes == {1220}
    assert np.diff(rows[:, 0]) == pytest.approx(0.002)
    assert rows[0, 31:37] == pytest.approx(HOME)  # actual joints, after 1 + 5 * 6 doubles
    assert rows[0, 94] == RobotMode.RUNNING and rows[0, 117] == 1.0  # speed scaling


@pytest.mark.parametrize("port", ["primary", "secondary", "realtime"])
def test_script_text_is_run_from_all_three(emulator: Emulator, port: str) -> None:
    with connect(getattr(emulator.ports, port)) as sock:
        head, tail = SWEEP[:20].encode(), SWEEP[20:].encode()
        sock.sendall(head)
        sock.sendall(tail)
        until(emulator, lambda c: c.runtime_state is RuntimeState.PLAYING)
        sock.sendall(b"stop program\n")
        until(emulator, lambda c: c.runtime_state is RuntimeState.STOPPED)


def test_a_secondary_program_runs_beside_another() -> None:
    def either(text: str, peer: str) -> Program:
        return (recognise if text == SWEEP else programs.recognise)(text, peer)

    with running(recognise=either) as emulator, connect(emulator.ports.primary) as sock:
        sock.sendall(SWEEP.encode())
        until(emulator, lambda c: c.runtime_state is RuntimeState.PLAYING)
        with connect(emulator.ports.secondary) as other:
            other.sendall(b"sec light():\n set_digital_out(5, True)\n set_digital_out(6, True)\nend\n")
            until(emulator, lambda c: c.io.digital_out >> 5 & 3 == 3)
        assert emulator.do(lambda c: c.runtime_state) is RuntimeState.PLAYING
        sock.sendall(b"stop program\n")
        until(emulator, lambda c: c.runtime_state is RuntimeState.STOPPED)
        sock.sendall(b"sec dark():\n set_digital_out(5, False)\n set_digital_out(6, False)\nend\n")
        until(emulator, lambda c: c.io.digital_out >> 5 & 3 == 0)


def test_power_from_the_script_port(emulator: Emulator) -> None:
    with connect(emulator.ports.primary) as sock:
        sock.sendall(b"power off\n")
        until(emulator, lambda c: c.robot_mode is RobotMode.POWER_OFF)
        sock.sendall(b"set robotmode run\n")
        until(emulator, lambda c: c.robot_mode is RobotMode.RUNNING)


def test_messages_come_on_the_primary_interface(emulator: Emulator) -> None:
    with connect(emulator.ports.primary) as sock:
        package(sock)
        sock.sendall(b"nonsense()\n")
        kind, content = package(sock)
        while kind != _MESSAGE:
            kind, content = package(sock)
    assert content[9] == 6, "an error code"
    assert content[30:] == b"Program refused: this text is no program that can be run here"


def test_programs_and_popups_are_told_on_the_primary_interface(emulator: Emulator) -> None:
    with connect(emulator.ports.primary) as sock:
        package(sock)
        sock.sendall(b"def short():\nend\n")
        emulator.do(lambda c: c.pendant.show("Mind the gap"))
        found: list[tuple[int, bytes]] = []
        while len(found) < 3:
            kind, content = package(sock)
            if kind == _MESSAGE:
                found.append((content[9], content[10:]))
    assert found[0][0] == 2 and found[0][1].endswith(b"Mind the gap")
    for (kind, content), word in zip(found[1:], (b"STARTED", b"STOPPED"), strict=True):
        assert kind == 7 and content[8] == 19
        assert content[9:] == b"PROGRAM_XXX_" + word + b"short"


def test_who_only_writes_is_kept_and_heard(emulator: Emulator) -> None:
    """A client that never reads what the realtime interface sends; ur-rtde is one."""
    sock = socket.socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    sock.connect(("127.0.0.1", emulator.ports.realtime))
    until(emulator, lambda c: c.steady())
    start = emulator.do(lambda c: c.now)
    until(emulator, lambda c: c.now > start + 0.5)
    sock.sendall(SWEEP.encode())
    until(emulator, lambda c: c.runtime_state is RuntimeState.PLAYING)
    emulator.do(lambda c: c.runtime.stop())
    sock.close()


# -- where a script ends ------------------------------------------------------------------------


def test_a_program_ends_with_end_and_silence() -> None:
    buffer = bytearray(SWEEP.encode())
    assert split_script(buffer, 0.0) == [] and split_script(buffer, 0.04) == []
    assert split_script(buffer, 0.06) == [SWEEP.encode()] and not buffer


def test_an_inner_end_is_not_the_end() -> None:
    buffer = bytearray(b"def a():\n  if True:\n    x = 1\n  end\n  y = 2\n")
    assert split_script(buffer, 0.5) == []
    buffer += b"end\n"
    assert len(split_script(buffer, 0.06)) == 1


def test_programs_sent_in_one_go_are_two() -> None:
    first = "sec a():\n  if True:  # why\n    x = 1\n  end\nend\n\n"
    buffer = bytearray((first + SWEEP).encode())
    assert split_script(buffer, 0.0) == [first.encode()]
    assert split_script(buffer, 0.06) == [SWEEP.encode()]


def test_a_function_within_a_program_begins_no_other() -> None:
    text = b"def a():\ndef helper():\n  x = 1\nend\ndef other():\n  x = 2\nend\nhelper()\nend\n"
    buffer = bytearray(text)
    assert split_script(buffer, 0.04) == [] and split_script(buffer, 0.06) == [text]


def test_single_lines_need_no_silence() -> None:
    buffer = bytearray(b"stop program\nset robotmode run\n# a comment\n" + SWEEP.encode())
    assert split_script(buffer, 0.0) == [b"stop program", b"set robotmode run"]
    assert split_script(buffer, 0.06) == [b"# a comment\n" + SWEEP.encode()]


def test_a_script_has_an_end() -> None:
    with pytest.raises(DecodeError, match="4000000 bytes"):
        split_script(bytearray(b"def a():\n" + b"x = 1\n" * 700_000), 0.0)


@settings(deadline=None)
@given(st.binary(max_size=300), st.floats(0.0, 3.0))
def test_any_bytes_are_split_or_wait(data: bytes, quiet: float) -> None:
    buffer = bytearray(data)
    messages = split_script(buffer, quiet)
    assert sum(map(len, messages)) + len(buffer) <= len(data)
