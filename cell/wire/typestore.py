"""The ROS 2 types that travel on the wire.

Jazzy's own types come with `rosbags`; `vision_msgs` (release 4.1.1's layout) and this
project's `cell_msgs` are kept beside this file as `.msg` text. Three head types, the
fields of a message before its bulk, are registered for `cell.wire.cdr`; they never
appear in a recording.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

TIME = "builtin_interfaces/msg/Time"
POINT = "geometry_msgs/msg/Point"
IMAGE_HEAD = "cell_heads/msg/Image"
FRAME_HEAD = "cell_heads/msg/Frame"
TRAJECTORY_HEAD = "cell_heads/msg/Trajectory"

_HEADS = {
    IMAGE_HEAD: (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\n"
    ),
    FRAME_HEAD: "string camera\nuint32 seq\n",
    TRAJECTORY_HEAD: (
        "int64 id\nstring holder\nbuiltin_interfaces/Time start\nbuiltin_interfaces/Time expires\n"
        "std_msgs/Header header\nstring[] joint_names\n"
    ),
}


@cache
def store() -> Typestore:
    """The type store with everything registered (built on first use, about 0.1 s)."""
    # rosbags takes tens of milliseconds to import, which a command line's help need not pay.
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    out = get_typestore(Stores.ROS2_JAZZY)
    types = {name: text for name, text in _HEADS.items()}
    for package in ("vision_msgs", "cell_msgs"):
        for file in (files("cell.wire") / "msg" / package).iterdir():
            if file.name.endswith(".msg"):
                types[f"{package}/msg/{file.name.removesuffix('.msg')}"] = file.read_text("utf-8")
    parsed: dict[str, Any] = {}
    for name, text in types.items():
        parsed.update(get_types_from_msg(text, name))
    out.register(parsed)
    return out


@cache
def make(ros_type: str) -> Any:
    """The class of a ROS 2 type; call it with the fields in their order."""
    return store().types[ros_type]


@cache
def schema(ros_type: str) -> str:
    """Definition of `ros_type` with all it embeds, in MCAP's "ros2msg" form."""
    return store().generate_msgdef(ros_type, ros_version=2)[0]
