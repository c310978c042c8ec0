"""One decision of the supervisor as two ROS 2 messages: what went in, and what came out.

These never travel on the wire; a recording holds them on `/replay/inputs` and `/replay/outputs`, so
that `cell replay` can take the decision again.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.decision.io import Command, Inputs, Outputs
from cell.errors import DecodeError, WireError, one_of
from cell.perception.hands.landmarks import Hand
from cell.perception.hands.roi import Roi
from cell.record.stored_frame import restore, store
from cell.wire import cdr, codec
from cell.wire.layouts import SMALL, DetectionsLayout, EventLayout, JointStateLayout
from cell.wire.layouts_cell import MAX_FRAMES, FlatLayout
from cell.wire.layouts_image import FRAME_LIMIT
from cell.wire.layouts_person import HandsLayout
from cell.wire.types import (
    ArmStatus,
    BeltState,
    Capture,
    GripperCommand,
    GripperState,
    LightCommand,
    OperatorCommand,
    Reply,
    Resume,
    SupervisorState,
    Trajectory,
)
from cell.wire.typestore import make

INPUTS, OUTPUTS = "cell_msgs/msg/TickInputs", "cell_msgs/msg/TickOutputs"
OPERATOR = "cell_msgs/msg/TickOperator"
_LIMIT = SMALL + 2 * FRAME_LIMIT
_MOST = 1000
"""Most commands, replies, events, ... of one tick."""
_ORDERS: dict[str, type[Any]] = {
    codec.ros_type(cls): cls for cls in (Trajectory, GripperCommand, Capture, Resume, LightCommand)
}
_JOINTS, _ARM, _GRIPPER = JointStateLayout(), FlatLayout(ArmStatus), FlatLayout(GripperState)
_BELT, _REPLY, _STATE = FlatLayout(BeltState), FlatLayout(Reply), FlatLayout(SupervisorState)
_ORDER = FlatLayout(OperatorCommand)
_DETECTIONS, _EVENT, _HANDS = DetectionsLayout(), EventLayout(), HandsLayout()


@dataclass(frozen=True)
class Search:
    """One question to the hand networks: the squares that may show a hand, and the hands found."""

    candidates: tuple[Roi, ...]
    hands: tuple[Hand, ...]


def encode_inputs(tick: int, inputs: Inputs, searches: tuple[Search, ...], whole: frozenset[str]) -> bytes:
    """Inputs of a tick -> CDR, without the operator's orders.

    Args:
        tick: counted from 0. searches: made during the tick.
        whole: cameras whose frames are kept with every pixel.
    """
    found = tuple(hand for search in searches for hand in search.hands)
    message = make(INPUTS)(
        tick,
        cdr.stamp(inputs.t),
        _JOINTS.to_ros(inputs.joints),
        _ARM.to_ros(inputs.arm),
        _GRIPPER.to_ros(inputs.gripper),
        _BELT.to_ros(inputs.belt),
        np.array([ticket for ticket, _ in inputs.replies], np.int64),
        [_REPLY.to_ros(reply) for _, reply in inputs.replies],
        [store(frame, frame.camera in whole, found) for frame in inputs.frames],
        [_search(search) for search in searches],
    )
    return _write(INPUTS, message)


def decode_inputs(data: bytes) -> tuple[int, Inputs, tuple[Search, ...]]:
    """The inverse of `encode_inputs`; pixels that were not kept are 0. Raises DecodeError."""
    ros = _read(INPUTS, data)
    _few(ros.replies, "replies")
    _few(ros.searches, "searches")
    if len(ros.tickets) != len(ros.replies) or len(ros.frames) > MAX_FRAMES:
        raise DecodeError(
            f"tick: {len(ros.tickets)} tickets for {len(ros.replies)} replies, {len(ros.frames)} frames"
        )
    inputs = Inputs(
        t=cdr.seconds(ros.stamp, "stamp"),
        joints=_JOINTS.from_ros(ros.joints),
        arm=_ARM.from_ros(ros.arm),
        gripper=_GRIPPER.from_ros(ros.gripper),
        belt=_BELT.from_ros(ros.belt),
        frames=tuple(restore(frame) for frame in ros.frames),
        replies=tuple(
            (int(ticket), _REPLY.from_ros(reply))
            for ticket, reply in zip(ros.tickets, ros.replies, strict=True)
        ),
    )
    return ros.tick, inputs, tuple(_read_search(search) for search in ros.searches)


def encode_operator(tick: int, inputs: Inputs) -> bytes:
    """The operator's orders among the inputs of a tick -> CDR."""
    return _write(OPERATOR, make(OPERATOR)(tick, [_ORDER.to_ros(order) for order in inputs.operator]))


def decode_operator(data: bytes) -> tuple[int, tuple[OperatorCommand, ...]]:
    """The inverse of `encode_operator`. Raises DecodeError."""
    ros = _read(OPERATOR, data)
    _few(ros.orders, "orders")
    return ros.tick, tuple(_ORDER.from_ros(order) for order in ros.orders)


def encode_outputs(tick: int, outputs: Outputs) -> bytes:
    """Outputs of a tick -> CDR."""
    command = make("cell_msgs/msg/TickCommand")
    message = make(OUTPUTS)(
        tick,
        _STATE.to_ros(outputs.state),
        [
            command(
                c.ticket,
                c.camera,
                codec.ros_type(type(c.order)),
                np.frombuffer(codec.encode(c.order), np.uint8),
            )
            for c in outputs.commands
        ],
        [_DETECTIONS.to_ros(d) for d in outputs.detections],
        [_EVENT.to_ros(e) for e in outputs.events],
        [_HANDS.to_ros(h) for h in outputs.hands],
        outputs.done,
        outputs.failure,
    )
    return _write(OUTPUTS, message)


def decode_outputs(data: bytes) -> tuple[int, Outputs]:
    """The inverse of `encode_outputs`. Raises DecodeError."""
    ros = _read(OUTPUTS, data)
    for name in ("commands", "detections", "events", "hands"):
        _few(getattr(ros, name), name)
    return ros.tick, Outputs(
        commands=tuple(_read_command(c) for c in ros.commands),
        state=_STATE.from_ros(ros.state),
        detections=tuple(_DETECTIONS.from_ros(d) for d in ros.detections),
        events=tuple(_EVENT.from_ros(e) for e in ros.events),
        hands=tuple(_HANDS.from_ros(h) for h in ros.hands),
        done=ros.done,
        failure=cdr.text(ros.failure, "failure"),
    )


def _write(ros_type: str, message: Any) -> bytes:
    writer = cdr.Writer()
    try:
        writer.put(ros_type, message)
    except (ValueError, TypeError, OverflowError, struct.error) as error:
        raise WireError(f"cannot record this tick: {error}") from error
    return writer.finish()


def _read(ros_type: str, data: bytes) -> Any:
    reader = cdr.Reader(data, _LIMIT)
    message = reader.take(ros_type)
    reader.finish()
    return message


def _few(items: Any, what: str) -> None:
    if len(items) > _MOST:
        raise DecodeError(f"tick: {len(items)} {what}, at most {_MOST} are allowed")


def _read_command(ros: Any) -> Command:
    if ros.type not in _ORDERS:
        raise DecodeError(f"command: {one_of(ros.type[:80], _ORDERS)}")
    order = codec.decode(_ORDERS[ros.type], bytes(ros.data))
    return Command(ros.ticket, order, cdr.text(ros.camera, "camera"))


def _search(search: Search) -> Any:
    hand = make("cell_msgs/msg/FoundHand")
    return make("cell_msgs/msg/HandSearch")(
        np.array([_four(roi) for roi in search.candidates], np.float64).ravel(),
        [
            hand(
                np.ascontiguousarray(h.landmarks, np.float64).ravel(),
                np.ascontiguousarray(h.world, np.float64).ravel(),
                h.presence,
                h.p_right,
                h.score,
                np.array(_four(h.roi)),
            )
            for h in search.hands
        ],
    )


def _four(roi: Roi) -> tuple[float, float, float, float]:
    return roi.u, roi.v, roi.side, roi.angle


def _read_search(ros: Any) -> Search:
    if len(ros.candidates) % 4 or max(len(ros.candidates), len(ros.hands)) > _MOST:
        raise DecodeError(f"search: {len(ros.candidates)} numbers for squares, {len(ros.hands)} hands")
    candidates = cdr.vector(ros.candidates, len(ros.candidates), "candidates").reshape(-1, 4)
    return Search(
        tuple(Roi(*map(float, c)) for c in candidates),
        tuple(
            Hand(
                cdr.vector(h.landmarks, 42, "landmarks").reshape(21, 2),
                cdr.vector(h.world, 63, "world").reshape(21, 3),
                cdr.finite(h.presence, "presence"),
                cdr.finite(h.p_right, "p_right"),
                cdr.finite(h.score, "score"),
                Roi(*map(float, cdr.vector(h.roi, 4, "roi"))),
            )
            for h in ros.hands
        ),
    )
