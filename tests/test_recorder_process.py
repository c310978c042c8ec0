"""The recorder beside the loop: everything arrives, nothing waits for it, no death takes the file along."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cell.clock import perf_s
from cell.config import CellConfig
from cell.decision.io import Inputs, Outputs
from cell.errors import CellError
from cell.record import tick
from cell.record.content import INPUTS, OUTPUTS, About
from cell.record.decision import Decision
from cell.record.mcap_reader import Recorded, Recording
from cell.record.recorder import Counts
from cell.record.recorder_process import RecorderProcess
from cell.wire import types as T
from cell.wire.session import Session
from tests.test_codec import examples
from tests.wire_helpers import joints, own_port, start, until

ABOUT = About({"policy": "expert"}, files={"config.json": b"{}"})
OF = {type(m): m for m in examples()}
RGB, DEPTH = np.full((480, 640, 3), 9, np.uint8), np.full((480, 640), 0.5, np.float32)


@pytest.fixture
def config() -> CellConfig:
    return own_port()


@pytest.fixture
def node(config: CellConfig) -> Iterator[Session]:
    with Session.listen(config, patient=True) as session:
        yield session


def decision(number: int) -> Decision:
    """One with a picture in it: 2 MB on its way, little in the file."""
    t = number / 25
    inputs = Inputs(
        t,
        joints(t),
        OF[T.ArmStatus],  # type: ignore[arg-type]
        OF[T.GripperState],  # type: ignore[arg-type]
        OF[T.BeltState],  # type: ignore[arg-type]
        frames=(T.Frame("belt", number, t, RGB, DEPTH),),
    )
    return Decision(number, inputs, Outputs((), OF[T.SupervisorState]))  # type: ignore[arg-type]


def topics(path: Path) -> list[str]:
    return [item.topic for item in Recording(path).items() if isinstance(item, Recorded)]


def finished(path: Path) -> bool:
    recording = Recording(path)
    return len(list(recording.items())) > 0 and recording.finished


def numbers(path: Path) -> list[int]:
    """Ticks whose decisions are in the file."""
    rows = [item for item in Recording(path).items(frozenset({INPUTS})) if isinstance(item, Recorded)]
    return [tick.decode_inputs(row.payload)[0] for row in rows]


def test_the_wire_and_every_decision_are_in_the_file(
    node: Session, config: CellConfig, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    with RecorderProcess(config, path, ABOUT) as recorder:
        recorder.begin()
        for n in range(30):
            node.publish(node.keys.joint_states, joints(n / 125))
            recorder.decided(decision(n))
        counts = recorder.close()
    assert counts == Counts(written=30, decisions=30)
    assert numbers(path) == list(range(30)) and topics(path).count(OUTPUTS) == 30
    assert topics(path).count("/cell/arm/joint_states") == 30
    assert finished(path)
    _, back, _ = tick.decode_inputs(
        next(i.payload for i in Recording(path).items(frozenset({INPUTS})) if isinstance(i, Recorded))
    )
    assert np.array_equal(back.frames[0].rgb, RGB) and np.array_equal(back.frames[0].depth, DEPTH)


def test_a_recorder_that_stands_still_holds_nobody_up(
    node: Session, config: CellConfig, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.mcap"
    with caplog.at_level(logging.WARNING), RecorderProcess(config, path, ABOUT, max_waiting=9_000_000) as r:
        r.begin()
        os.kill(r.pid, signal.SIGSTOP)
        began = perf_s()
        for n in range(200):
            r.decided(decision(n))
        took = perf_s() - began
        os.kill(r.pid, signal.SIGCONT)
        counts = r.close()
    assert took < 2.0
    assert counts.undecided > 100 and counts.decisions + counts.undecided == 200
    assert sum("is too slow" in r.message for r in caplog.records) == 1
    assert len(numbers(path)) == counts.decisions and finished(path)


def test_in_lock_step_time_waits_for_the_recorder(node: Session, config: CellConfig, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecorderProcess(config, path, ABOUT, patient=True, max_waiting=9_000_000) as recorder:
        recorder.begin()
        os.kill(recorder.pid, signal.SIGSTOP)
        done = threading.Event()

        def loop() -> None:
            for n in range(200):
                recorder.decided(decision(n))
            done.set()

        thread = threading.Thread(target=loop)
        thread.start()
        assert not done.wait(1.0)
        os.kill(recorder.pid, signal.SIGCONT)
        thread.join(60.0)
        counts = recorder.close()
    assert counts == Counts(decisions=200) and numbers(path) == list(range(200))


def test_a_killed_recorder_leaves_its_file_and_the_loop(
    node: Session, config: CellConfig, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.mcap"
    with caplog.at_level(logging.WARNING), RecorderProcess(config, path, ABOUT, patient=True) as recorder:
        recorder.begin()
        for n in range(10):
            recorder.decided(decision(n))
        until(lambda: len(numbers(path)) == 10, 30.0)
        os.kill(recorder.pid, signal.SIGKILL)
        for n in range(10, 300):
            recorder.decided(decision(n))
        counts = recorder.close()
    assert counts.undecided > 0 and counts.decisions == 0  # nobody is left who knows
    assert [r.message for r in caplog.records if "its process is gone" in r.message] != []
    assert len(caplog.records) == 1
    assert numbers(path)[:10] == list(range(10))


def test_when_the_loop_dies_the_file_is_finished(node: Session, config: CellConfig, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    code = f"""
from pathlib import Path
from cell.record.recorder_process import RecorderProcess
from tests.test_recorder_process import ABOUT, decision
recorder = RecorderProcess(config, Path({str(path)!r}), ABOUT)
recorder.begin()
for n in range(10): recorder.decided(decision(n))
print("pid", recorder.pid, flush=True)
time.sleep(60)
"""
    loop: subprocess.Popen[str] = start(config, code)
    assert loop.stdout is not None
    line = loop.stdout.readline()
    assert line.startswith("pid "), loop.communicate()
    until(lambda: len(numbers(path)) == 10, 30.0)
    loop.send_signal(signal.SIGKILL)
    loop.communicate()
    until(lambda: finished(path), 30.0)
    assert numbers(path) == list(range(10))
    until(lambda: not Path(f"/proc/{line.split()[1]}/cmdline").exists() or gone(int(line.split()[1])), 30.0)


def gone(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"


def test_a_recording_that_cannot_be_is_one_clear_line(
    node: Session, config: CellConfig, tmp_path: Path
) -> None:
    with (
        RecorderProcess(config, tmp_path / "nowhere" / "a.mcap", ABOUT) as recorder,
        pytest.raises(CellError, match="does not exist") as caught,
    ):
        recorder.begin()
    assert "\n" not in str(caught.value)


def test_a_decision_that_cannot_be_written_down_is_left_out(
    node: Session, config: CellConfig, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.mcap"
    good = decision(0)
    bad = Decision(2**70, good.inputs, good.outputs)
    with caplog.at_level(logging.WARNING), RecorderProcess(config, path, ABOUT) as recorder:
        recorder.begin()
        for each in (good, bad, decision(2)):
            recorder.decided(each)
        counts = recorder.close()
    assert (counts.decisions, counts.undecided) == (2, 1) and "is left out" in caplog.text
    assert numbers(path) == [0, 2]
