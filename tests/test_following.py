"""A motion under way, against the node's own executor: retimed, held, given up, never off its path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cell.config import CellConfig, load
from cell.decision.io import Inputs
from cell.decision.primitives import GiveWay, Primitives, SkillError, never
from cell.errors import RefusedError
from cell.frames import Array
from cell.limits import Limits, tcp_positions
from cell.motion.paths import JointPath
from cell.motion.timing import TimedPath, time_path
from cell.wire.types import ArmStatus, BeltState, GripperState, JointState, Reply, Trajectory
from hil.executor import Executor

FAST, SLOW = 1.0, 0.25
PERIOD = 0.008


@cache
def config() -> CellConfig:
    return load()


def path() -> TimedPath:
    """A swing of the arm of about a metre, planned at the industrial cap."""
    home = np.array(config().arm.home)
    swing = np.array([[0.0] * 6, [0.7, 0.15, -0.2, 0.1, 0.0, 0.3], [2.6, 0.0, 0.1, 0.0, 0.2, 0.8]])
    return time_path(JointPath(home + swing), FAST, config())


class Arm:
    """One motion on the executor, with everything it did.

    Args:
        late: so many cycles go by before the node sees a command.
    """

    def __init__(self, late: int = 0) -> None:
        self.body = Primitives(config(), "test")
        self.timed = path()
        self.executor = Executor(Limits.from_config(config()), PERIOD, self.timed.path.start)
        self.now, self.q, self.qd = 0.0, [self.executor.q], [self.executor.qd]
        self.refused: list[str] = []
        self.sent: list[Trajectory] = []
        self._late = late
        self._waiting: list[tuple[int, int, Trajectory]] = []
        self._replies: list[tuple[int, Reply]] = []

    def run(self, before: Callable[[float], None], give_way: GiveWay = never) -> str:
        """Follow the path; the code with which it was given up, or an empty text."""
        self.body.speed_cap = FAST
        self.body.inputs = self._inputs()
        skill = self.body.follow(self.timed, give_way)
        try:
            next(skill)
            while True:
                self._cycle()
                before(self.now)
                skill.send(self._inputs())
                assert self.now < 30.0, "it does not end"
        except StopIteration:
            return ""
        except SkillError as error:
            return error.code

    def _cycle(self) -> None:
        """Commands reach the node, five control periods pass."""
        self._replies = []
        for c in self.body.take_outbox():
            assert isinstance(c.order, Trajectory)
            self._waiting.append((self._late, c.ticket, c.order))
        still = []
        for left, ticket, order in self._waiting:
            if left > 0:
                still.append((left - 1, ticket, order))
                continue
            self.sent.append(order)
            try:
                self.executor.accept(order, self.now, self.executor.q)
                self._replies.append((ticket, Reply(True)))
            except RefusedError as error:
                self.refused.append(f"{error.code}: {error.reason}")
                self._replies.append((ticket, Reply(False, error.code, error.reason)))
        self._waiting = still
        for _ in range(5):
            q, qd = self.executor.tick(self.now)
            self.now += PERIOD
            self.q.append(q.copy())
            self.qd.append(qd.copy())

    def _inputs(self) -> Inputs:
        e = self.executor
        status = replace(
            ArmStatus(self.now), trajectory_id=e.trajectory_id, moving=e.moving, progress=e.progress
        )
        joints = JointState(self.now, e.q, e.qd, np.zeros(6))
        gripper, belt = GripperState(self.now, 0.085, 0.085, False, False), BeltState(self.now, 1, False, 0.0)
        return Inputs(self.now, joints, status, gripper, belt, (), tuple(self._replies))

    # -- what happened --------------------------------------------------------------------------------

    def speed(self) -> Array:
        """Tool speed of each control period [m/s]."""
        p = tcp_positions(np.array(self.q), config().gripper.length)
        return np.linalg.norm(np.diff(p, axis=0), axis=1) / PERIOD

    def acceleration_share(self) -> float:
        return float(
            np.abs(np.diff(np.array(self.qd), axis=0)).max() / PERIOD / config().arm.max_acceleration
        )

    def off_path(self) -> float:
        """Largest joint distance of any set-point from the path [rad]."""
        on = self.timed.path(np.linspace(0.0, self.timed.path.length, 20001))
        return max(float(np.abs(on - q).max(axis=1).min()) for q in self.q[::7])


def set_at(body: Primitives, t0: float, cap: float) -> Callable[[float], None]:
    def before(now: float) -> None:
        if now >= t0:
            body.speed_cap = cap

    return before


@pytest.mark.parametrize("t0", [0.1, 0.3, 0.5])
def test_a_lower_cap_holds_as_soon_as_the_joints_can_brake(t0: float) -> None:
    arm = Arm()
    assert arm.run(set_at(arm.body, t0, SLOW)) == ""
    assert not arm.refused and len(arm.sent) == 2
    settled = arm.speed()[int((t0 + 0.04 + 0.6) / PERIOD) :]
    assert settled.size and settled.max() <= SLOW
    assert arm.acceleration_share() < 1.0
    assert arm.off_path() < 1e-3
    assert np.allclose(arm.q[-1], arm.timed.path.end, atol=1e-9)


def test_many_changes_of_mind_in_one_motion() -> None:
    arm = Arm()
    caps = [SLOW, FAST, 0.4, 0.1, 0.8, SLOW, FAST]

    def before(now: float) -> None:
        arm.body.speed_cap = caps[int(now / 0.12) % len(caps)]

    assert arm.run(before) == ""
    assert not arm.refused and len(arm.sent) > 5
    assert arm.acceleration_share() < 1.0
    assert arm.off_path() < 1e-3


def test_the_arm_waits_for_a_person_in_its_way_and_goes_on() -> None:
    arm = Arm()
    in_the_way = {"now": False}
    arm.body.obstructed = lambda q: in_the_way["now"]
    waited: list[float] = []

    def before(now: float) -> None:
        in_the_way["now"] = 0.3 <= now < 1.5
        if arm.body.waiting:
            waited.append(now)

    assert arm.run(before) == ""
    assert waited and 1.0 < waited[-1] < 2.0
    resting = arm.speed()[int(1.2 / PERIOD) : int(1.5 / PERIOD)]
    assert resting.max() == 0.0
    assert arm.off_path() < 1e-3 and arm.acceleration_share() < 1.0
    assert np.allclose(arm.q[-1], arm.timed.path.end, atol=1e-9)


def test_a_person_who_stays_in_the_way_makes_it_give_up_at_rest() -> None:
    arm = Arm()
    arm.body.obstructed = lambda q: True
    assert arm.run(lambda now: None) == "yielded"
    assert not arm.executor.moving and arm.off_path() < 1e-3
    assert np.allclose(arm.body.q_rest, arm.executor.q, atol=1e-6)


def test_a_motion_that_is_given_up_stops_on_its_path() -> None:
    arm = Arm()
    reason = {"why": ""}

    def before(now: float) -> None:
        reason["why"] = "the person reaches for it" if now > 0.4 else ""

    assert arm.run(before, lambda: reason["why"]) == "yielded"
    assert not arm.executor.moving
    assert arm.now < 1.5 and arm.off_path() < 1e-3
    assert not np.allclose(arm.q[-1], arm.timed.path.end, atol=0.05)


def test_changes_that_come_too_late_are_planned_farther_ahead() -> None:
    """A slow wire: the node refuses what has begun already, and the next try allows for it."""
    arm = Arm(late=2)
    assert arm.run(set_at(arm.body, 0.3, SLOW)) == ""
    assert arm.refused and all(text.startswith("stale") for text in arm.refused)
    assert arm.speed()[int(1.4 / PERIOD) :].max() <= SLOW
    assert arm.off_path() < 1e-3
