"""Whole rounds as users run them: processes, wire, recording, result. Slow, so there are few."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import cv2
import numpy as np

from cell import __version__
from cell.clock import WallClock, perf_s
from cell.config import load
from cell.limits import tcp_positions
from tests.test_cli import CELL, free_port, nodes, overlay

CONTRACT = {
    "backend": str,
    "policy": str,
    "seed": int,
    "person": str,
    "onions": int,
    "sorted": int,
    "by_robot": int,
    "by_human": int,
    "misplaced": int,
    "dropped": int,
    "sort_time_s": float,
    "mode_switches": int,
    "industrial_s": float,
    "min_separation_m": (float, type(None)),
    "max_tcp_speed_m_s": dict,
    "gesture_delay_s": (float, type(None)),
    "real_time_factor": float,
    "commit": str,
    "version": str,
}
OURS = {
    "failure": str,
    "arm_contacts": int,
    "joint_states_lost": int,
    "joint_limits": dict,
    "sha256": dict,
    "misses": list,
    "yields": int,
    "person_contacts": int,
    "misplaced_by_human": int,
}
SEED = 1


@cache
def two_rounds() -> tuple[Path, list[subprocess.CompletedProcess[str]]]:
    """The same round twice, at the same time: the first recorded, the second not."""
    folder = Path(mkdtemp())
    runs = []
    for name, extra in (("first", ["--record", str(folder / "first.mcap")]), ("second", [])):
        port = free_port()
        (folder / name).mkdir()
        file, _ = overlay(folder / name, port=port)
        command = [*CELL, "run", "--headless", "--onions", "2", "--seed", str(SEED), "--config", str(file)]
        command += ["--json", str(folder / f"{name}.json"), *extra]
        env = {**os.environ, "CELL_TEST": str(port), "OMP_NUM_THREADS": "1"}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        runs.append((port, subprocess.Popen(command, text=True, env=env, **pipes)))
    done = []
    for port, run in runs:
        out, err = run.communicate(timeout=120)
        done.append(subprocess.CompletedProcess(run.args, run.returncode, out, err))
        assert nodes(port) == []
    return folder, done


def result(name: str) -> dict[str, Any]:
    folder, _ = two_rounds()
    data: dict[str, Any] = json.loads((folder / f"{name}.json").read_text())
    return data


def test_the_result_has_the_keys_of_the_contract_in_their_types() -> None:
    data = result("first")
    assert set(data) == set(CONTRACT) | set(OURS)
    for key, kind in {**CONTRACT, **OURS}.items():
        assert isinstance(data[key], kind), key
    assert (data["backend"], data["policy"], data["seed"]) == ("sim", "tb-decairl", SEED)
    assert (data["person"], data["onions"], data["version"]) == ("ana", 2, __version__)
    assert set(data["max_tcp_speed_m_s"]) == {"collaborative", "industrial"}
    assert 0.0 < data["min_separation_m"] < 1.0 and data["person_contacts"] == 0
    assert data["real_time_factor"] > 0.0


def test_the_exit_code_agrees_with_the_content() -> None:
    _, runs = two_rounds()
    for name, run in zip(("first", "second"), runs, strict=True):
        data = result(name)
        good = not data["failure"] and data["dropped"] == 0 and data["sorted"] >= data["onions"]
        assert run.returncode == (0 if good else 1), run.stderr
        assert "Traceback" not in run.stderr and run.stdout == ""
        assert f"{data['sorted']} of 2" in run.stderr
        assert data["sorted"] == data["by_robot"] + data["by_human"] == 2
        assert data["misplaced"] + data["dropped"] == len(data["misses"])


def test_what_was_executed_keeps_within_speed_and_touches_nothing() -> None:
    data, motion = result("first"), load().motion
    assert data["max_tcp_speed_m_s"]["collaborative"] <= motion.collaborative_speed
    assert data["arm_contacts"] == 0
    assert data["joint_limits"]["speed_share"] <= 1.0


def test_the_same_seed_gives_the_same_bits_recorded_or_not() -> None:
    first, second = result("first"), result("second")
    assert (first["joint_states_lost"], second["joint_states_lost"]) == (0, 0)
    assert set(first["sha256"]) == {"joint_states", "images", "decisions"}
    for key in set(first) - {"real_time_factor"}:
        assert first[key] == second[key], key


def test_the_recording_opens_with_others_libraries_and_holds_the_round() -> None:
    from mcap.reader import make_reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)  # standard messages as ROS 2 defines them
    folder, _ = two_rounds()
    data = result("first")
    color_topic, depth_topic = "/cell/camera/belt/color/compressed", "/cell/camera/belt/depth/compressedDepth"
    times, q, images, topics = [], [], {}, set()
    with (folder / "first.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            topics.add(channel.topic)
            assert schema is not None
            if channel.topic == "/cell/arm/joint_states":
                state = store.deserialize_cdr(message.data, schema.name)
                times.append(message.log_time * 1e-9)
                q.append(state.position)
            elif channel.topic in (color_topic, depth_topic):
                images[channel.topic] = store.deserialize_cdr(message.data, schema.name)
    assert topics >= {"/cell/arm/status", "/cell/gripper/state", "/cell/supervisor/state", "/cell/events"}
    assert topics >= {"/cell/perception/detections", "/cell/camera/belt/camera_info"}
    period = load().arm.control_period
    np.testing.assert_allclose(np.diff(times), period, atol=1e-6)  # complete: not one is missing
    assert times[-1] - times[0] >= data["sort_time_s"]
    p_WT = tcp_positions(np.array(q), load().gripper.length)
    speed = np.linalg.norm(p_WT[2:] - p_WT[:-2], axis=1) / (2 * period)
    assert abs(speed.max() - data["max_tcp_speed_m_s"]["collaborative"]) < 1e-6
    color, depth = images[color_topic], images[depth_topic]
    assert color.format.startswith("rgb8; jpeg") and depth.format.startswith("32FC1; compressedDepth")
    picture = cv2.imdecode(np.frombuffer(bytes(color.data), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (480, 640, 3) and picture.std() > 10
    # compressed_depth_image_transport: 12 bytes (format, a, b), then a PNG of a / metres + b
    _, a, b = struct.unpack("<iff", bytes(depth.data[:12]))
    counts = cv2.imdecode(np.frombuffer(bytes(depth.data[12:]), np.uint8), cv2.IMREAD_UNCHANGED)
    assert counts.shape == (480, 640) and counts.dtype == np.uint16
    assert 0.5 < np.median(a / (counts[counts > 0] - b)) < 2.0


def interrupted(folder: Path, number: int) -> tuple[int, list[str], int]:
    """A real-time round ended by a signal while the arm moves: exit code, stderr, its port."""
    folder.mkdir()
    file, port = overlay(folder)
    run = subprocess.Popen(
        [
            *CELL,
            "run",
            "--onions",
            "2",
            "--seed",
            "1",
            "--config",
            str(file),
            "--record",
            str(folder / "r.mcap"),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "CELL_TEST": str(port)},
    )
    try:
        clock, deadline = WallClock(), perf_s() + 40.0
        recording = folder / "r.mcap"
        while not (recording.is_file() and recording.stat().st_size > 100_000):
            assert run.poll() is None and perf_s() < deadline
            clock.sleep_until(clock.now() + 0.05)
        clock.sleep_until(clock.now() + 0.5)
        run.send_signal(number)
        _, err = run.communicate(timeout=20)
    finally:
        run.kill()
    return run.returncode, err.splitlines(), port


def test_an_interrupted_real_time_round_stops_the_arm_and_leaves_nothing_behind(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    from cell.wire.codec import decode
    from cell.wire.types import ArmStatus

    code, lines, port = interrupted(tmp_path / "int", signal.SIGINT)
    assert code == 130
    assert lines[-1] == "cell: interrupted; the arm was stopped on its path"
    assert not any("Traceback" in line for line in lines)
    assert nodes(port) == []
    with (tmp_path / "int" / "r.mcap").open("rb") as file:
        last = [m for _, c, m in make_reader(file).iter_messages() if c.topic == "/cell/arm/status"][-1]
    status = decode(ArmStatus, last.data)
    assert status.stopped and not status.moving and "interrupted" in status.stop_reason


def test_a_node_whose_parent_is_killed_ends_by_itself(tmp_path: Path) -> None:
    file, port = overlay(tmp_path)
    run = subprocess.Popen(
        [sys.executable, "-m", "cell.cli", "run", "--onions", "1", "--config", str(file)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "CELL_TEST": str(port)},
    )
    clock, deadline = WallClock(), perf_s() + 40.0
    while not nodes(port):
        assert run.poll() is None and perf_s() < deadline
        clock.sleep_until(clock.now() + 0.05)
    run.kill()
    run.wait()
    deadline = perf_s() + 15.0
    while nodes(port):
        assert perf_s() < deadline, "the node outlived its parent"
        clock.sleep_until(clock.now() + 0.05)
