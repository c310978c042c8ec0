"""Frames, names and data packets of RTDE: what is written is read again, and garbage is refused."""

from __future__ import annotations

import struct
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.errors import DecodeError
from hil.rtde import codec
from hil.rtde.codec import Kind, Layout
from hil.rtde.fields import FORMATS, FieldType, fields

SIZES = dict(BOOL=1, UINT8=1, UINT32=4, INT32=4, UINT64=8, DOUBLE=8, VECTOR3D=24, VECTOR6D=48)
SIZES |= dict(VECTOR6INT32=24, VECTOR6UINT32=24)


def test_the_table_has_all_fields() -> None:
    table = fields()
    assert len(table) == 419
    assert table["safety_status"].type == "INT32" and not table["safety_status"].input
    assert table["joint_position_deviation_ratio"].type == "DOUBLE"
    inputs = [name for name, field in table.items() if field.input]
    assert len(inputs) == 175 and {"tool_digital_output", "input_int_register_47"} <= set(inputs)
    assert all(Layout([kind]).size == SIZES[kind] for kind in FieldType)


def test_a_known_frame() -> None:
    asks = codec.frame(Kind.OUTPUTS, codec.encode_outputs(125.0, ["timestamp", "actual_q"]))
    assert asks == b"\x00\x1dO" + struct.pack(">d", 125.0) + b"timestamp,actual_q"
    assert codec.frame(Kind.START) == b"\x00\x03S"


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=60)), max_size=5), st.data())
def test_frames_survive_any_cutting(frames: list[tuple[int, bytes]], data: st.DataObject) -> None:
    stream = b"".join(codec.frame(kind, payload) for kind, payload in frames)
    buffer, taken = bytearray(), []
    while stream:
        n = data.draw(st.integers(1, len(stream)))
        buffer += stream[:n]
        stream = stream[n:]
        taken += codec.take_frames(buffer)
    assert taken == frames and not buffer


@settings(deadline=None)
@given(st.binary(max_size=2000))
def test_no_bytes_break_the_decoders(data: bytes) -> None:
    buffer = bytearray(data)
    try:
        for _, payload in codec.take_frames(buffer):
            assert len(payload) <= codec.MAX_FRAME
    except DecodeError:
        pass
    for decode in (
        codec.decode_names,
        codec.decode_outputs,
        codec.decode_recipe,
        codec.decode_version,
        codec.decode_text,
    ):
        with suppress(DecodeError):
            decode(data)


def test_a_size_below_its_header_is_refused() -> None:
    with pytest.raises(DecodeError, match="at least 3"):
        codec.take_frames(bytearray(b"\x00\x02V"))


def test_a_trailing_comma_is_no_name() -> None:
    assert codec.decode_names(b"timestamp,actual_q,") == ("timestamp", "actual_q")


@settings(deadline=None)
@given(st.text(max_size=80), st.text(max_size=20), st.integers(0, 3))
def test_texts(text: str, source: str, level: int) -> None:
    got = codec.decode_text(codec.encode_text(text, source, level))
    assert got[2] == level
    if len(text.encode()) <= 255:
        assert got[0] == text


_VALUES = {
    "?": st.booleans(),
    "B": st.integers(0, 255),
    "I": st.integers(0, 2**32 - 1),
    "i": st.integers(-(2**31), 2**31 - 1),
    "Q": st.integers(0, 2**64 - 1),
    "d": st.floats(allow_nan=False),
}


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(FieldType), min_size=1, max_size=12), st.data())
def test_data_packets(types: list[FieldType], data: st.DataObject) -> None:
    layout, wanted, flat = Layout(types), [], []
    for kind in types:
        char, count = FORMATS[kind]
        values = data.draw(st.tuples(*[_VALUES[char]] * count))
        wanted.append(values if count > 1 else values[0])
        flat += values
    ((kind_, payload),) = codec.take_frames(bytearray(layout.packet(7, flat)))
    assert kind_ == Kind.DATA and payload[0] == 7
    assert layout.unpack(payload[1:]) == wanted
    assert layout.unpack(payload[1:] + b"more than asked for") == wanted
    short = layout.unpack(payload[1:-1])
    assert short == wanted[: len(short)] and len(short) == len(wanted) - 1
