"""The robot's description and where its links and the cameras are, as ROS tools want them.

The wire carries joint positions only; tools need `/robot_description`, `/tf` and `/tf_static`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.cameras import camera_pose
from cell.config import CellConfig
from cell.frames import Array, pose, quaternion, rot_x, rot_y, rot_z
from cell.wire import cdr
from cell.wire.layouts import header, optical_frame
from cell.wire.typestore import make
from urdf import FINGER_JOINT_NAMES, JOINT_NAMES, robot_description

STRING, TF = "std_msgs/msg/String", "tf2_msgs/msg/TFMessage"
WORLD = "base_link"
"""Name of the world frame W."""


@dataclass(frozen=True)
class _Joint:
    """A joint of the URDF: child in parent is `X` times its motion along or about `axis`."""

    name: str
    kind: str
    parent: str
    child: str
    X: Array
    axis: Array

    def at(self, value: float) -> Array:
        """Pose of the child in the parent, (4, 4), at `value` [rad or m]."""
        if self.kind == "prismatic":
            return np.asarray(self.X @ pose(p=self.axis * value))
        return np.asarray(self.X @ pose(_turn(self.axis, value)))


class Transforms:
    """Messages about where everything is.

    Args:
        config: the cell, for its cameras.
    """

    def __init__(self, config: CellConfig) -> None:
        self._text = robot_description(absolute=False)
        joints = [_joint(element) for element in ET.fromstring(self._text).iter("joint")]
        self._fixed = [j for j in joints if j.kind == "fixed"]
        self._moving = {j.name: j for j in joints if j.kind != "fixed"}
        self._cameras = {optical_frame(name): camera_pose(camera) for name, camera in config.cameras.items()}

    def description(self) -> bytes:
        """std_msgs/String in CDR: the URDF."""
        return _cdr(STRING, make(STRING)(self._text))

    def static(self) -> bytes:
        """tf2_msgs/TFMessage in CDR: fixed joints and cameras."""
        rows = [_transform(0.0, j.parent, j.child, j.X) for j in self._fixed]
        rows += [_transform(0.0, WORLD, frame, X_WC) for frame, X_WC in self._cameras.items()]
        return _cdr(TF, make(TF)(rows))

    def moving(self, t: float, q: Array, width: float) -> bytes:
        """tf2_msgs/TFMessage in CDR at t [s]: arm at q (6,) [rad], fingers `width` [m] apart."""
        values = dict(zip(JOINT_NAMES, map(float, q), strict=True))
        values.update(dict.fromkeys(FINGER_JOINT_NAMES, width / 2))
        rows = [
            _transform(t, joint.parent, joint.child, joint.at(value))
            for name, value in values.items()
            if (joint := self._moving.get(name)) is not None
        ]
        return _cdr(TF, make(TF)(rows))


def _joint(element: ET.Element) -> _Joint:
    origin, axis = element.find("origin"), element.find("axis")
    xyz = _numbers(origin, "xyz", "0 0 0")
    roll, pitch, yaw = _numbers(origin, "rpy", "0 0 0")
    ends = [element.find(tag) for tag in ("parent", "child")]
    parent, child = ("" if end is None else end.get("link", "") for end in ends)
    X = pose(rot_z(float(yaw)) @ rot_y(float(pitch)) @ rot_x(float(roll)), xyz)
    name, kind = element.get("name", ""), element.get("type", "fixed")
    return _Joint(name, kind, parent, child, X, _numbers(axis, "xyz", "1 0 0"))


def _numbers(element: ET.Element | None, name: str, default: str) -> Array:
    text = default if element is None else element.get(name, default)
    return np.array([float(word) for word in text.split()])


def _turn(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) by `angle` [rad] about a unit axis (3,) (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K))


def _transform(t: float, parent: str, child: str, X: Array) -> Any:
    x, y, z, w = (float(v) for v in quaternion(X[:3, :3]))
    vector, turn = make("geometry_msgs/msg/Vector3"), make("geometry_msgs/msg/Quaternion")
    here = make("geometry_msgs/msg/Transform")(vector(*map(float, X[:3, 3])), turn(x, y, z, w))
    return make("geometry_msgs/msg/TransformStamped")(header(t, parent), child, here)


def _cdr(ros_type: str, message: Any) -> bytes:
    writer = cdr.Writer()
    writer.put(ros_type, message)
    return writer.finish()
