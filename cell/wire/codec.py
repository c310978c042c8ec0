"""Messages to bytes and back: `encode` and `decode`."""

from __future__ import annotations

from typing import Any, TypeVar

M = TypeVar("M")


def encode(message: object) -> bytes:
    """Message of `cell.wire.types` -> ROS 2 message in CDR (raises WireError)."""
    raise NotImplementedError


def decode(cls: type[M], data: bytes) -> M:
    """CDR bytes -> message of class `cls`; raises DecodeError and nothing else."""
    raise NotImplementedError


def ros_type(cls: type[Any]) -> str:
    """Full ROS 2 type name of a message class, e.g. "sensor_msgs/msg/JointState"."""
    raise NotImplementedError


def schema_text(cls: type[Any]) -> str:
    """The message's definition with those it embeds, as MCAP's "ros2msg" wants it."""
    raise NotImplementedError
