"""Collision-checked motions between the few kinds of poses that sorting needs.

A transfer takes the quickest of the direct routes (straight for the joints, straight for the
tool, round the base) that keep clear of everything, else the first detour that does, else a way
through a net of poses. All is tried in a fixed order: the same request gives the same motion.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cell.config import CellConfig
from cell.errors import PlanError
from cell.frames import Array, pose, rot_x, rot_z
from cell.limits import Q_MAX, tcp_positions
from cell.motion.collision import CollisionModel
from cell.motion.kinematics import Kinematics
from cell.motion.paths import JointPath
from cell.motion.roadmap import Roadmap
from cell.motion.routes import Routes
from cell.motion.timing import TimedPath, time_path
from cell.settings import RobotBinConfig

_CHECK_STEP = 0.06
"""Joint distance between collision checks along a path [rad]."""
_JOINT_MARGIN = 0.03
"""Paths stay this far from the joint limits [rad]."""
_BRANCHES = 3
"""How many IK solutions of a goal are tried."""
_DEEPEST = -0.01
"""A motion may leave from this close to a part, by the model's generous shapes [m]."""
_CORNERS = (0.04, 0.015)
"""How far from its corner an approach may begin to turn down, tried in this order [m]."""
_ROUNDED_STEP, _DESCENT_STEP = 0.15, 0.02
"""Spacing of an approach's waypoints before and after its corner [rad], [m]."""
_SUBDIVISIONS = (1, 3, 8)
"""Into how many pieces the moves of a way through the roadmap are cut, tried in this order."""
DROP_YAWS = np.linspace(-np.pi / 2, np.pi / 2, 12, endpoint=False)
"""Turns of the tool over the bin that are tried [rad]."""
_SPREADING = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps in x and y of a sequence that fills a square evenly, however long it is (Roberts 2018, R2)."""


def drop_place(bin: RobotBinConfig, count: int) -> Array:
    """Where the robot lets go of an onion over the bin after `count` others: p_WT (3,) [m]."""
    x, y, top = bin.center
    dx, dy = bin.drop_spread * (2.0 * ((0.5 + count * _SPREADING) % 1.0) - 1.0)
    return np.array([x + dx, y + dy, top + bin.drop_height])


class Planner:
    """Plans for one cell. All joint angles are (6,) [rad]; poses X_WT (4, 4) are the TCP in the world.

    Args:
        config: the cell. thorough: look for a way through the roadmap where no simple route is free.
        carried: what the gripper holds all the time; see `CollisionModel`.
    """

    def __init__(self, config: CellConfig, *, thorough: bool = True, carried: Array | None = None) -> None:
        self.config = config
        self.kinematics = Kinematics(config)
        self.collision = CollisionModel(config, carried)
        self._routes = Routes(config, self.kinematics)
        self._roadmap = Roadmap(config, self.kinematics, self.collision) if thorough else None

    def prepare(self) -> None:
        """Do now what would otherwise delay the first motion that needs it."""
        if self._roadmap is not None:
            self._roadmap.prepare()

    # -- poses ----------------------------------------------------------------------------------

    def grasp_pose(self, p_WO: Array, yaw: float) -> Array:
        """Tool straight down at `p_WO` (3,) [m], fingers closing along `yaw` [rad] about world z."""
        return pose(rot_z(yaw) @ rot_x(np.pi), p_WO)

    def hover(self, X_WT: Array) -> Array:
        """The pose `motion.hover` above a grasp."""
        above = X_WT.copy()
        above[2, 3] += self.config.motion.hover
        return above

    def nearer_turn(self, X_WT: Array, q_near: Array) -> Array:
        """X_WT or the same grasp with the two fingers exchanged, whichever turns the wrist less."""
        turned = X_WT.copy()
        turned[:3, :2] *= -1.0
        options = [(self.kinematics.ik(X, q_near), X) for X in (X_WT, turned)]
        reached = [
            (float(np.abs(found[0] - q_near).max()), k) for k, (found, _) in enumerate(options) if found
        ]
        return options[min(reached)[1]][1] if reached else X_WT

    def drop_pose(self, q_near: Array, count: int = 0) -> Array:
        """Tool straight down above the bin, with the yaw that moves the arm least there and home.

        Args:
            count: onions let go there before; each falls elsewhere, the first one in the middle.

        Raises:
            PlanError: the bin is out of reach.
        """
        p_WT = drop_place(self.config.bin, count)
        home = np.array(self.config.arm.home)
        found: list[tuple[bool, float, int]] = []
        poses = [self.grasp_pose(p_WT, float(yaw)) for yaw in DROP_YAWS]
        for k, X_WT in enumerate(poses):
            for q in self.kinematics.ik(X_WT, q_near)[:2]:
                # The way to the bin is long enough to turn the wrist; the way home is short.
                back = abs((q[5] - home[5] + np.pi) % (2 * np.pi) - np.pi)
                travel = float(np.abs(q - q_near)[:5].max() + back)
                found.append((not self.kinematics.at_home_in(q), travel, k))
        if not found:
            x, y, z = p_WT
            raise PlanError(f"bin.center: the drop pose at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of reach")
        return poses[min(found)[2]]

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
        return bool((self.collision.clearance(np.stack([q, q_above]), touching=True) >= 0.0).all())

    # -- motions --------------------------------------------------------------------------------

    def plan_joints(
        self, q_from: Array, q_to: Array, speed_cap: float, *, held_radius: float = 0.0
    ) -> TimedPath:
        """Fastest collision-free motion from rest at `q_from` to rest at `q_to`.

        Args:
            speed_cap: TCP speed cap [m/s]. held_radius: of an onion in the hand [m].

        Raises:
            PlanError: every way that was tried touches something; the message says what.
        """
        touched: list[str] = []
        direct = self._timed(self._routes.direct(q_from, q_to), speed_cap, held_radius, touched)
        if direct:
            return min(direct, key=lambda timed: timed.duration)
        for route in self._routes.detours(q_from, q_to):
            if found := self._timed([route], speed_cap, held_radius, touched):
                return found[0]
        way = np.array(self._roadmap.way(q_from, q_to, held_radius) if self._roadmap else [])
        for pieces in _SUBDIVISIONS if len(way) else ():
            # More waypoints on the straight moves keep the curve nearer to them.
            at = np.linspace(0, len(way) - 1, pieces * (len(way) - 1) + 1)
            dense = np.stack([np.interp(at, np.arange(len(way)), way[:, j]) for j in range(6)], axis=1)
            if found := self._timed([list(dense)], speed_cap, held_radius, touched):
                return found[0]
        what = ", ".join(dict.fromkeys(touched))
        raise PlanError(f"no way found between two arm poses that keeps clear of the cell ({what})")

    def plan_to_pose(
        self,
        q_from: Array,
        X_WT: Array,
        speed_cap: float,
        *,
        straight: bool = False,
        held_radius: float = 0.0,
    ) -> TimedPath:
        """Motion from rest at `q_from` to rest at a TCP pose, the tool on a straight line if `straight`.

        Straight motions approach or leave the belt: fingertips and a held onion may come near it.
        Others end with the last wrist joint within half a turn of home, so that it never winds up.

        Args:
            speed_cap: TCP speed cap [m/s]. held_radius: of an onion in the hand [m].

        Raises:
            PlanError: the pose is out of reach, or every way to it touches something.
        """
        if straight:
            path = JointPath(self._routes.line(q_from, X_WT))
            if problem := self._problem(path, held_radius, touching=True):
                raise PlanError(f"a straight tool motion would touch: {problem}")
            return time_path(path, speed_cap, self.config)
        self.kinematics.ik_near(X_WT, q_from)  # raises, naming a pose out of reach
        reasons: list[str] = []
        for q_to in self.kinematics.ik(X_WT, q_from)[:_BRANCHES]:
            q_to[5] += 2 * np.pi * np.round((self.config.arm.home[5] - q_to[5]) / (2 * np.pi))
            try:
                return self.plan_joints(q_from, q_to, speed_cap, held_radius=held_radius)
            except PlanError as error:
                reasons.append(str(error))
        raise PlanError(reasons[0])

    def plan_approach(
        self, q_from: Array, X_WT: Array, speed_cap: float, *, held_radius: float = 0.0
    ) -> TimedPath:
        """One motion to above a grasp and straight down to it, without stopping in between.

        Args:
            X_WT: the grasp, or where a held onion is put down. speed_cap: TCP speed cap [m/s].
            held_radius: of an onion in the hand [m].

        Raises:
            PlanError: as `plan_to_pose`, for either part.
        """
        transfer = self.plan_to_pose(q_from, self.hover(X_WT), speed_cap, held_radius=held_radius)
        line = np.array(self._routes.line(transfer.path.end, X_WT, step=_DESCENT_STEP))
        reasons = []
        for corner in _CORNERS:
            path = JointPath(self._rounded(transfer.path.samples(_ROUNDED_STEP), line, corner))
            if not (problem := self._problem(path, held_radius, touching=True)):
                return time_path(path, speed_cap, self.config)
            reasons.append(problem)
        raise PlanError(f"a straight tool motion would touch: {reasons[0]}")

    # -- internals ------------------------------------------------------------------------------

    def _rounded(self, before: Array, after: Array, corner: float) -> Array:
        """Two rows of waypoints as one, those nearer than `corner` [m] to where they meet left out."""
        length = self.config.gripper.length
        meet = tcp_positions(after[:1], length)
        far_before = np.linalg.norm(tcp_positions(before, length) - meet, axis=1) > corner
        far_after = np.linalg.norm(tcp_positions(after, length) - meet, axis=1) > corner
        far_before[0] = far_after[-1] = True
        return np.concatenate([before[far_before], after[far_after]])

    def _timed(
        self, routes: Iterable[list[Array]], speed_cap: float, held_radius: float, touched: list[str]
    ) -> list[TimedPath]:
        """Timings of the routes that are free; what the others touch is added to `touched`."""
        out = []
        for route in routes:
            path = JointPath(route)
            if problem := self._problem(path, held_radius):
                touched.append(problem)
            else:
                out.append(time_path(path, speed_cap, self.config))
        return out

    def _problem(self, path: JointPath, held_radius: float, *, touching: bool = False) -> str:
        """What a path touches; empty when it is free."""
        q = path.samples(_CHECK_STEP)
        if (np.abs(q) > Q_MAX - _JOINT_MARGIN).any():
            return "a joint limit"
        # Transfers fly over the onions, unless they begin or end among them.
        ends = self.collision.clearance(q[[0, -1]], held_radius=held_radius, flying=True)
        flying = not touching and bool((ends >= 0.0).all())
        clear = self.collision.clearance(q, held_radius=held_radius, touching=touching, flying=flying)
        # A motion that starts or ends close to something may be that close on the way, not closer.
        least = min(self.config.motion.clearance, float(clear[0]), float(clear[-1]))
        if clear[-1] >= 0.0 and least >= _DEEPEST and (clear >= least - 1e-4).all():
            return ""
        worst = q[int(np.argmin(clear))]
        return self.collision.nearest(worst, held_radius=held_radius, touching=touching, flying=flying)[1]
