"""Recordings: complete, readable by others, and never in the way."""

from __future__ import annotations

import logging
import signal
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from cell.config import CellConfig
from cell.errors import ConfigError, WireError
from cell.record.recorder import Counts, Recorder
from cell.wire import types as T
from cell.wire.codec import decode
from cell.wire.session import Session
from tests.wire_helpers import joints, own_port, pause, start


@pytest.fixture
def config() -> CellConfig:
    return own_port()


@pytest.fixture
def node(config: CellConfig) -> Iterator[Session]:
    with Session.listen(config) as session:
        yield session


RGB, DEPTH = np.full((480, 640, 3), 9, np.uint8), np.full((480, 640), 0.5, np.float32)


def publish_some(session: Session, n: int = 20) -> None:
    k = session.keys
    for i in range(n):
        session.publish(k.joint_states, joints(i / 125))
    session.publish(k.arm_status, T.ArmStatus(1.0, stop_reason="test"))
    session.publish(k.detections, T.Detections(1.0, "belt", (T.Box((1, 2, 3, 4), "blemished", 0.5),)))
    session.publish(k.events, T.Event(1.0, 20, "test", "hello"))
    session.publish_frame(T.Frame("belt", 1, 1.0, RGB, DEPTH))


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
        pause(0.1)
        publish_some(node)
    assert recorder.counts == Counts(written=25)
    rows = records(path)
    assert {c.topic for _, c, _ in rows} == {
        "/cell/arm/joint_states",
        "/cell/arm/status",
        "/cell/perception/detections",
        "/cell/events",
        "/cell/camera/belt/color",
        "/cell/camera/belt/depth",
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
        pause(0.1)
        publish_some(node)
    seen: dict[str, Any] = {}
    for schema, channel, message in records(path):
        assert schema is not None and schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
        seen[schema.name] = store.deserialize_cdr(message.data, schema.name)
    assert seen["cell_msgs/msg/ArmStatus"].stop_reason == "test"
    assert seen["rcl_interfaces/msg/Log"].msg == "hello"
    image = seen["sensor_msgs/msg/Image"]
    assert (image.width, image.height) == (640, 480)
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
            pause(0.1)
            for i in range(n):
                node.publish(node.keys.joint_states, joints(i / 125))
    assert len(records(path)) == 3


def test_no_node_no_recording(config: CellConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connect = Session.connect.__func__  # type: ignore[attr-defined]
    monkeypatch.setattr(Session, "connect", classmethod(lambda cls, c: connect(cls, c, timeout=0.2)))
    with pytest.raises(WireError, match="nothing answers"):
        Recorder(config, tmp_path / "x.mcap")


def test_a_slow_disk_costs_samples_and_one_warning(
    node: Session, config: CellConfig, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING), Recorder(config, tmp_path / "x.mcap", max_waiting=100) as recorder:
        pause(0.1)
        for i in range(20):
            node.publish(node.keys.joint_states, joints(i / 125))  # 316 bytes: more than may ever wait
        node.publish(node.keys.heartbeat, T.Heartbeat("a", 1, 1.0))
    assert (recorder.counts.dropped, recorder.counts.written) == (20, 1)
    assert [r.message for r in caplog.records if "disk is too slow" in r.message] != []
    assert len(caplog.records) == 1


def test_unknown_types_are_left_out(node: Session, config: CellConfig, tmp_path: Path) -> None:
    with Recorder(config, tmp_path / "x.mcap") as recorder:
        pause(0.1)
        node._session.put("cell/odd", b"some bytes")
        node.publish(node.keys.heartbeat, T.Heartbeat("a", 1, 1.0))
    assert recorder.counts == Counts(written=1, unknown=1)


RECORD = """
from cell.record.recorder import Recorder
recorder = Recorder(config, {path!r})
print("ready", flush=True)
while recorder.counts.written + recorder.counts.dropped < {n}: time.sleep(0.01)
"""


def run(config: CellConfig, code: str) -> subprocess.Popen[str]:
    process = start(config, code)
    assert process.stdout is not None and process.stdout.readline() == "ready\n", process.communicate()
    return process


def test_a_killed_recorder_leaves_what_it_had(node: Session, config: CellConfig, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    process = run(config, RECORD.format(path=str(path), n=10**9))
    pause(0.1)
    publish_some(node)
    pause(1.2)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert len(salvaged(path)) == 25


def test_a_full_disk_ends_the_recording_but_nothing_else(
    node: Session, config: CellConfig, tmp_path: Path
) -> None:
    path = tmp_path / "x.mcap"
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))\n"
    code = limit + RECORD.format(path=str(path), n=70) + "print(recorder.failed, recorder.close())"
    process = run(config, code)
    pause(0.1)
    for i in range(30):
        node.publish(node.keys.joint_states, joints(i / 125))
    pause(0.8)  # these are flushed
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    for i in range(40):
        node.publish(node.keys.camera("belt", "color"), T.Image(1.0 + i, "belt", noise))
        pause(0.02)
    output, errors = process.communicate(timeout=10.0)
    assert output.startswith("True Counts(written="), errors
    assert errors.count("File too large; it can be read up to there") == 1 and len(errors.splitlines()) == 1
    assert path.stat().st_size <= 200_000
    assert len(salvaged(path)) >= 30
