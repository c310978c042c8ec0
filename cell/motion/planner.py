"""Collision-checked motions between the few kinds of poses that sorting needs.

A transfer is tried as a straight line in joint space; where that would touch something, via
poses are tried in a fixed order (higher, nearer to the base, along the way), so that the same
request always gives the same motion.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cell.config import CellConfig
from cell.errors import PlanError
from cell.frames import Array, pose, rot_x, rot_z
from cell.motion.collision import CollisionModel
from cell.motion.kinematics import Kinematics
from cell.motion.paths import JointPath
from cell.motion.timing import TimedPath, time_path

_CHECK_STEP = 0.06
"""Joint distance between collision checks along a path [rad]."""
_LINE_STEP = 0.012
"""Distance between IK solutions along a straight line of the tool [m]."""
_LINE_JUMP = 0.35
"""Joint step along a straight line that means a change of branch [rad]."""


class Planner:
    """Plans for one cell. All joint angles are (6,) [rad]; poses X_WT are the TCP in the world."""

    def __init__(self, config: CellConfig) -> None:
        self.config = config
        self.kinematics = Kinematics(config)
        self.collision = CollisionModel(config)

    # -- poses ----------------------------------------------------------------------------------

    def grasp_pose(self, p_WO: Array, yaw: float) -> Array:
        """Tool straight down at `p_WO` (3,) [m], fingers closing along `yaw` [rad] about world z."""
        return pose(rot_z(yaw) @ rot_x(np.pi), p_WO)

    def drop_pose(self, q_near: Array) -> Array:
        """Tool straight down above the bin, with the yaw that turns the wrist least."""
        (x, y, z), height = self.config.bin.center, self.config.bin.drop_height
        found: list[tuple[float, Array]] = []
        for yaw in np.linspace(-np.pi / 2, np.pi / 2, 13)[:-1]:
            X_WT = self.grasp_pose(np.array([x, y, z + height]), float(yaw))
            for q in self.kinematics.ik(X_WT, q_near)[:2]:
                found.append((float(np.abs(q - q_near).max()), X_WT))
        if not found:
            raise PlanError(
                f"bin.center: the drop pose at ({x:.3f}, {y:.3f}, {z + height:.3f}) m is out of reach"
            )
        return min(found, key=lambda item: item[0])[1]

    def reachable(self, X_WT: Array, hover: float) -> bool:
        """A grasp at X_WT and the pose `hover` [m] above it have solutions free of collisions."""
        above = X_WT.copy()
        above[2, 3] += hover
        home = np.array(self.config.arm.home)
        try:
            q_above = self.kinematics.ik_near(above, home)
            q = self.kinematics.ik_near(X_WT, q_above)
        except PlanError:
            return False
        return bool((self.collision.clearance(np.stack([q, q_above])) >= 0.0).all())

    # -- motions --------------------------------------------------------------------------------

    def plan_joints(
        self, q_from: Array, q_to: Array, speed_cap: float, *, held_radius: float = 0.0
    ) -> TimedPath:
        """Fastest collision-free motion from rest at `q_from` to rest at `q_to`.

        Args:
            speed_cap: TCP speed cap [m/s]. held_radius: of an onion in the hand [m].

        Raises:
            PlanError: every way that was tried touches something.
        """
        for vias in self._ways(q_from, q_to):
            path = JointPath([q_from, *vias, q_to])
            if self._free(path, held_radius):
                return time_path(path, speed_cap, self.config)
        raise PlanError("no way found between two arm poses that keeps clear of the cell")

    def plan_to_pose(
        self,
        q_from: Array,
        X_WT: Array,
        speed_cap: float,
        *,
        straight: bool = False,
        held_radius: float = 0.0,
    ) -> TimedPath:
        """Motion to a TCP pose, along a straight line of the tool if `straight`.

        Straight motions approach or leave the belt; only their reach is checked, since touching
        distance is their purpose. Raises `PlanError` as `plan_joints` does, or when the pose is
        out of reach.
        """
        if straight:
            return time_path(self._line(q_from, X_WT), speed_cap, self.config)
        last: PlanError | None = None
        for q_to in self.kinematics.ik(X_WT, q_from)[:3]:
            try:
                return self.plan_joints(q_from, q_to, speed_cap, held_radius=held_radius)
            except PlanError as error:
                last = error
        if last is not None:
            raise last
        self.kinematics.ik_near(X_WT, q_from)  # raises, naming the pose
        raise PlanError("unreachable")

    # -- internals ------------------------------------------------------------------------------

    def _ways(self, q_from: Array, q_to: Array) -> Iterator[list[Array]]:
        """Lists of via configurations, the cheapest first."""
        yield []
        p_from, p_to = (self.kinematics.X_WT(q)[:3, 3] for q in (q_from, q_to))
        middle = 0.5 * (q_from + q_to)
        X_WT = self.kinematics.X_WT(middle)
        for lift in (0.04, 0.08, 0.14):
            for pull in (1.0, 0.85, 0.7):
                raised = X_WT.copy()
                raised[:2, 3] *= pull
                raised[2, 3] = max(p_from[2], p_to[2], raised[2, 3]) + lift
                found = self.kinematics.ik(raised, middle)
                if found and np.abs(found[0] - middle).max() < 1.5:
                    yield [found[0]]
        tucked = np.array(self.config.arm.home)
        tucked[0] = middle[0]
        yield [tucked]
        yield [np.array([q_from[0], *tucked[1:]]), np.array([q_to[0], *tucked[1:]])]
        yield [np.array(self.config.arm.home)]

    def _free(self, path: JointPath, held_radius: float) -> bool:
        q = path.samples(_CHECK_STEP)
        clearance = self.collision.clearance(q, held_radius=held_radius)
        # A motion that starts or ends close (above the belt, over the bin) may be that close
        # near its ends, but never closer.
        least = min(self.config.motion.clearance, float(clearance[0]), float(clearance[-1]))
        return bool((clearance >= least - 1e-6).all() and clearance.min() >= 0.0)

    def _line(self, q_from: Array, X_WT: Array) -> JointPath:
        """Joint path along which the tool moves straight to X_WT, keeping or turning evenly."""
        X_from = self.kinematics.X_WT(q_from)
        distance = float(np.linalg.norm(X_WT[:3, 3] - X_from[:3, 3]))
        count = max(2, int(np.ceil(distance / _LINE_STEP)))
        waypoints = [q_from]
        for w in np.linspace(0, 1, count + 1)[1:]:
            X = X_WT.copy()
            X[:3, 3] = (1 - w) * X_from[:3, 3] + w * X_WT[:3, 3]
            near = waypoints[-1]
            options = self.kinematics.ik(X, near)
            if not options:
                self.kinematics.ik_near(X, near)  # raises, naming the pose
            q = min(options, key=lambda o: float(np.abs(o - near).max()))
            if np.abs(q - near).max() > _LINE_JUMP:
                raise PlanError("a straight tool motion would have to turn the arm over")
            waypoints.append(q)
        return JointPath(waypoints)
