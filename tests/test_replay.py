"""Recorded decisions taken again: identical today, and a change is caught at the right tick."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from cell.cli import app
from cell.decision import skills
from cell.decision.io import Command, Inputs, Outputs
from cell.errors import CellError, DecodeError
from cell.perception.hands.landmarks import Hand
from cell.perception.hands.roi import Roi
from cell.record import tick
from cell.record.content import INPUTS, OUTPUTS
from cell.record.mcap_reader import Recorded as Item
from cell.record.mcap_reader import Recording
from cell.record.mcap_writer import McapFile
from cell.record.stored_frame import restore, store
from cell.record.tick import Search
from cell.replay.difference import first_difference
from cell.replay.recorded import Recorded
from cell.replay.replay import replay
from cell.version import machine
from cell.wire import pictures
from cell.wire import types as T
from tests.test_codec import assert_same, trajectory
from tests.test_codec import examples as wire_examples

DATA = Path(__file__).parent / "data"
ALONE, BESIDE = DATA / "alone.mcap", DATA / "beside-person.mcap"
ALONE_TICKS, BESIDE_TICKS = 150, 240
INSPECTED = 102
"""Tick of `ALONE` at which the onion in the hand is judged."""
RNG = np.random.default_rng(7)


def within(recorded: Recorded) -> float:
    """On the machine type of the recording every byte must be the same, elsewhere last bits may differ."""
    return 0.0 if recorded.then.facts["machine"] == machine() else 1e-6


# -- regression: the recordings that come with the tests ---------------------------------------------


@pytest.mark.parametrize(("path", "ticks"), [(ALONE, ALONE_TICKS), (BESIDE, BESIDE_TICKS)], ids=str)
def test_todays_supervisor_decides_as_it_did(path: Path, ticks: int) -> None:
    recorded = Recorded(path)
    verdict = replay(recorded, within=within(recorded))
    assert verdict.difference is None, "\n".join(verdict.difference.lines())
    assert verdict.ticks == ticks and not verdict.ended_early


def test_a_changed_threshold_is_caught_where_it_first_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    """No onion is ever blemished enough: the first one inspected goes the other way."""
    monkeypatch.setattr(skills, "BLEMISHED_ABOVE", 1.1)
    recorded = Recorded(ALONE)
    difference = replay(recorded, within=within(recorded)).difference
    assert difference is not None and difference.tick == INSPECTED
    assert difference.then != difference.now
    assert "it said then:  inspect: done: blemish seen" in "\n".join(difference.lines())


def test_a_changed_configuration_is_caught_too() -> None:
    """Nothing is certain enough to be an onion: the first look finds none."""
    recorded = Recorded(ALONE)
    section = msgspec.structs.replace(recorded.then.config.supervisor, score_threshold=0.999)
    config = msgspec.structs.replace(recorded.then.config, supervisor=section)
    recorded.then = dataclasses.replace(recorded.then, config=config)
    difference = replay(recorded, within=within(recorded)).difference
    assert difference is not None and difference.tick == 2


# -- recordings that cannot be replayed --------------------------------------------------------------


def copy(
    source: Path, target: Path, keep: Any = lambda item: True, facts: dict[str, str] | None = None
) -> Path:
    """A recording's decisions with changes."""
    about, files = {}, {}
    items: list[Item] = []
    for item in Recording(source).items(frozenset({INPUTS, OUTPUTS})):
        if isinstance(item, Item):
            items.append(item)
        elif hasattr(item, "metadata"):
            about = {**item.metadata, **(facts or {})}
        else:
            files[item.name] = item.data
    file = McapFile(target)
    file.describe("cell", about, files)
    for item in filter(keep, items):
        file.add(item.topic, item.ros_type, item.t / 1e9, item.sequence, item.payload)
    file.close()
    return target


def run_cli(path: Path) -> tuple[int, str]:
    """Exit code (2 for a CellError, as `main` makes of it) and what was said."""
    result = CliRunner().invoke(app, ["replay", str(path)])
    if isinstance(result.exception, CellError):
        return 2, str(result.exception)
    return result.exit_code, result.output


def test_the_command_says_what_it_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start = copy(ALONE, tmp_path / "start.mcap", lambda item: item.sequence < 4)
    if within(Recorded(start)) == 0.0:
        code, text = run_cli(start)
        assert code == 0 and "identical, byte for byte: 4 ticks" in text
    monkeypatch.setattr("cell.decision.supervisor._INFO", 10)
    code, text = run_cli(start)
    assert (
        code == 1
        and "first difference at tick 0" in text
        and "recorded: 20" in text
        and "today:    10" in text
    )


def test_what_cannot_be_replayed_is_refused_in_a_line(tmp_path: Path) -> None:
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"junk" * 100)
    empty = tmp_path / "empty.mcap"
    McapFile(empty).close()
    cases = [
        (tmp_path / "no.mcap", "cannot read"),
        (junk, "no MCAP recording"),
        (empty, "holds no decisions to replay; record a round with"),
        (copy(ALONE, tmp_path / "a.mcap", lambda i: i.sequence != 1), "tick 1 was not recorded"),
        (copy(ALONE, tmp_path / "b.mcap", facts={"format": "99"}), "this version reads 1 and 2"),
        (copy(ALONE, tmp_path / "c.mcap", facts={"companion": "oracle"}), "knew more than was recorded"),
    ]
    for path, complaint in cases:
        code, text = run_cli(path)
        assert code == 2 and complaint in text and "\n" not in text


def test_a_recording_without_an_end_is_replayed_as_far_as_it_goes(tmp_path: Path) -> None:
    path = copy(ALONE, tmp_path / "a.mcap", lambda item: item.sequence < 4)
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.rindex(b"\x89MCAP0\r\n") - 200])
    recorded = Recorded(path)
    verdict = replay(recorded, within=within(recorded))
    assert verdict.difference is None and verdict.ended_early


# -- what a tick is stored as ------------------------------------------------------------------------


def hand() -> Hand:
    landmarks = RNG.uniform(60, 90, (21, 2))
    return Hand(landmarks, RNG.normal(size=(21, 3)), 0.9, 0.25, 0.75, Roi(75.0, 75.0, 60.0, 0.5))


def frame(camera: str = "belt", unit: bool = True) -> T.Frame:
    rgb = RNG.integers(0, 256, (121, 160, 3), dtype=np.uint8)
    depth = RNG.integers(0, 3000, (121, 160)).astype(np.float32) * np.float32(0.001)
    return T.Frame(camera, 3, 1.24, rgb, depth if unit else depth * np.float32(1.01))


def example() -> tuple[Inputs, Outputs, tuple[Search, ...]]:
    by_type = {type(m): m for m in wire_examples()}
    inputs = Inputs(
        12.5,
        by_type[T.JointState],
        by_type[T.ArmStatus],
        by_type[T.GripperState],
        by_type[T.BeltState],
        (frame(), frame("person")),
        ((4, T.Reply(True)), (5, T.Reply(False, "expired", "late"))),
    )
    outputs = Outputs(
        (Command(7, trajectory()), Command(8, T.Capture("a"), "belt")),
        by_type[T.SupervisorState],
        (T.Detections(1.0, "belt", (T.Box((10.0, 20.0, 50.0, 70.0), "blemished", 0.75),)),),
        (by_type[T.Event],),
        (by_type[T.Hands],),
        True,
        "why",
    )
    return inputs, outputs, (Search((Roi(1.0, 2.0, 3.0, 0.5), Roi(4.0, 5.0, 6.0)), (hand(),)),)


def test_a_tick_comes_back_bit_for_bit() -> None:
    inputs, outputs, searches = example()
    n, again, found = tick.decode_inputs(
        tick.encode_inputs(5, inputs, searches, frozenset({"belt", "person"}))
    )
    assert n == 5
    for a, b in zip(inputs.frames, again.frames, strict=True):
        assert np.array_equal(a.rgb, b.rgb) and a.depth.tobytes() == b.depth.tobytes()
        assert (a.camera, a.seq, a.t) == (b.camera, b.seq, b.t)
    assert_same(dataclasses.replace(inputs, frames=()), dataclasses.replace(again, frames=()))
    assert found[0].candidates == searches[0].candidates and found[0].hands[0].roi == searches[0].hands[0].roi
    assert np.array_equal(found[0].hands[0].landmarks, searches[0].hands[0].landmarks)
    n, decided = tick.decode_outputs(tick.encode_outputs(6, outputs))
    assert n == 6 and first_difference(0, 0.0, decided, outputs, 1e-9) is None
    assert tick.encode_outputs(6, decided) == tick.encode_outputs(6, outputs)


def test_depth_that_is_no_whole_number_of_millimetres_is_kept_too() -> None:
    odd = frame(unit=False)
    assert restore(store(odd, whole=True)).depth.tobytes() == odd.depth.tobytes()


def test_of_a_sparse_frame_what_geometry_reads_is_kept() -> None:
    from cell.frames import Pinhole
    from cell.perception.hands.depth import locate_palm

    seen, near = hand(), RNG.integers(600, 640, (121, 160)).astype(np.float32) * np.float32(0.001)
    full = dataclasses.replace(frame("person"), depth=near)
    sparse = restore(store(full, whole=False, hands=(seen,)))
    assert np.array_equal(sparse.depth[::3, ::3], full.depth[::3, ::3]) and not sparse.rgb.any()
    assert (sparse.depth == 0).mean() > 0.5
    pinhole = Pinhole.from_hfov(160, 121, 1.0)
    then, now = locate_palm(seen, full.depth, pinhole), locate_palm(seen, sparse.depth, pinhole)
    assert then is not None and now is not None
    assert np.array_equal(then.p_CP, now.p_CP) and then.readings == now.readings


GOOD = [
    tick.encode_inputs(1, example()[0], example()[2], frozenset({"belt"})),
    tick.encode_outputs(1, example()[1]),
]


@settings(max_examples=150, deadline=None)
@given(
    which=st.integers(0, 1), at=st.integers(0, 10**6), value=st.integers(0, 255), cut=st.integers(0, 300_000)
)
def test_garbled_ticks_are_refused_or_read(which: int, at: int, value: int, cut: int) -> None:
    data = bytearray(GOOD[which])
    data[at % len(data)] = value
    with suppress(DecodeError):
        (tick.decode_outputs if which else tick.decode_inputs)(bytes(data[: max(cut, 8)]))


def packed() -> Iterator[bytes]:
    camera = Recorded(ALONE).then.config.cameras["person"]
    for pixels in (frame().rgb, frame().depth):
        yield pictures.compress(T.Image(1.5, "person", pixels), camera)


PACKED = list(packed())


@settings(max_examples=150, deadline=None)
@given(
    which=st.integers(0, 1), at=st.integers(0, 10**5), value=st.integers(0, 255), cut=st.integers(0, 100_000)
)
def test_garbled_pictures_are_refused_or_read(which: int, at: int, value: int, cut: int) -> None:
    data = bytearray(PACKED[which])
    data[at % min(len(data), 200)] = value
    with suppress(DecodeError):
        pictures.expand(bytes(data[: max(cut, 8)]))


def test_pictures_come_back_within_the_sensors_noise() -> None:
    full = frame("person")
    color, depth = (pictures.expand(data) for data in PACKED)
    assert (color.t, color.camera, depth.camera) == (1.5, "person", "person")
    assert color.pixels.shape == full.rgb.shape
    z = depth.pixels
    assert z.dtype == np.float32 and z.min() >= 0.0 and z.max() < 3.1
