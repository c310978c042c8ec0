"""How standard ROS 2 messages carry the project's: joint states, intrinsics, detections, logs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from cell.errors import DecodeError, WireError, one_of
from cell.wire import cdr
from cell.wire.cdr import Reader, Writer
from cell.wire.types import Box, CameraInfo, ClockTick, Detections, Event, JointState, PlannedPath
from cell.wire.typestore import POINT, make

M = TypeVar("M")

#: The arm's joints in the order of every array of six.
JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
#: Longest side of an image [px].
MAX_SIDE = 4096
#: Most boxes in one message.
MAX_BOXES = 1000
#: Most places on a planned path.
MAX_PLACES = 256
#: Size limit of messages that carry a few numbers and short texts [bytes].
SMALL = 64 * 1024

_FRAME = "camera_"
_WORLD = "base_link"
_POSE = "geometry_msgs/msg/Pose"
_LEVELS = (10, 20, 30, 40, 50)


class Layout(Protocol[M]):
    """One message class on the wire."""

    ros_type: str
    limit: int

    def write(self, w: Writer, m: M) -> None: ...

    def read(self, r: Reader) -> M: ...


class Simple(ABC, Generic[M]):
    """Base of layouts that are one ROS message without bulk data."""

    ros_type: str
    limit = SMALL

    def write(self, w: Writer, m: M) -> None:
        w.put(self.ros_type, self.to_ros(m))

    def read(self, r: Reader) -> M:
        return self.from_ros(r.take(self.ros_type))

    @abstractmethod
    def to_ros(self, m: M) -> Any:
        """The ROS message's fields."""

    @abstractmethod
    def from_ros(self, ros: Any) -> M:
        """Our message of a decoded ROS message."""


def optical_frame(camera: str) -> str:
    """ROS frame id of a camera's optical frame C: "camera_belt", as in its CameraInfo."""
    return _FRAME + camera


def header(t: float, frame_id: str = "") -> Any:
    """std_msgs/Header."""
    return make("std_msgs/msg/Header")(cdr.stamp(t), frame_id)


def camera_of(frame_id: str) -> str:
    """Inverse of `optical_frame`; raises DecodeError for any other frame."""
    if not cdr.text(frame_id, "frame_id").startswith(_FRAME):
        raise DecodeError(f"frame_id {frame_id[:80]!r} does not start with {_FRAME}")
    return frame_id.removeprefix(_FRAME)


def check_size(width: int, height: int) -> None:
    """Raise DecodeError unless both sides of an image are in 1 .. MAX_SIDE [px]."""
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise DecodeError(f"image of {width} x {height} pixels, allowed are 1..{MAX_SIDE} each way")


def six(values: object, what: str) -> NDArray[np.float64]:
    """Contiguous float64 array of shape (6,); raises WireError for any other shape."""
    out = np.ascontiguousarray(values, dtype=np.float64)
    if out.shape != (6,):
        raise WireError(f"{what} must have shape (6,), got {out.shape}")
    return out


def check_joint_names(names: list[str]) -> None:
    """Raise DecodeError unless the names are the arm's, in order."""
    if tuple(names) != JOINT_NAMES:
        raise DecodeError(f"joint names must be {', '.join(JOINT_NAMES)}, got {', '.join(names)[:120]}")


class JointStateLayout(Simple[JointState]):
    ros_type = "sensor_msgs/msg/JointState"

    def to_ros(self, m: JointState) -> Any:
        return make(self.ros_type)(
            header(m.t), list(JOINT_NAMES), six(m.q, "q"), six(m.qd, "qd"), six(m.effort, "effort")
        )

    def from_ros(self, ros: Any) -> JointState:
        check_joint_names(ros.name)
        return JointState(
            cdr.seconds(ros.header.stamp, "stamp"),
            cdr.vector(ros.position, 6, "q"),
            cdr.vector(ros.velocity, 6, "qd"),
            cdr.vector(ros.effort, 6, "effort"),
        )


class CameraInfoLayout(Simple[CameraInfo]):
    ros_type = "sensor_msgs/msg/CameraInfo"

    def to_ros(self, m: CameraInfo) -> Any:
        k = np.array([m.fx, 0, m.cx, 0, m.fy, m.cy, 0, 0, 1], dtype=np.float64)
        p = np.array([m.fx, 0, m.cx, 0, 0, m.fy, m.cy, 0, 0, 0, 1, 0], dtype=np.float64)
        roi = make("sensor_msgs/msg/RegionOfInterest")(0, 0, 0, 0, False)
        distortion, rectification = np.zeros(5), np.eye(3).ravel()
        return make(self.ros_type)(
            header(m.t, m.frame),
            m.height,
            m.width,
            "plumb_bob",
            distortion,
            k,
            rectification,
            p,
            0,
            0,
            roi,
        )

    def from_ros(self, ros: Any) -> CameraInfo:
        check_size(ros.width, ros.height)
        if np.any(ros.d != 0.0):
            raise DecodeError("distortion coefficients must be zero: images are rectified")
        k = cdr.vector(ros.k, 9, "k")
        if k[0] <= 0.0 or k[4] <= 0.0:
            raise DecodeError(f"focal lengths must be positive, got {k[0]}, {k[4]}")
        return CameraInfo(
            cdr.seconds(ros.header.stamp, "stamp"),
            cdr.text(ros.header.frame_id, "frame_id"),
            ros.width,
            ros.height,
            fx=float(k[0]),
            fy=float(k[4]),
            cx=float(k[2]),
            cy=float(k[5]),
        )


class DetectionsLayout(Simple[Detections]):
    ros_type = "vision_msgs/msg/Detection2DArray"
    limit = 1024 * 1024

    def to_ros(self, m: Detections) -> Any:
        if len(m.boxes) > MAX_BOXES:
            raise WireError(f"{len(m.boxes)} boxes, at most {MAX_BOXES} can be sent")
        head = header(m.t, optical_frame(m.camera))
        return make(self.ros_type)(head, [self._box(head, b) for b in m.boxes])

    def _box(self, head: Any, b: Box) -> Any:
        x0, y0, x1, y1 = b.box
        point, turn = make("geometry_msgs/msg/Point"), make("geometry_msgs/msg/Quaternion")
        nowhere = make("geometry_msgs/msg/Pose")(point(0.0, 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0))
        guess = make("vision_msgs/msg/ObjectHypothesisWithPose")(
            make("vision_msgs/msg/ObjectHypothesis")(b.label, b.score),
            make("geometry_msgs/msg/PoseWithCovariance")(nowhere, np.zeros(36)),
        )
        middle = make("vision_msgs/msg/Point2D")((x0 + x1) / 2, (y0 + y1) / 2)
        center = make("vision_msgs/msg/Pose2D")(middle, 0.0)
        area = make("vision_msgs/msg/BoundingBox2D")(center, x1 - x0, y1 - y0)
        return make("vision_msgs/msg/Detection2D")(head, [guess], area, "")

    def from_ros(self, ros: Any) -> Detections:
        if len(ros.detections) > MAX_BOXES:
            raise DecodeError(f"{len(ros.detections)} boxes, at most {MAX_BOXES} are allowed")
        boxes = []
        for d in ros.detections:
            if len(d.results) != 1:
                raise DecodeError(f"a detection has {len(d.results)} results instead of 1")
            guess = d.results[0].hypothesis
            if not 0.0 <= guess.score <= 1.0:
                raise DecodeError(f"score {guess.score} is not in 0..1")
            u, v = cdr.finite(d.bbox.center.position.x, "box"), cdr.finite(d.bbox.center.position.y, "box")
            w, h = cdr.finite(d.bbox.size_x, "box size"), cdr.finite(d.bbox.size_y, "box size")
            corners = (u - w / 2, v - h / 2, u + w / 2, v + h / 2)
            boxes.append(Box(corners, cdr.text(guess.class_id, "class_id"), guess.score))
        return Detections(
            cdr.seconds(ros.header.stamp, "stamp"), camera_of(ros.header.frame_id), tuple(boxes)
        )


class EventLayout(Simple[Event]):
    ros_type = "rcl_interfaces/msg/Log"

    def to_ros(self, m: Event) -> Any:
        return make(self.ros_type)(cdr.stamp(m.t), m.level, m.name, m.text, "", "", 0)

    def from_ros(self, ros: Any) -> Event:
        if ros.level not in _LEVELS:
            raise DecodeError(f"level: {one_of(ros.level, _LEVELS)}")
        t = cdr.seconds(ros.stamp, "stamp")
        return Event(t, ros.level, cdr.text(ros.name, "name"), cdr.text(ros.msg, "msg"))


class PathLayout(Simple[PlannedPath]):
    """nav_msgs/Path; its poses carry no turn."""

    ros_type = "nav_msgs/msg/Path"

    def to_ros(self, m: PlannedPath) -> Any:
        if m.p_WT.ndim != 2 or m.p_WT.shape[1] != 3 or len(m.p_WT) > MAX_PLACES:
            raise WireError(f"a path must have shape (N, 3), N at most {MAX_PLACES}, got {m.p_WT.shape}")
        head, stamped, pose = header(m.t, _WORLD), make("geometry_msgs/msg/PoseStamped"), make(_POSE)
        turn = make("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0)
        places = [make(POINT)(*map(float, p)) for p in m.p_WT]
        return make(self.ros_type)(head, [stamped(head, pose(place, turn)) for place in places])

    def from_ros(self, ros: Any) -> PlannedPath:
        if len(ros.poses) > MAX_PLACES:
            raise DecodeError(f"{len(ros.poses)} places, at most {MAX_PLACES} are allowed")
        places = [p.pose.position for p in ros.poses]
        p_WT = np.array([(p.x, p.y, p.z) for p in places], dtype=np.float64).reshape(-1, 3)
        return PlannedPath(cdr.seconds(ros.header.stamp, "stamp"), cdr.frozen(p_WT, "path"))


class ClockLayout(Simple[ClockTick]):
    ros_type = "rosgraph_msgs/msg/Clock"

    def to_ros(self, m: ClockTick) -> Any:
        return make(self.ros_type)(cdr.stamp(m.t))

    def from_ros(self, ros: Any) -> ClockTick:
        return ClockTick(cdr.seconds(ros.clock, "clock"))
