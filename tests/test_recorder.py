"""Recordings: complete, readable by others, and never in the way."""

from __future__ import annotations

import errno
import io
import logging
import os
import signal
import struct
import subprocess
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import ConfigError, DecodeError, WireError
from cell.frames import pose
from cell.limits import tcp_positions
from cell.record.mcap_reader import Recorded, Recording
from cell.record.mcap_writer import McapFile
from cell.record.recorder import Counts, Recorder
from cell.record.transforms import Transforms
from cell.wire import types as T
from cell.wire.codec import decode
from cell.wire.session import Session
from tests.wire_helpers import joints, own_port, pause, start, until


@pytest.fixture
def config() -> CellConfig:
    return own_port()


@pytest.fixture
def node(config: CellConfig) -> Iterator[Session]:
    with Session.listen(config, patient=True) as session:  # a busy machine must not lose what tests send
        yield session


EXTRAS = 2 + 5
"""Besides what was sent: description and fixed transforms, and transforms of every fourth joint state."""
RGB, DEPTH = np.full((480, 640, 3), 9, np.uint8), np.full((480, 640), 0.5, np.float32)


def publish_some(session: Session, n: int = 20) -> None:
    k = session.keys
    for i in range(n):
        session.publish(k.joint_states, joints(i / 125))
    session.publish(k.arm_status, T.ArmStatus(1.0, stop_reason="test"))
    session.publish(k.detections, T.Detections(1.0, "belt", (T.Box((1, 2, 3, 4), "blemished", 0.5),)))
    session.publish(k.events, T.Event(1.0, 20, "test", "hello"))
    session.publish_frame(T.Frame("belt", 1, 1.0, RGB, DEPTH))


def wait_for_recorder(session: Session) -> None:
    """Return when somebody listens to everything: what is sent before that is not heard."""
    probe = session._session.declare_publisher(session.keys.heartbeat)
    until(lambda: probe.matching_status.matching, 30.0)
    probe.undeclare()


def records(path: Path) -> list[tuple[Schema | None, Channel, Message]]:
    with path.open("rb") as file:
        return list(make_reader(file).iter_messages())


def salvaged(path: Path) -> list[Message]:
    """What can be read of an unfinished file, front to back."""
    out: list[Message] = []
    with path.open("rb") as file, suppress(McapError, EOFError, ValueError):
        out.extend(record for record in StreamReader(file).records if isinstance(record, Message))
    return out


def test_everything_on_the_wire_is_in_the_file(node: Session, config: CellConfig, tmp_path: Path) -> None:
    path = tmp_path / "round.mcap"
    with Recorder(config, path) as recorder:
        wait_for_recorder(node)
        publish_some(node)
    assert recorder.counts == Counts(written=25)
    rows = records(path)
    assert {c.topic for _, c, _ in rows} == {
        "/cell/arm/joint_states",
        "/cell/arm/status",
        "/cell/perception/detections",
        "/cell/events",
        "/cell/camera/belt/color/compressed",
        "/cell/camera/belt/depth/compressedDepth",
        "/robot_description",
        "/tf",
        "/tf_static",
    }
    with path.open("rb") as file:
        assert make_reader(file).get_header().profile == "ros2"
    joint_rows = [m for _, c, m in rows if c.topic == "/cell/arm/joint_states"]
    assert [m.log_time for m in joint_rows] == [i * 8_000_000 for i in range(20)]
    assert [m.sequence for m in joint_rows] == list(range(1, 21))
    assert decode(T.JointState, joint_rows[5].data).q[0] == 0.04


def test_a_reader_that_knows_only_the_file_can_decode_it(
    node: Session, config: CellConfig, tmp_path: Path
) -> None:
    """Types come from the schemas in the file, as Foxglove or `ros2 bag` would take them."""
    path = tmp_path / "round.mcap"
    with Recorder(config, path):
        wait_for_recorder(node)
        publish_some(node)
    seen: dict[str, Any] = {}
    for schema, channel, message in records(path):
        assert schema is not None and schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
        seen[schema.name] = store.deserialize_cdr(message.data, schema.name)
    assert seen["cell_msgs/msg/ArmStatus"].stop_reason == "test"
    assert seen["rcl_interfaces/msg/Log"].msg == "hello"
    assert seen["std_msgs/msg/String"].data.startswith("<robot")
    assert seen["tf2_msgs/msg/TFMessage"].transforms
    assert bytes(seen["sensor_msgs/msg/CompressedImage"].data[12:20]) == b"\x89PNG\r\n\x1a\n"
    assert (
        seen["vision_msgs/msg/Detection2DArray"].detections[0].results[0].hypothesis.class_id == "blemished"
    )


def test_where_a_recording_may_go(config: CellConfig, tmp_path: Path) -> None:
    notes = tmp_path / "notes.mcap"
    notes.write_text("not a recording")
    folder = tmp_path / "folder.mcap"
    folder.mkdir()
    for path, complaint in [
        (tmp_path / "nowhere" / "x.mcap", "does not exist"),
        (tmp_path / "x.bag", "must end in .mcap"),
        (notes, "no MCAP recording, so it is not replaced"),
        (folder, "not a file"),
    ]:
        with pytest.raises(ConfigError, match=complaint) as caught:
            Recorder(config, path)
        assert "\n" not in str(caught.value)
    assert notes.read_text() == "not a recording"


def test_an_old_recording_is_replaced(node: Session, config: CellConfig, tmp_path: Path) -> None:
    path = tmp_path / "round.mcap"
    for n in (30, 3):
        with Recorder(config, path):
            wait_for_recorder(node)
            for i in range(n):
                node.publish(node.keys.joint_states, joints(i / 125))
    assert sum(c.topic == "/cell/arm/joint_states" for _, c, _ in records(path)) == 3


def test_no_node_no_recording(config: CellConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connect = Session.connect.__func__  # type: ignore[attr-defined]
    monkeypatch.setattr(Session, "connect", classmethod(lambda cls, c: connect(cls, c, timeout=0.2)))
    with pytest.raises(WireError, match="nothing answers"):
        Recorder(config, tmp_path / "x.mcap")


def test_a_slow_disk_costs_samples_and_one_warning(
    node: Session, config: CellConfig, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING), Recorder(config, tmp_path / "x.mcap", max_waiting=100) as recorder:
        wait_for_recorder(node)
        for i in range(20):
            node.publish(node.keys.joint_states, joints(i / 125))  # 316 bytes: more than may ever wait
        node.publish(node.keys.heartbeat, T.Heartbeat("a", 1, 1.0))
    assert (recorder.counts.dropped, recorder.counts.written) == (20, 1)
    assert [r.message for r in caplog.records if "is too slow" in r.message] != []
    assert len(caplog.records) == 1


def test_unknown_types_are_left_out(node: Session, config: CellConfig, tmp_path: Path) -> None:
    with Recorder(config, tmp_path / "x.mcap") as recorder:
        wait_for_recorder(node)
        node._session.put("cell/odd", b"some bytes")
        node.publish(node.keys.heartbeat, T.Heartbeat("a", 1, 1.0))
    assert recorder.counts == Counts(written=1, unknown=1)


RECORD = """
from cell.record.recorder import Recorder
recorder = Recorder(config, {path!r})
print("ready", flush=True)
while not recorder.failed: time.sleep(0.01)
"""


def run(config: CellConfig, code: str) -> subprocess.Popen[str]:
    process = start(config, code)
    assert process.stdout is not None and process.stdout.readline() == "ready\n", process.communicate()
    return process


def test_a_killed_recorder_leaves_what_it_had(node: Session, config: CellConfig, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    process = run(config, RECORD.format(path=str(path)))
    wait_for_recorder(node)
    publish_some(node)
    until(lambda: len(salvaged(path)) == 25 + EXTRAS, 30.0)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert len(salvaged(path)) == 25 + EXTRAS
    recording = Recording(path)
    messages = [item for item in recording.items() if isinstance(item, Recorded)]
    assert len(messages) == 25 + EXTRAS and not recording.finished
    assert sum(m.topic == "/cell/arm/joint_states" for m in messages) == 20


def test_a_full_disk_ends_the_recording_but_nothing_else(
    node: Session, config: CellConfig, tmp_path: Path
) -> None:
    path = tmp_path / "x.mcap"
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))\n"
    code = limit + RECORD.format(path=str(path)) + "print(recorder.failed, recorder.close())"
    process = run(config, code)
    wait_for_recorder(node)
    for i in range(30):
        node.publish(node.keys.joint_states, joints(i / 125))
    until(lambda: len(salvaged(path)) >= 30, 30.0)  # these are flushed
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    for i in range(40):
        node.publish(node.keys.camera("belt", "color"), T.Image(1.0 + i, "belt", noise))
        pause(0.02)
        if process.poll() is not None:
            break
    output, errors = process.communicate(timeout=60.0)
    assert output.startswith("True Counts(written="), errors
    assert errors.count("File too large; it can be read up to there") == 1 and len(errors.splitlines()) == 1
    assert path.stat().st_size <= 200_000
    assert len(salvaged(path)) >= 30


def test_a_disk_that_fills_up_leaves_a_finished_file(
    node: Session,
    config: CellConfig,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path, full = tmp_path / "x.mcap", threading.Event()
    monkeypatch.setattr(McapFile, "full", lambda self: full.is_set())
    with caplog.at_level(logging.WARNING), Recorder(config, path) as recorder:
        wait_for_recorder(node)
        for i in range(20):
            node.publish(node.keys.joint_states, joints(i / 125))
        until(lambda: recorder.counts.written == 20, 30.0)
        full.set()
        node.publish(node.keys.heartbeat, T.Heartbeat("a", 1, 1.0))
        until(lambda: recorder.failed, 30.0)
        node.publish(node.keys.heartbeat, T.Heartbeat("a", 2, 1.1))
        until(lambda: recorder.counts.dropped == 1, 30.0)
    assert recorder.counts.written == 21
    assert [r.message.count("the disk is full") for r in caplog.records] == [1]
    recording = Recording(path)
    assert sum(1 for _ in recording.items(frozenset({"/cell/arm/joint_states"}))) == 20 and recording.finished
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == 21 + EXTRAS


def test_a_full_disk_is_noticed_before_it_is_too_late(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = McapFile(tmp_path / "x.mcap")
    assert not file.full()
    space = os.statvfs_result((4096, 4096, 10**6, 1000, 1000, 0, 0, 0, 0, 255))
    monkeypatch.setattr(os, "fstatvfs", lambda fd: space)
    assert file.full()
    file.close()


class NoSpace(io.BytesIO):
    """A disk of 100 kB."""

    def write(self, data: Any) -> int:
        if self.tell() + len(data) > 100_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


def test_a_write_that_fails_ends_only_the_recording(
    node: Session, config: CellConfig, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "x.mcap"
    with caplog.at_level(logging.WARNING), Recorder(config, path) as recorder:
        wait_for_recorder(node)
        recorder._file._writer._Writer__stream = NoSpace()
        noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
        node.publish(node.keys.camera("belt", "color"), T.Image(1.0, "belt", noise))
        until(lambda: recorder.failed, 30.0)
        node.publish(node.keys.heartbeat, T.Heartbeat("a", 1, 1.0))
    assert "No space left on device" in caplog.text and recorder.counts.written == 0


def test_independent_readers_decode_every_message(node: Session, config: CellConfig, tmp_path: Path) -> None:
    """mcap's own ROS 2 decoder and rosbags, which know nothing of this project."""
    from mcap_ros2.reader import read_ros2_messages
    from rosbags.highlevel import AnyReader

    path = tmp_path / "round.mcap"
    with Recorder(config, path):
        wait_for_recorder(node)
        publish_some(node)
    counts: dict[str, int] = {}
    last: dict[str, Any] = {}
    for message in read_ros2_messages(str(path)):
        counts[message.channel.topic] = counts.get(message.channel.topic, 0) + 1
        last[message.channel.topic] = message.ros_msg
    assert counts == {
        "/cell/arm/joint_states": 20,
        "/cell/arm/status": 1,
        "/cell/perception/detections": 1,
        "/cell/events": 1,
        "/cell/camera/belt/color/compressed": 1,
        "/cell/camera/belt/depth/compressedDepth": 1,
        "/robot_description": 1,
        "/tf_static": 1,
        "/tf": 5,
    }
    others: dict[str, int] = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            decoded = reader.deserialize(raw, connection.msgtype)
            assert decoded.__msgtype__ == connection.msgtype
            others[connection.topic] = others.get(connection.topic, 0) + 1
    assert others == counts
    assert list(last["/cell/arm/joint_states"].position) == [19 / 125] * 6
    color = cv2.imdecode(np.frombuffer(last["/cell/camera/belt/color/compressed"].data, np.uint8), -1)
    assert color.shape == (480, 640, 3) and abs(int(color.mean()) - 9) <= 1
    # Depth as ROS's compressed_depth_image_transport reads it.
    data = bytes(last["/cell/camera/belt/depth/compressedDepth"].data)
    _, a, b = struct.unpack("<iff", data[:12])
    steps = cv2.imdecode(np.frombuffer(data[12:], np.uint8), -1)
    depth = a / (steps.astype(float) - b)
    assert steps.dtype == np.uint16 and np.abs(depth - 0.5).max() < 0.005


def test_a_recording_can_stand_in_for_the_cameras(node: Session, config: CellConfig, tmp_path: Path) -> None:
    from hil.ur3e.file_camera import file_cameras

    path = tmp_path / "round.mcap"
    with Recorder(config, path):
        wait_for_recorder(node)
        for camera in ("belt", "person"):
            node.publish_frame(T.Frame(camera, 1, 1.0, RGB, DEPTH))
    camera = file_cameras(path, config, WallClock())["person"]
    camera.connect()
    frames: list[T.Frame] = []
    until(lambda: frames.extend(camera.take()) or frames, 20.0)
    camera.close()
    assert frames[0].rgb.shape == RGB.shape and np.abs(frames[0].depth - 0.5).max() < 0.005


def test_transforms_put_the_tool_where_the_controller_does(config: CellConfig) -> None:
    transforms, rng = Transforms(config), np.random.default_rng(3)
    store = get_typestore(Stores.ROS2_JAZZY)

    def links(data: bytes) -> dict[str, tuple[str, Any]]:
        rows = store.deserialize_cdr(data, "tf2_msgs/msg/TFMessage").transforms
        return {row.child_frame_id: (row.header.frame_id, row.transform) for row in rows}

    for q in rng.uniform(-2.5, 2.5, (5, 6)):
        tree = links(transforms.static()) | links(transforms.moving(1.0, q, 0.04))
        X, name = np.eye(4), "tcp"
        while name != "base_link":
            name, step = tree[name]
            r, p = step.rotation, step.translation
            R = Rotation.from_quat((r.x, r.y, r.z, r.w)).as_matrix()
            X = pose(R, (p.x, p.y, p.z)) @ X
        assert np.allclose(X[:3, 3], tcp_positions(q[None], config.gripper.length)[0], atol=1e-6)
    assert {"camera_belt", "camera_person"} <= set(tree)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, 10**6), flip=st.integers(0, 10**6), bit=st.integers(0, 7))
def test_damaged_files_are_read_as_far_as_they_go(tmp_path: Path, cut: int, flip: int, bit: int) -> None:
    path = tmp_path / "x.mcap"
    path.unlink(missing_ok=True)
    file = McapFile(path)
    for i in range(30):
        file.add("/a", "std_msgs/msg/String", i / 10, i, bytes([0, 1, 0, 0, i]) * 9)
        if i % 10 == 9:
            file.flush()
    file.close()
    data = bytearray(path.read_bytes())
    data[flip % len(data)] ^= 1 << bit
    path.write_bytes(data[: cut % (2 * len(data))])
    with suppress(DecodeError):
        assert sum(isinstance(item, Recorded) for item in Recording(path).items()) <= 30
