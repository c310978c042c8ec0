"""Moves the arm from pose to pose and takes a picture of the board at each."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from cell.calibrate.board import Board
from cell.calibrate.check import usable
from cell.calibrate.poses import Pose
from cell.calibrate.solve import View
from cell.config import CellConfig
from cell.decision.io import Inputs
from cell.decision.primitives import Primitives, Skill, SkillError
from cell.errors import BackendError, PlanError
from cell.frames import Array
from cell.motion.planner import Planner
from cell.run.link import Link

T = TypeVar("T")
Tell = Callable[[str], None]
_QUIET = 0.25
"""The arm is left alone for so long before a picture, for what swings to come to rest [s]."""


class Collector:
    """One arm with the board in its gripper.

    Args:
        link: to the node. planner, carrying: for the bare arm, and with the board in its gripper.
        holder: name for the command lease. live: time passes by itself, and so does the node's patience
            with a silent heart; plans are then made beside the arm's loop.
    """

    def __init__(
        self,
        config: CellConfig,
        link: Link,
        planner: Planner,
        carrying: Planner,
        board: Board,
        holder: str,
        *,
        live: bool,
    ) -> None:
        self._config, self._link, self._board, self._live = config, link, board, live
        self._planner, self._carrying = planner, carrying
        self._body = Primitives(config, holder)
        self._body.inputs = link.exchange(())

    def grip(self) -> None:
        """Close the fingers on the board's tab."""
        self._run(self._body.grip(0.0))

    def views(self, camera: str, poses: list[Pose], count: int, tell: Tell) -> list[View]:
        """Pictures at the first poses that can be reached until `count` are usable, nearest first.

        Raises:
            BackendError: the arm was stopped, refuses, or the camera is silent.
        """
        out: list[View] = []
        good, left = 0, list(poses)
        while left and good < count:
            wanted = left[: count - good]
            wanted.sort(key=lambda p: float(np.abs(p.q - self._body.q_rest).max()))
            pose = wanted[0]
            left = [p for p in left if p is not pose]
            if not self._go(self._carrying, pose.q):
                tell(f"camera {camera}: a pose is left out, no free way leads there")
                continue
            view = self._run(self._look(camera))
            out.append(view)
            _, bad = usable([view])
            good += not bad
            seen = f"{len(view.corners.ids)} of {len(self._board.points_B)} corners"
            tell(f"camera {camera}: view {len(out)}, {seen}" + (f"; {bad[0].why}" if bad else ""))
        return out

    def reach(self, poses: list[Pose]) -> Array:
        """Move the empty gripper to the pose nearest to home, where the board is put in; its joints [rad].

        Raises:
            PlanError: no free way leads to any of them.
        """
        home = np.array(self._config.arm.home)
        reasons: list[str] = []
        for pose in sorted(poses, key=lambda p: float(np.abs(p.q - home).max())):
            try:
                self._follow(self._planner, pose.q)
                return pose.q
            except PlanError as error:
                reasons.append(str(error))
        raise PlanError(f"no pose at which the board could be put in is within reach: {reasons[0]}")

    def back(self, q: Array) -> bool:
        """Carry the board to joint angles q (6,) [rad]; False when no free way leads there."""
        return self._go(self._carrying, q)

    def wait(self, done: Callable[[], bool]) -> None:
        """Keep the arm's loop alive until somebody has done what was asked for."""
        while not done():
            self._body.inputs = self._link.exchange(self._body.take_outbox())

    def home(self) -> bool:
        """Move the empty gripper home, clear of the cameras; False when no free way leads there."""
        return self._go(self._planner, np.array(self._config.arm.home))

    def _go(self, planner: Planner, q: Array) -> bool:
        try:
            self._follow(planner, q)
        except PlanError:
            return False
        return True

    def _follow(self, planner: Planner, q: Array) -> None:
        at = self._body.q_rest
        if float(np.abs(q - at).max()) > 1e-3:
            cap = self._config.motion.collaborative_speed
            path = self._beside(lambda: planner.plan_joints(at, q, cap))
            self._run(self._body.follow(path))

    def _beside(self, work: Callable[[], T]) -> T:
        """The result of `work`; the arm's loop goes on meanwhile where time does."""
        if not self._live:
            return work()
        with ThreadPoolExecutor(1) as worker:
            result = worker.submit(work)
            self.wait(result.done)
            return result.result()

    def _look(self, camera: str) -> Skill[View]:
        body = self._body
        yield from body.settle()
        yield from body.pause(_QUIET)
        before, speed = self._joints(), self._speed()
        frame = yield from body.look(camera)
        after = self._joints()
        q = 0.5 * (before + after)
        drift = float(np.abs(after - before).max())
        X_WT = self._planner.kinematics.X_WT(q)
        corners = self._beside(lambda: self._board.find(frame.rgb))
        return View(q, X_WT, corners, max(speed, self._speed()), drift)

    def _joints(self) -> Array:
        assert self._body.inputs is not None
        return np.asarray(self._body.inputs.joints.q)

    def _speed(self) -> float:
        assert self._body.inputs is not None
        return float(np.abs(self._body.inputs.joints.qd).max())

    def _run(self, skill: Skill[T]) -> T:
        """Exchange commands and inputs with the node until the skill has ended."""
        try:
            next(skill)
            while True:
                inputs: Inputs = self._link.exchange(self._body.take_outbox())
                self._body.inputs = inputs
                skill.send(inputs)
        except StopIteration as stop:
            value: T = stop.value
            return value
        except SkillError as error:
            raise BackendError(f"calibration ended: {error.code}: {error.reason}") from None
