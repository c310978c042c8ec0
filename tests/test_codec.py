"""The codec against rosbags' own CDR, and against everything that must not be accepted."""

from __future__ import annotations

import dataclasses
import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cell.errors import DecodeError, WireError
from cell.wire import types as T
from cell.wire import typestore
from cell.wire.codec import decode, encode, message_classes, ros_type, schema_text

RNG = np.random.default_rng(1)


def joint_state(**changes: Any) -> T.JointState:
    q = RNG.uniform(-3, 3, 6)
    return dataclasses.replace(T.JointState(12.5, q, q / 2, q * 10), **changes)


def frame(width: int = 32, height: int = 24, t: float = 3.25) -> T.Frame:
    rgb = RNG.integers(0, 256, (height, width, 3), dtype=np.uint8)
    depth = RNG.uniform(0, 2, (height, width)).astype(np.float32)
    return T.Frame("belt", 7, t, rgb, depth)


def trajectory(n: int = 50, holder: str = "supervisor") -> T.Trajectory:
    times = np.arange(n) / 125
    return T.Trajectory(9, holder, 1.5, 2.0, times, RNG.uniform(-3, 3, (n, 6)), RNG.uniform(-1, 1, (n, 6)))


def examples() -> list[Any]:
    js, status = joint_state(), T.ArmStatus(12.5, trajectory_id=4, progress=0.25, moving=True, lease="sup")
    gripper, belt = T.GripperState(12.5, 0.05, 0.0, False, True), T.BeltState(12.5, 1, False, 0.0)
    state = T.SupervisorState(
        t=1.0,
        mode=2,
        action=3,
        phase="descend",
        onion_location=1,
        eef_location=2,
        prediction=0,
        own_type=1,
        belief=0.5,
        requested_industrial=False,
        permitted_industrial=False,
        separation=math.inf,
        speed_cap=0.25,
        binding_cap="mode",
        sorted=3,
        in_bin=1,
        on_conveyor=2,
        remaining=12,
        reason="done",
        target=(0.3, 0.1, -0.1),
    )
    return [
        js,
        status,
        trajectory(),
        T.Reply(False, "expired", "the command is 0.6 s old; accepted are 0.5 s"),
        T.Stop("anybody", "Ctrl-C"),
        T.Resume("supervisor"),
        T.GripperCommand("supervisor", 2.0, 0.05, 0.1, 30.0),
        T.LightCommand("supervisor", 2.0, "requested"),
        T.Hands(
            1.5, "person", (T.SeenHand("left", 0.9, "up", (0.5, 0.1, 0.2), RNG.uniform(0, 480, (21, 2))),)
        ),
        gripper,
        T.BeltCommand("supervisor", 15, 2**40),
        belt,
        T.CameraInfo(1.0, "camera_belt", 640, 480, 615.0, 615.0, 319.5, 239.5),
        frame(),
        T.Image(2.0, "belt", frame().rgb),
        T.Image(2.0, "person", frame().depth),
        T.Capture("supervisor"),
        T.Heartbeat("supervisor", 17, 1.0),
        T.Detections(
            1.0, "belt", (T.Box((10.0, 20.0, 50.0, 70.0), "blemished", 0.75), T.Box((0, 0, 1, 1), "ä", 1))
        ),
        state,
        T.StepRequest("supervisor", 5),
        T.StepReply(js, status, gripper, belt),
        T.StepReply(js, status, gripper, belt, (frame(), frame(5, 7))),
        T.ResetRequest("supervisor", 12345, 15),
        T.TruthRequest("judge"),
        T.Truth(
            4.0, np.array([True, False]), ("bin", "belt"), RNG.uniform(-1, 1, (2, 3)), np.ones(2), 1, ("a",)
        ),
        T.Truth(
            4.0,
            np.array([True]),
            ("bin",),
            RNG.uniform(-1, 1, (1, 3)),
            np.ones(1),
            0,
            (),
            np.array([True]),
            T.PersonTruth(
                "ana",
                True,
                8,
                "down",
                0.4,
                RNG.uniform(-1, 1, (2, 3)),
                0,
                (T.ShownGesture("down", 1.0, -1.0),),
            ),
        ),
        T.Event(1.0, 20, "node", "two lines\nof text"),
        T.ClockTick(0.008),
        T.PlannedPath(1.5, RNG.uniform(-1, 1, (7, 3))),
        T.PlannedPath(0.0, np.zeros((0, 3))),
        T.OperatorCommand("view", "cap", 0.1),
        T.NextRound("view", "expert", 15, 2**40),
    ]


def assert_same(a: Any, b: Any) -> None:
    """Equality that looks into dataclasses and arrays, and wants arrays read-only."""
    if dataclasses.is_dataclass(a):
        assert type(a) is type(b)
        for f in dataclasses.fields(a):
            assert_same(getattr(a, f.name), getattr(b, f.name))
    elif isinstance(a, np.ndarray):
        assert a.shape == b.shape and a.dtype == b.dtype and np.array_equal(a, b)
        assert not b.flags.writeable
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b


EXAMPLES = examples()
BYTES = [(type(m), encode(m)) for m in EXAMPLES]
by_name = pytest.mark.parametrize("message", EXAMPLES, ids=lambda m: type(m).__name__)


def test_every_message_class_has_an_example() -> None:
    assert {type(m) for m in EXAMPLES} == set(message_classes())


@by_name
def test_comes_back_as_it_went(message: Any) -> None:
    assert_same(message, decode(type(message), encode(message)))


@by_name
def test_is_the_ros_message_it_claims_to_be(message: Any) -> None:
    """rosbags reads our bytes as the named type and writes the very same ones."""
    store, name, data = typestore.store(), ros_type(type(message)), encode(message)
    assert bytes(store.serialize_cdr(store.deserialize_cdr(data, name), name)) == data


@pytest.mark.parametrize("holder", ["", "a", "ab", "abc", "abcd", "abcde", "abcdef", "abcdefg", "ä"])
@pytest.mark.parametrize("n", [0, 1, 2])
def test_trajectory_at_every_alignment(holder: str, n: int) -> None:
    message = trajectory(n, holder)
    store, name, data = typestore.store(), ros_type(T.Trajectory), encode(message)
    ros: Any = store.deserialize_cdr(data, name)
    assert bytes(store.serialize_cdr(ros, name)) == data
    assert [list(p.positions) for p in ros.trajectory.points] == message.q.tolist()
    assert_same(message, decode(T.Trajectory, data))


def test_ros_names_and_fields() -> None:
    assert ros_type(T.JointState) == "sensor_msgs/msg/JointState"
    assert ros_type(T.Detections) == "vision_msgs/msg/Detection2DArray"
    assert ros_type(T.Event) == "rcl_interfaces/msg/Log"
    assert ros_type(T.Trajectory) == "cell_msgs/msg/TrajectoryCommand"
    ros: Any = typestore.store().deserialize_cdr(encode(joint_state()), "sensor_msgs/msg/JointState")
    assert ros.name[0] == "shoulder_pan_joint" and ros.name[5] == "wrist_3_joint"
    assert (ros.header.stamp.sec, ros.header.stamp.nanosec) == (12, 500_000_000)


def test_schema_text_holds_all_embedded_types() -> None:
    text = schema_text(T.StepReply)
    for part in ("sensor_msgs/JointState", "cell_msgs/Frame", "sensor_msgs/Image", "builtin_interfaces/Time"):
        assert f"MSG: {part}" in text


@by_name
def test_every_cut_and_every_extra_byte_is_refused(message: Any) -> None:
    data = encode(message)
    for n in {*range(min(len(data), 400)), len(data) - 1, len(data) // 2}:
        with pytest.raises(DecodeError):
            decode(type(message), data[:n])
    for tail in (b"\x01", b"\0\0\0\0", bytes(1000)):
        with pytest.raises(DecodeError):
            decode(type(message), data + tail)


@settings(max_examples=400, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.sampled_from(sorted(message_classes(), key=lambda c: c.__name__)),
    st.binary(max_size=600),
    st.booleans(),
)
def test_any_bytes_decode_or_raise_decode_error(cls: type[Any], data: bytes, headed: bool) -> None:
    try:
        decode(cls, (b"\0\1\0\0" if headed else b"") + data)
    except DecodeError as error:
        assert "\n" not in str(error)


@settings(max_examples=1500, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(BYTES), st.data())
def test_flipped_bits_decode_or_raise_decode_error(
    valid: tuple[type[Any], bytes], draw: st.DataObject
) -> None:
    cls, data = valid
    damaged = bytearray(data)
    for _ in range(draw.draw(st.integers(1, 3))):
        at = draw.draw(st.integers(0, min(len(data), 700) - 1))
        damaged[at] ^= 1 << draw.draw(st.integers(0, 7))
    try:
        decode(cls, bytes(damaged))
    except DecodeError as error:
        assert "\n" not in str(error)


@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(BYTES), st.data())
def test_wild_lengths_decode_or_raise_decode_error(
    valid: tuple[type[Any], bytes], draw: st.DataObject
) -> None:
    """Any aligned word may be a count: huge ones must not allocate or loop."""
    cls, data = valid
    damaged = bytearray(data)
    at = 4 * draw.draw(st.integers(1, max(1, min(len(data), 700) // 4 - 1)))
    struct.pack_into("<I", damaged, at, draw.draw(st.sampled_from([0, 2**31 - 1, 2**31, 2**32 - 1, 2**24])))
    try:
        decode(cls, bytes(damaged))
    except DecodeError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["q", "qd"])
def test_trajectory_with_a_number_that_is_none(field: str, value: float) -> None:
    message = trajectory()
    getattr(message, field)[20, 3] = value
    with pytest.raises(DecodeError, match=f"trajectory {field} contains (NaN|infinity)"):
        decode(T.Trajectory, encode(message))


@pytest.mark.parametrize("field", ["q", "qd", "effort"])
def test_joint_state_with_nan(field: str) -> None:
    bad = np.array([0, 0, math.nan, 0, 0, 0])
    with pytest.raises(DecodeError, match=f"{field} contains NaN"):
        decode(T.JointState, encode(joint_state(**{field: bad})))


def test_scalars_must_be_finite_but_separation_may_be_infinite() -> None:
    with pytest.raises(DecodeError, match="width is nan"):
        decode(T.GripperCommand, encode(T.GripperCommand("a", 1.0, math.nan, 0.1, 30.0)))
    state = next(m for m in EXAMPLES if isinstance(m, T.SupervisorState))
    assert decode(T.SupervisorState, encode(state)).separation == math.inf
    with pytest.raises(DecodeError, match="separation is nan"):
        decode(T.SupervisorState, encode(dataclasses.replace(state, separation=math.nan)))


@pytest.mark.parametrize("value", [math.nan, math.inf, -0.5])
def test_depth_must_be_finite_and_not_negative(value: float) -> None:
    f = frame()
    f.depth[3, 4] = value
    with pytest.raises(DecodeError, match="depth contains"):
        decode(T.Frame, encode(f))


def test_an_image_names_the_frame_of_its_camera_info() -> None:
    ros = _ros(T.Image(1.0, "belt", frame().rgb))
    assert ros.header.frame_id == "camera_belt"
    ros.header = dataclasses.replace(ros.header, frame_id="map")
    with pytest.raises(DecodeError, match="frame_id 'map' does not start with camera_"):
        decode(T.Image, _bytes(ros))


def _ros(message: Any) -> Any:
    return typestore.store().deserialize_cdr(encode(message), ros_type(type(message)))


def _bytes(ros: Any) -> bytes:
    return bytes(typestore.store().serialize_cdr(ros, ros.__msgtype__))


def test_foreign_joint_names_and_lengths_are_refused() -> None:
    ros = _ros(joint_state())
    swapped = dataclasses.replace(ros, name=[*ros.name[1:], ros.name[0]])
    with pytest.raises(DecodeError, match="joint names must be shoulder_pan_joint"):
        decode(T.JointState, _bytes(swapped))
    seven = dataclasses.replace(ros, position=np.zeros(7))
    with pytest.raises(DecodeError, match="q has 7 values instead of 6"):
        decode(T.JointState, _bytes(seven))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"encoding": "bgr8"}, "legal values: rgb8, 32FC1"),
        ({"width": 33}, "does not fit"),
        ({"width": 0}, "0 x 24 pixels"),
        ({"height": 5000}, "32 x 5000 pixels"),
        ({"step": 97}, "does not fit"),
        ({"is_bigendian": 1}, "does not fit"),
        ({"data": np.zeros(10, np.uint8)}, "does not fit"),
    ],
)
def test_inconsistent_images_are_refused(changes: dict[str, Any], complaint: str) -> None:
    ros = _ros(T.Image(1.0, "belt", frame().rgb))
    with pytest.raises(DecodeError, match=complaint):
        decode(T.Image, _bytes(dataclasses.replace(ros, **changes)))


def test_limits_on_length_and_size() -> None:
    message = trajectory(20_000)
    assert_same(message.q, decode(T.Trajectory, encode(message)).q)
    with pytest.raises(WireError, match="at most 20000"):
        encode(trajectory(20_001))
    long = _ros(T.Stop("a", "b"))
    with pytest.raises(DecodeError, match="reason is longer than 4096 bytes"):
        decode(T.Stop, _bytes(dataclasses.replace(long, reason="x" * 5000)))
    with pytest.raises(DecodeError, match="at most 65536 are allowed"):
        decode(T.Stop, _bytes(dataclasses.replace(long, reason="x" * 70_000)))


def test_points_with_accelerations_or_too_few_values_are_refused() -> None:
    ros = _ros(trajectory(3))
    ros.trajectory.points[1].accelerations = np.zeros(6)
    with pytest.raises(DecodeError):
        decode(T.Trajectory, _bytes(ros))
    ros = _ros(trajectory(3))
    ros.trajectory.points[2].positions = np.zeros(5)
    with pytest.raises(DecodeError):
        decode(T.Trajectory, _bytes(ros))


@pytest.mark.parametrize("t", [-1.0, math.nan, math.inf, 2.0**31])
def test_times_that_ros_cannot_hold_are_not_sent(t: float) -> None:
    with pytest.raises(WireError, match="cannot be sent"):
        encode(T.ClockTick(t))


@pytest.mark.parametrize(
    "message",
    [
        joint_state(q=np.zeros(5)),
        T.Stop("a", "x" * 5000),
        T.Stop("a", None),  # type: ignore[arg-type]
        T.StepRequest("a", 2**40),
        T.Image(1.0, "belt", np.zeros((4, 4), np.uint8)),
        T.Frame("belt", 1, 1.0, frame().rgb, frame(5, 5).depth),
        T.StepReply(joint_state(), T.ArmStatus(1.0), EXAMPLES[7], EXAMPLES[9], (frame(),) * 9),
        "no message",
    ],
    ids=lambda m: type(m).__name__,
)
def test_what_does_not_fit_is_a_wire_error(message: Any) -> None:
    with pytest.raises(WireError):
        encode(message)


def test_images_need_not_be_contiguous() -> None:
    f = frame(40, 30)
    part = T.Frame("belt", 1, 1.0, f.rgb[::2, ::-1], f.depth[::2, ::-1])
    assert_same(part, decode(T.Frame, encode(part)))


@settings(deadline=None)
@given(st.integers(0, (2**31 - 1) * 10**9))
def test_a_time_sent_again_stays_the_same(ns: int) -> None:
    once = decode(T.ClockTick, encode(T.ClockTick(ns / 10**9))).t
    assert abs(once - ns / 10**9) < 3e-7
    if ns < 10**15:  # eleven days of simulated time: exact to the nanosecond
        assert once == ns / 10**9


def test_wall_clock_times_keep_their_microseconds() -> None:
    t = 1_780_000_000.123456
    assert decode(T.ClockTick, encode(T.ClockTick(t))).t == pytest.approx(t, abs=3e-7)
