"""Sessions between threads and between processes, in good and in bad times."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from cell.clock import perf_s
from cell.config import CellConfig
from cell.errors import RefusedError, StaleError, WireError
from cell.wire import types as T
from cell.wire.keys import Keys
from cell.wire.service import Tapped
from cell.wire.session import Session
from tests.wire_helpers import joints, own_port, pause, start, until


@pytest.fixture
def config() -> CellConfig:
    return own_port()


@pytest.fixture
def node(config: CellConfig) -> Iterator[Session]:
    with Session.listen(config) as session:
        yield session


@pytest.fixture
def client(node: Session, config: CellConfig) -> Iterator[Session]:
    with Session.connect(config) as session:
        yield session


def test_keys_are_those_of_the_contract() -> None:
    k = Keys("cell")
    assert [k.clock, k.joint_states, k.arm_status, k.trajectory, k.stop, k.resume, k.events, k.all] == [
        "cell/clock",
        "cell/arm/joint_states",
        "cell/arm/status",
        "cell/arm/trajectory",
        "cell/arm/stop",
        "cell/arm/resume",
        "cell/events",
        "cell/**",
    ]
    assert k.camera("belt", "color") == "cell/camera/belt/color"
    with pytest.raises(WireError, match="legal values: color, depth, camera_info, capture"):
        k.camera("belt", "infrared")


def test_latest_has_age_and_goes_stale(node: Session, client: Session) -> None:
    reader = client.latest(client.keys.joint_states, T.JointState)
    with pytest.raises(StaleError, match="cell/arm/joint_states: no message has arrived yet"):
        reader.get(0.0, 1.0)
    pause(0.1)
    for i in range(5):
        node.publish(node.keys.joint_states, joints(i / 10))
    until(lambda: reader.received == 5 or (reader.peek() and reader.received == 5))
    assert reader.get(0.45, 0.1).t == 0.4
    assert reader.age(0.45) == pytest.approx(0.05)
    with pytest.raises(
        StaleError, match=r"arm/joint_states: newest message is 0\.600 s old, accepted are 0\.100 s"
    ):
        reader.get(1.0, 0.1)
    with pytest.raises(StaleError, match=r"0\.400 s ahead"):
        reader.get(0.0, 0.1)
    assert [m.t for m in reader.take_all()] == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert reader.take() is None and reader.peek() is not None
    assert (reader.lost, reader.malformed) == (0, 0)


def test_gaps_are_counted_per_sender(node: Session, client: Session, config: CellConfig) -> None:
    key = node.keys.heartbeat
    reader = node.latest(key, T.Heartbeat)
    beats: list[T.Heartbeat] = []
    with Session.connect(config) as other:
        pause(0.1)
        for i in range(10):
            client.publish(key, T.Heartbeat("a", i, i / 10))
            other.publish(key, T.Heartbeat("b", i, i / 10))
        client._channel(key, T.Heartbeat).seq += 3  # as if three had been lost
        client.publish(key, T.Heartbeat("a", 14, 1.4))
        until(lambda: beats.extend(reader.take_all()) or len(beats) == 21)
    assert [b.seq for b in beats if b.holder == "b"] == list(range(10))
    assert (reader.received, reader.lost) == (21, 3)


def test_overwritten_samples_count_as_lost(node: Session, client: Session) -> None:
    reader = client.latest(client.keys.joint_states, T.JointState)
    pause(0.1)
    node.publish(node.keys.joint_states, joints(0.0))
    assert reader.wait(1.0).t == 0.0
    for i in range(400):
        node.publish(node.keys.joint_states, joints(i / 100))
    pause(0.5)
    assert reader.wait(1.0).t == 3.99
    assert (reader.received, reader.lost) == (1 + 256, 400 - 256)


def test_malformed_samples_are_counted_and_passed_over(node: Session, client: Session) -> None:
    reader = client.latest(client.keys.arm_status, T.ArmStatus)
    pause(0.1)
    node.publish(node.keys.arm_status, T.ArmStatus(1.0))
    node.publish(node.keys.arm_status, joints(2.0))
    node._session.put(node.keys.arm_status, b"no attachment")
    until(lambda: reader.peek() is not None and reader.received == 3)
    assert reader.malformed == 2 and reader.lost == 0
    assert reader.get(1.0, 0.1) == T.ArmStatus(1.0)
    assert "no sequence number" in reader.last_error


def test_frames_arrive_as_pairs(node: Session, client: Session) -> None:
    reader = client.latest_frame("belt")
    pause(0.1)
    rgb, depth = np.zeros((480, 640, 3), np.uint8), np.ones((480, 640), np.float32)
    for i in range(3):
        node.publish_frame(T.Frame("belt", i, i / 10, rgb, depth))
    frames: list[T.Frame] = []
    until(lambda: frames.extend(reader.take_all()) or len(frames) == 3)
    node.publish(node.keys.camera("belt", "color"), T.Image(9.0, "belt", rgb))  # its depth never comes
    node.publish_frame(T.Frame("belt", 5, 0.0, rgb, depth))  # the clock was reset
    until(lambda: frames.extend(reader.take_all()) or len(frames) == 4)
    assert (reader.color.lost, reader.depth.lost) == (0, 0)
    assert [f.t for f in frames] == [0.0, 0.1, 0.2, 0.0]
    assert frames[0].rgb.shape == (480, 640, 3) and not frames[0].depth.flags.writeable


def test_queries_are_answered_whatever_happens(
    node: Session, client: Session, caplog: pytest.LogCaptureFixture
) -> None:
    def handler(stop: T.Stop) -> T.Reply:
        if stop.reason == "refuse":
            raise RefusedError("lease", "somebody else holds the lease")
        if stop.reason == "break":
            raise KeyError("a bug")
        if stop.reason == "nonsense":
            return None  # type: ignore[return-value]
        return T.Reply(True, "", stop.reason)

    key = node.keys.stop
    node.serve(key, T.Stop, handler)
    pause(0.1)
    assert client.call(key, T.Stop("me", "why not"), T.Reply) == T.Reply(True, "", "why not")
    refused = client.call(key, T.Stop("me", "refuse"), T.Reply)
    assert refused == T.Reply(False, "lease", "somebody else holds the lease")
    broken = client.call(key, T.Stop("me", "break"), T.Reply)
    assert (broken.accepted, broken.code) == (False, "error") and "a bug" in broken.reason
    nonsense = client.call(key, T.Stop("me", "nonsense"), T.Reply)
    assert nonsense == T.Reply(False, "error", "NoneType is not a message of cell.wire.types")
    garbled = client.call(key, T.Heartbeat("me", 1, 1.0), T.Reply)
    assert (garbled.accepted, garbled.code) == (False, "decode")
    assert client.call(key, T.Stop("me", "still here"), T.Reply).accepted


def test_refusal_where_another_answer_was_expected(node: Session, client: Session) -> None:
    node.serve(node.keys.sim_step, T.StepRequest, lambda r: T.Reply(False, "lease", f"not {r.holder}'s"))
    pause(0.1)
    with pytest.raises(WireError, match="cell/sim/step refused: lease: not me's"):
        client.call(client.keys.sim_step, T.StepRequest("me", 1), T.StepReply)


def test_no_server_and_a_slow_server(node: Session, client: Session) -> None:
    with pytest.raises(WireError, match="nobody answers cell/arm/stop"):
        client.call(client.keys.stop, T.Stop("me", ""), T.Reply, timeout=1.0)
    release = threading.Event()

    def slow(stop: T.Stop) -> T.Reply:
        release.wait(2.0)
        return T.Reply(True)

    node.serve(node.keys.stop, T.Stop, slow)
    pause(0.1)
    before = perf_s()
    with pytest.raises(WireError, match=r"no answer to cell/arm/stop within 0\.2 s"):
        client.call(client.keys.stop, T.Stop("me", ""), T.Reply, timeout=0.2)
    assert perf_s() - before < 0.5
    release.set()
    assert client.call(client.keys.stop, T.Stop("me", ""), T.Reply).accepted


def test_big_replies_and_many_callers(node: Session, client: Session) -> None:
    rgb, depth = np.full((480, 640, 3), 7, np.uint8), np.ones((480, 640), np.float32)
    count = [0]

    def step(request: T.StepRequest) -> T.StepReply:
        count[0] += 1
        frame = T.Frame("belt", request.ticks, 1.0, rgb, depth)
        belt, gripper = T.BeltState(1.0, 1, False, 0.0), T.GripperState(1.0, 0.0, 0.0, False, False)
        return T.StepReply(joints(1.0), T.ArmStatus(1.0), gripper, belt, (frame,))

    node.serve(node.keys.sim_step, T.StepRequest, step)
    pause(0.1)
    seen: list[int] = []

    def caller(first: int) -> None:
        for i in range(first, first + 10):
            reply = client.call(client.keys.sim_step, T.StepRequest("me", i), T.StepReply, timeout=5.0)
            assert int(reply.frames[0].rgb[3, 3, 0]) == 7
            seen.append(reply.frames[0].seq - i)

    threads = [threading.Thread(target=caller, args=(100 * n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen == [0] * 40 and count == [40]


def test_taps_see_everybody_through_the_node(node: Session, client: Session, config: CellConfig) -> None:
    seen: list[Tapped] = []
    with Session.connect(config) as recorder:

        def store(sample: Tapped) -> None:
            seen.append(sample)
            raise ValueError("a tap that breaks")

        recorder.listen_all(recorder.keys.all, store)
        pause(0.1)
        node.publish(node.keys.joint_states, joints(0.5))
        client.publish(client.keys.heartbeat, T.Heartbeat("me", 1, 0.75))
        until(lambda: len(seen) == 2)
    by_key = {s.key: s for s in seen}
    sample = by_key["cell/arm/joint_states"]
    assert (sample.seq, sample.t, sample.ros_type) == (1, 0.5, "sensor_msgs/msg/JointState")
    assert by_key["cell/supervisor/heartbeat"].t == 0.75


def test_port_in_use_and_nobody_there(node: Session, config: CellConfig) -> None:
    with pytest.raises(
        WireError, match=rf"port {config.port} is in use: .*choose another with 'port:'"
    ) as caught:
        Session.listen(config)
    assert "\n" not in str(caught.value)
    elsewhere = own_port()
    before = perf_s()
    with pytest.raises(WireError, match=rf"nothing answers at tcp/127.0.0.1:{elsewhere.port} after 0\.3 s"):
        Session.connect(elsewhere, timeout=0.3)
    assert perf_s() - before < 1.5


def test_what_has_no_time_is_not_published(client: Session) -> None:
    with pytest.raises(WireError, match="Stop carries no time"):
        client.publish(client.keys.stop, T.Stop("me", ""))


def test_use_after_close(node: Session, client: Session) -> None:
    reader = client.latest(client.keys.joint_states, T.JointState)
    client.close()
    client.close()
    with pytest.raises(WireError, match="session is closed"):
        client.publish(client.keys.heartbeat, T.Heartbeat("me", 1, 1.0))
    with pytest.raises(WireError, match="session is closed"):
        client.call(client.keys.stop, T.Stop("me", ""), T.Reply)
    with pytest.raises(StaleError):
        reader.get(0.0, 1.0)


def test_a_node_that_comes_back_is_found_again(config: CellConfig) -> None:
    first = Session.listen(config)
    with Session.connect(config) as client:
        reader = client.latest(client.keys.joint_states, T.JointState)
        first.close()
        pause(0.2)
        with Session.listen(config) as second:
            second.serve(second.keys.stop, T.Stop, lambda s: T.Reply(True))

            def reached() -> bool:
                second.publish(second.keys.joint_states, joints(1.0))
                return reader.take() is not None

            until(reached, 5.0)
            assert client.call(client.keys.stop, T.Stop("me", ""), T.Reply).accepted


OPEN = """
s = Session.listen(config)
s.serve(s.keys.stop, T.Stop, lambda r: T.Reply(True))
s.listen_all(s.keys.all, lambda sample: None)
reader = s.latest(s.keys.joint_states, T.JointState)
s.publish(s.keys.clock, T.ClockTick(1.0))
peer = Session.connect(config)
"""

EXITS = {
    "module level, never closed": (OPEN, 0),
    "closed, node first": (OPEN + "s.close(); peer.close()", 0),
    "closed, client first": (OPEN + "peer.close(); s.close()", 0),
    "exception": (OPEN + "raise RuntimeError('boom')", 1),
    "system exit": (OPEN + "sys.exit(3)", 3),
    "exception in with": (OPEN + "with s, peer: raise RuntimeError('boom')", 1),
    "in mid-call": (
        OPEN
        + "s.serve(s.keys.resume, T.Resume, lambda r: time.sleep(30))\n"
        + "call = lambda: peer.call(s.keys.resume, T.Resume('a'), T.Reply, timeout=30)\n"
        + "threading.Thread(target=call, daemon=True).start(); time.sleep(0.3); sys.exit(4)",
        4,
    ),
    "closed in mid-handler": (
        OPEN
        + "s.serve(s.keys.resume, T.Resume, lambda r: time.sleep(2))\n"
        + "call = lambda: peer.call(s.keys.resume, T.Resume('a'), T.Reply, timeout=2)\n"
        + "threading.Thread(target=call, daemon=True).start(); time.sleep(0.3); s.close(); peer.close()",
        0,
    ),
    "interrupted in a call": (
        OPEN
        + "s.serve(s.keys.resume, T.Resume, lambda r: time.sleep(30))\n"
        + "threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()\n"
        + "try: peer.call(s.keys.resume, T.Resume('a'), T.Reply, timeout=20)\n"
        + "except KeyboardInterrupt: sys.exit(5)",
        5,
    ),
}


@pytest.mark.parametrize("case", EXITS)
def test_the_interpreter_always_exits(case: str, config: CellConfig) -> None:
    code, expected = EXITS[case]
    process = start(config, code)
    try:
        _, errors = process.communicate(timeout=8.0)
    except subprocess.TimeoutExpired:
        process.kill()
        pytest.fail(f"hangs: {case}")
    assert process.returncode == expected, errors


NODE = OPEN.replace("peer = Session.connect(config)", "") + (
    "s.serve(s.keys.resume, T.Resume, lambda r: time.sleep(30))\nprint('ready', flush=True); time.sleep(60)"
)


def test_client_of_a_killed_node_ends_its_call_and_exits(config: CellConfig) -> None:
    node = start(config, NODE)
    assert node.stdout is not None and node.stdout.readline() == "ready\n"
    code = (
        "peer = Session.connect(config); print('ready', flush=True)\n"
        "try: peer.call(peer.keys.resume, T.Resume('a'), T.Reply, timeout=3)\n"
        "except Exception as error: print(type(error).__name__)"
    )
    client = start(config, code)
    assert client.stdout is not None and client.stdout.readline() == "ready\n"
    pause(0.3)
    node.kill()
    node.communicate()
    output, errors = client.communicate(timeout=8.0)
    assert (client.returncode, output) == (0, "WireError\n"), errors


CLIENT = """
s = Session.connect(config)
a, b = s.latest(s.keys.joint_states, T.JointState), s.latest_frame("belt")
s.listen_all(s.keys.all, lambda sample: None)
print("ready", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("fate", [signal.SIGKILL, signal.SIGSTOP])
def test_a_dead_or_frozen_reader_never_holds_up_the_node(fate: signal.Signals, config: CellConfig) -> None:
    """Joint states and images to one healthy and one dead reader: the first misses nothing."""
    rgb, depth = np.zeros((480, 640, 3), np.uint8), np.ones((480, 640), np.float32)
    with Session.listen(config) as node, Session.connect(config) as healthy:
        reader = healthy.latest(healthy.keys.joint_states, T.JointState)
        victim = start(config, CLIENT)
        assert victim.stdout is not None and victim.stdout.readline() == "ready\n"
        slowest, arrived = 0.0, 0
        os.kill(victim.pid, fate)
        for i in range(250):
            before = perf_s()
            node.publish(node.keys.joint_states, joints(i / 125))
            slowest = max(slowest, perf_s() - before)
            if i % 5 == 0:
                node.publish_frame(T.Frame("belt", i, i / 125, rgb, depth))
            arrived += len(reader.take_all())
            pause(0.004)
        pause(0.1)
        arrived += len(reader.take_all())
        victim.kill()
        victim.communicate()
        assert (arrived, reader.lost) == (250, 0)
        assert slowest < 0.03
