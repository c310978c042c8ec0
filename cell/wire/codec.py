"""Messages to bytes and back: `encode` and `decode`.

Every class of `cell.wire.types` travels as one ROS 2 message in CDR. Decoding trusts
nothing: sizes, counts, names, encodings and numbers are bounded, arrays come out
read-only, and whatever is wrong is a `DecodeError` of one line.
"""

from __future__ import annotations

import struct
from typing import Any, TypeVar

from cell.errors import CellError, DecodeError, WireError
from cell.wire import types, typestore
from cell.wire.cdr import Reader, Writer
from cell.wire.layouts import (
    CameraInfoLayout,
    ClockLayout,
    DetectionsLayout,
    EventLayout,
    JointStateLayout,
    Layout,
    PathLayout,
)
from cell.wire.layouts_cell import FlatLayout, StepReplyLayout, TrajectoryLayout
from cell.wire.layouts_image import FrameLayout, ImageLayout
from cell.wire.layouts_person import HandsLayout, TruthLayout

M = TypeVar("M")

_FLAT: tuple[type[Any], ...] = (
    types.ArmStatus,
    types.Reply,
    types.Stop,
    types.Resume,
    types.GripperCommand,
    types.GripperState,
    types.LightCommand,
    types.BeltCommand,
    types.BeltState,
    types.Capture,
    types.Heartbeat,
    types.SupervisorState,
    types.StepRequest,
    types.ResetRequest,
    types.TruthRequest,
    types.OperatorCommand,
    types.NextRound,
)

_LAYOUTS: dict[type[Any], Layout[Any]] = {
    types.JointState: JointStateLayout(),
    types.Trajectory: TrajectoryLayout(),
    types.CameraInfo: CameraInfoLayout(),
    types.Frame: FrameLayout(),
    types.Image: ImageLayout(),
    types.Detections: DetectionsLayout(),
    types.Hands: HandsLayout(),
    types.Event: EventLayout(),
    types.PlannedPath: PathLayout(),
    types.ClockTick: ClockLayout(),
    types.StepReply: StepReplyLayout(),
    types.Truth: TruthLayout(),
    **{cls: FlatLayout(cls) for cls in _FLAT},
}


def message_classes() -> tuple[type[Any], ...]:
    """Every class that can be sent."""
    return tuple(_LAYOUTS)


def encode(message: object) -> bytes:
    """A message of `cell.wire.types` -> ROS 2 message in CDR.

    Numbers are not judged (the receiver does), but they must fit their fields.

    Raises:
        WireError: shapes, types, lengths or times that the message cannot carry.
    """
    layout = _layout(type(message))
    writer = Writer()
    try:
        layout.write(writer, message)
    except CellError:
        raise
    except (struct.error, ValueError, TypeError, AttributeError, OverflowError) as error:
        raise WireError(f"cannot send this {type(message).__name__}: {error}") from error
    return writer.finish()


def decode(cls: type[M], data: bytes) -> M:
    """CDR bytes -> message of class `cls`.

    Raises:
        DecodeError: whatever is wrong with the bytes; never anything else.
    """
    layout = _layout(cls)
    try:
        reader = Reader(data, layout.limit)
        message: M = layout.read(reader)
        reader.finish()
    except DecodeError as error:
        raise DecodeError(f"not a valid {cls.__name__}: {error}") from None
    return message


def ros_type(cls: type[Any]) -> str:
    """Full ROS 2 type name of a message class, e.g. "sensor_msgs/msg/JointState"."""
    return _layout(cls).ros_type


def schema_text(cls: type[Any]) -> str:
    """The message's definition with all it embeds, as MCAP's "ros2msg" wants it."""
    return typestore.schema(ros_type(cls))


def warm_up() -> None:
    """Prepare all types now, so that the first message is as quick as the rest (0.3 s, once)."""
    for ros in {layout.ros_type for layout in _LAYOUTS.values()}:
        typestore.store().get_msgdef(ros)
    for head in (typestore.IMAGE_HEAD, typestore.FRAME_HEAD, typestore.TRAJECTORY_HEAD):
        typestore.store().get_msgdef(head)


def _layout(cls: type[Any]) -> Layout[Any]:
    try:
        return _LAYOUTS[cls]
    except KeyError:
        raise WireError(f"{cls.__name__} is not a message of cell.wire.types") from None
