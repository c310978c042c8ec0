"""How `cell_msgs` carry the project's own messages."""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from cell.errors import DecodeError, WireError
from cell.wire import cdr
from cell.wire.cdr import Reader, Writer
from cell.wire.layouts import JOINT_NAMES, SMALL, JointStateLayout, Simple, check_joint_names, header
from cell.wire.layouts_image import FRAME_LIMIT, FrameLayout
from cell.wire.types import ArmStatus, BeltState, GripperState, StepReply, Trajectory
from cell.wire.typestore import POINT, TIME, TRAJECTORY_HEAD, make, store

M = TypeVar("M")

#: Most points in a trajectory, frames in a step's reply.
MAX_POINTS = 20_000
MAX_FRAMES = 8

#: Fields that may be infinite.
_MAY_BE_INFINITE = {
    ("cell_msgs/msg/SupervisorState", "separation"),
    ("cell_msgs/msg/SupervisorState", "separation_age"),
}


class FlatLayout(Simple[M]):
    """A dataclass of scalars and the `cell_msgs` type with the same fields (`t` is `stamp`).

    Args:
        cls: the dataclass; its ROS type is `cell_msgs/msg/<its name>`.
    """

    def __init__(self, cls: type[M]) -> None:
        self._cls = cls
        self.ros_type = f"cell_msgs/msg/{cls.__name__}"

    @cached_property
    def _fields(self) -> list[tuple[str, str, str]]:
        """(attribute, ROS field, ROS type) in the ROS type's order."""
        out = []
        for name, (_, kind) in store().fielddefs[self.ros_type][1]:
            attribute = "t" if name == "stamp" else name
            out.append((attribute, name, kind if isinstance(kind, str) else str(kind[0])))
        return out

    def to_ros(self, m: M) -> Any:
        return make(self.ros_type)(*[_to_field(getattr(m, a), kind, a) for a, _, kind in self._fields])

    def from_ros(self, ros: Any) -> M:
        return self._cls(**{a: self._from_field(getattr(ros, f), kind, f) for a, f, kind in self._fields})

    def _from_field(self, value: Any, kind: str, name: str) -> Any:
        if kind == "string":
            return cdr.text(value, name)
        if kind == "float64":
            if value == np.inf and (self.ros_type, name) in _MAY_BE_INFINITE:
                return value
            return cdr.finite(value, name)
        if kind == TIME:
            return cdr.seconds(value, name)
        if kind == POINT:
            return tuple(cdr.finite(c, name) for c in (value.x, value.y, value.z))
        return value


def _to_field(value: Any, kind: str, name: str) -> Any:
    if kind == TIME:
        return cdr.stamp(value)
    if kind == POINT:
        return make(POINT)(*value)
    if kind == "string" and len(value.encode()) > cdr.MAX_TEXT:
        raise WireError(f"{name} is longer than {cdr.MAX_TEXT} bytes")
    return value


class StepReplyLayout:
    """cell_msgs/StepReply."""

    ros_type = "cell_msgs/msg/StepReply"
    limit = SMALL + 2 * FRAME_LIMIT
    _joints = JointStateLayout()
    _status = FlatLayout(ArmStatus)
    _gripper = FlatLayout(GripperState)
    _belt = FlatLayout(BeltState)
    _frame = FrameLayout()

    def write(self, w: Writer, m: StepReply) -> None:
        if len(m.frames) > MAX_FRAMES:
            raise WireError(f"{len(m.frames)} frames, at most {MAX_FRAMES} can be sent")
        self._joints.write(w, m.joint_state)
        self._status.write(w, m.arm_status)
        self._gripper.write(w, m.gripper_state)
        self._belt.write(w, m.belt_state)
        w.count(len(m.frames))
        for frame in m.frames:
            self._frame.write(w, frame)

    def read(self, r: Reader) -> StepReply:
        parts = (self._joints.read(r), self._status.read(r), self._gripper.read(r), self._belt.read(r))
        n = r.count(MAX_FRAMES, "frames")
        return StepReply(*parts, tuple(self._frame.read(r) for _ in range(n)))


# A JointTrajectoryPoint of six positions, six velocities and nothing else, at an offset
# that is a multiple of 8, is exactly 128 bytes; `gap` is alignment padding.
_POINT = np.dtype(
    [
        ("n_q", "<u4"), ("gap_q", "<u4"), ("q", "<f8", 6),
        ("n_qd", "<u4"), ("gap_qd", "<u4"), ("qd", "<f8", 6),
        ("n_acceleration", "<u4"), ("n_effort", "<u4"), ("sec", "<i4"), ("nanosec", "<u4"),
    ]
)  # fmt: skip


class TrajectoryLayout:
    """cell_msgs/TrajectoryCommand around a trajectory_msgs/JointTrajectory."""

    ros_type = "cell_msgs/msg/TrajectoryCommand"
    limit = SMALL + MAX_POINTS * _POINT.itemsize

    def write(self, w: Writer, m: Trajectory) -> None:
        n = len(m.times)
        if n > MAX_POINTS:
            raise WireError(f"{n} points, at most {MAX_POINTS} can be sent")
        if not (m.times.shape == (n,) and m.q.shape == m.qd.shape == (n, 6)):
            shapes = f"times {m.times.shape}, q {m.q.shape}, qd {m.qd.shape}"
            raise WireError(f"{shapes} must be (N,), (N, 6), (N, 6)")
        if n and not (np.min(m.times) >= 0.0 and np.max(m.times) <= cdr.MAX_TIME):
            raise WireError(f"times must be finite and in 0..{cdr.MAX_TIME} s")
        head = make(TRAJECTORY_HEAD)(
            m.id, m.holder, cdr.stamp(m.start), cdr.stamp(m.expires), header(m.start), list(JOINT_NAMES)
        )
        w.put(TRAJECTORY_HEAD, head)
        w.count(n)
        points = np.zeros(n, dtype=_POINT)
        points["n_q"] = points["n_qd"] = 6
        points["q"], points["qd"] = m.q, m.qd
        nanoseconds = np.rint(m.times * 1e9).astype(np.int64)
        points["sec"], points["nanosec"] = nanoseconds // 10**9, nanoseconds % 10**9
        if n and w.size % 8:
            # The first point starts 4 bytes into its 128: its count sits where the gap would.
            points["gap_q"][0] = 6
            w.raw(points.view(np.uint8).data[4:])
        else:
            w.raw(points.view(np.uint8).data)

    def read(self, r: Reader) -> Trajectory:
        head = r.take(TRAJECTORY_HEAD)
        check_joint_names(head.joint_names)
        n = r.count(MAX_POINTS, "trajectory points")
        late = r.pos % 8 if n else 0
        r.raw(n * _POINT.itemsize - late)
        points = np.frombuffer(r.rewound(n * _POINT.itemsize), dtype=_POINT, count=n)
        n_q = points["n_q"].copy()
        if late:
            n_q[0] = points["gap_q"][0]
        if not (np.all(n_q == 6) and np.all(points["n_qd"] == 6)):
            raise DecodeError("every trajectory point needs 6 positions and 6 velocities")
        if np.any(points["n_acceleration"]) or np.any(points["n_effort"]):
            raise DecodeError("trajectory points must carry no accelerations and no efforts")
        if np.any(points["sec"] < 0) or np.any(points["nanosec"] >= 10**9):
            raise DecodeError("a trajectory point has a negative or malformed time")
        return Trajectory(
            head.id,
            cdr.text(head.holder, "holder"),
            cdr.seconds(head.start, "start"),
            cdr.seconds(head.expires, "expires"),
            cdr.frozen(
                (points["sec"].astype(np.int64) * 10**9 + points["nanosec"]) / 1e9, "trajectory times"
            ),
            cdr.frozen(points["q"].astype(np.float64), "trajectory q"),
            cdr.frozen(points["qd"].astype(np.float64), "trajectory qd"),
        )
