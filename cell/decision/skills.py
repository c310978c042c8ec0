"""The robot's skills: what each action of the policy does, and why it ended.

Every skill is a generator (see `primitives`) that returns `Ended`. The abstract state of the
task changes by what a skill reports, never by what was hoped for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from cell.decision.companion import Companion
from cell.decision.looking import BLEMISHED_ABOVE, Looking
from cell.decision.primitives import GiveWay, Primitives, Skill, SkillError, never
from cell.decision.targets import Grasp, choose
from cell.errors import PlanError
from cell.frames import Array
from cell.motion.planner import Planner
from cell.motion.views import InspectionViews
from cell.perception.look import Eye
from cell.perception.tracking import Status, Track
from cell.wire.vocabulary import Prediction

_FINGERTIP = 0.011
"""The fingers reach this far beyond the tool centre point [m]."""
_BELT_GAP = 0.006
"""Least distance of the fingertips from the belt in a grasp [m]."""
_RELEASE_GAP = 0.002
"""How much higher an onion is let go than it was taken, so that it is not pressed down [m]."""
_WAIT = 0.4
"""Between two looks while a person is at the onions [s]."""
_CLEAR_HEIGHT = 0.16
"""Height of the tool over the belt at which it is above all onions [m]."""
_HELD_MARGIN = 0.010
"""How well the camera knows a held onion's size and its place between the fingers [m]."""


@dataclass(frozen=True)
class Ended:
    """Why a skill ended: `code` one word (done, nothing_left, missed_grasp, ...), `reason` a sentence."""

    code: str
    reason: str = ""
    prediction: Prediction = Prediction.UNKNOWN

    @property
    def done(self) -> bool:
        return self.code == "done"


class Skills:
    """All skills over one arm, one eye, one tracker."""

    def __init__(
        self,
        body: Primitives,
        planner: Planner,
        views: InspectionViews,
        eye: Eye,
        person: Companion | None = None,
    ) -> None:
        self.body = body
        self.person = person
        self.looking = Looking(body, eye)
        self.tracker = self.looking.tracker
        self.target: Grasp | None = None
        self._planner, self._views = planner, views
        self._config = body.config
        self._X_WT_grasp: Array | None = None

    # -- skills ---------------------------------------------------------------------------------

    def detect(self) -> Skill[Ended]:
        """Look at the belt with the arm out of the way and choose the next onion."""
        if self.body.holds():
            # An earlier action failed with an onion in the hand: put it back before going on.
            yield from self.place_on_conveyor(sorted_out=False)
        self.target = None
        yield from self._go_home()
        for _ in range(self._config.supervisor.look_attempts):
            yield from self.looking.at_belt()
            while free := self._free():
                grasp = choose(free, self.tracker.tracks, self._p_WT(), self._config)
                if self._reachable(grasp):
                    self.target = grasp
                    chance = yield from self.looking.until_certain(
                        grasp.track.p_blemished, partial(self.looking.again, grasp.track.id)
                    )
                    blemished = chance >= BLEMISHED_ABOVE
                    return Ended("done", "", Prediction.BLEMISHED if blemished else Prediction.UNBLEMISHED)
                self.tracker.failed(grasp.track.id, 1, "out of the arm's reach")
        if occupied := self._occupied():
            yield from self.body.pause(_WAIT)
            return Ended("yielding", occupied)
        return Ended("nothing_left", self._what_is_left())

    def pick(self) -> Skill[Ended]:
        """Take the chosen onion from the belt."""
        grasp = self.target
        if grasp is None:
            return Ended("no_target", "pick without a detected onion")
        X_WT = self._grasp_pose(grasp)
        above = self._planner.hover(X_WT)
        try:
            try:
                yield from self._approach(X_WT, give_way=partial(self._person_at, grasp.track.p_WO))
            except SkillError as error:
                if error.code != "yielded":
                    raise
                self.target = None
                yield from self._back_off()
                return Ended(error.code, error.reason)
            yield from self.body.settle()
            self._X_WT_grasp = X_WT
            yield from self.body.grip(0.0)
            held = self.body.holds()
            if not held:
                yield from self.body.grip(self._config.gripper.stroke)
            yield from self._to_pose(above, straight=True, held=held)
        except PlanError as error:
            self.tracker.failed(grasp.track.id, 1, str(error))
            self.target = None
            return Ended("unreachable", str(error))
        if held and self.body.holds():
            return Ended("done")
        code, reason = (
            ("lost_onion", "it slipped while lifting")
            if held
            else ("missed_grasp", "nothing between the fingers")
        )
        if held:
            yield from self.body.grip(self._config.gripper.stroke)
        self.tracker.failed(grasp.track.id, self._config.supervisor.grasp_attempts, reason)
        self.target, self._X_WT_grasp = None, None
        return Ended(code, reason)

    def detect_pick(self) -> Skill[Ended]:
        """Detect and pick in one action (industrial mode)."""
        ended = yield from self.detect()
        if not ended.done:
            return ended
        picked = yield from self.pick()
        return Ended(picked.code, picked.reason, ended.prediction)

    def inspect(self) -> Skill[Ended]:
        """Turn the held onion's hidden sides to the belt camera."""
        views = self._views.views
        found = 0
        for view in views:
            yield from self.body.follow(
                self._planner.plan_joints(
                    self.body.q_rest, view.q, self.body.speed_cap, held_radius=self._held_radius()
                )
            )
            yield from self.body.settle()
            if not self.body.holds():
                return (yield from self._lost("it fell during inspection"))
            p_WT = view.X_WT[:3, 3]
            chance: float | None = None
            for _ in range(self._config.supervisor.look_attempts):
                chance = yield from self.looking.at_held(p_WT)
                if chance is not None:
                    break
            if chance is None:
                continue
            found += 1
            chance = yield from self.looking.until_certain(chance, partial(self.looking.at_held, p_WT))
            if chance >= BLEMISHED_ABOVE:
                return Ended("done", "blemish seen", Prediction.BLEMISHED)
        if found == 0:
            # Nothing proves that it is sound: the safe side for the eater is the bin.
            return Ended("done", "the onion was not recognised in any view", Prediction.BLEMISHED)
        seen = (
            "no blemish seen" if found == len(views) else f"no blemish seen in {found} of {len(views)} views"
        )
        return Ended("done", seen, Prediction.UNBLEMISHED)

    def place_on_conveyor(self, sorted_out: bool = True) -> Skill[Ended]:
        """Put the held onion back where it lay; it counts as sorted if `sorted_out`."""
        X_WT = self._X_WT_grasp
        if X_WT is None:
            return Ended("no_onion", "nothing in the hand")
        low = X_WT.copy()
        low[2, 3] += _RELEASE_GAP
        above = self._planner.hover(X_WT)
        yield from self._approach(low, held=True)
        yield from self.body.settle()
        if not self.body.holds():
            return (yield from self._lost("it fell on the way to the belt"))
        yield from self.body.grip(self._config.gripper.stroke)
        yield from self._to_pose(above, straight=True)
        if self.target is not None and sorted_out:
            self.tracker.placed(self.target.track.id, low[:3, 3])
        self.target, self._X_WT_grasp = None, None
        return Ended("done")

    def place_in_bin(self, before: int) -> Skill[Ended]:
        """Carry the held onion to the bin, where `before` others lie, and let it go."""
        X_WT = self._planner.drop_pose(self.body.q_rest, before)
        yield from self._to_pose(X_WT, held=True)
        if not self.body.holds():
            return (yield from self._lost("it fell on the way to the bin"))
        yield from self.body.settle()
        yield from self.body.grip(self._config.gripper.stroke)
        if self.target is not None:
            self.tracker.taken(self.target.track.id)
        self.target, self._X_WT_grasp = None, None
        return Ended("done")

    def recover(self) -> Skill[Ended]:
        """After a stop: open an empty hand and rise from the belt; the next look shows what is left."""
        held = self.body.holds()
        if not held:
            yield from self.body.grip(self._config.gripper.stroke)
        if self._p_WT()[2] < self._config.belt.top_z + _CLEAR_HEIGHT:
            yield from self._back_off(held)
        return Ended("done")

    def no_op(self) -> Skill[Ended]:
        """Do nothing for one tick."""
        yield from self.body.tick()
        return Ended("done")

    # -- parts ----------------------------------------------------------------------------------

    def _free(self) -> list[Track]:
        """Onions to be sorted that the last look showed, and that no person is at."""
        seen = [t for t in self.tracker.waiting() if t.missed == 0]
        return [t for t in seen if not self._person_at(t.p_WO)]

    def _person_at(self, p_WO: Array) -> str:
        """Why an onion is the person's, empty when it is not: people are served first."""
        near = self.person is not None and self.person.near(p_WO, self._config.separation.give_way)
        return "the person's hand is at the onion" if near else ""

    def _occupied(self) -> str:
        """Why an empty belt does not mean that the batch is over, as long as a person works on it."""
        if self.person is None:
            return ""
        if self.tracker.waiting():
            return "the person is at the onions that are left"
        if self.person.over_window():
            return "the person's hands are over the belt"
        return "the person still holds an onion" if self.person.busy else ""

    def _what_is_left(self) -> str:
        """Why the batch is over, with what had to be left lying."""
        reasons = [t.reason for t in self.tracker.tracks if t.status is Status.SET_ASIDE]
        counts = ", ".join(f"{reasons.count(r)} {r}" for r in dict.fromkeys(reasons))
        return "no onion left to sort" + (f"; set aside: {counts}" if reasons else "")

    def _lost(self, reason: str) -> Skill[Ended]:
        """The onion is gone: open the hand and forget the target; it will be seen again or not."""
        yield from self.body.grip(self._config.gripper.stroke)
        if self.target is not None:
            self.tracker.taken(self.target.track.id)
        self.target, self._X_WT_grasp = None, None
        return Ended("lost_onion", reason)

    def _go_home(self) -> Skill[None]:
        home = np.array(self._config.arm.home)
        if np.max(np.abs(self.body.q_rest - home)) > 1e-3:
            yield from self.body.follow(
                self._planner.plan_joints(self.body.q_rest, home, self.body.speed_cap)
            )

    def _approach(self, X_WT: Array, *, held: bool = False, give_way: GiveWay = never) -> Skill[None]:
        """To above a grasp and straight down to it in one motion, in two where one is not free."""
        radius = self._held_radius() if held else 0.0
        try:
            path = self._planner.plan_approach(
                self.body.q_rest, X_WT, self.body.speed_cap, held_radius=radius
            )
        except PlanError:
            yield from self._to_pose(self._planner.hover(X_WT), held=held, give_way=give_way)
            yield from self._to_pose(X_WT, straight=True, held=held, give_way=give_way)
            return
        yield from self.body.follow(path, give_way)

    def _back_off(self, held: bool = False) -> Skill[None]:
        """Straight up to where transfers begin, away from what lies on the belt."""
        X_WT = self._planner.kinematics.X_WT(self.body.q_rest).copy()
        X_WT[2, 3] = max(X_WT[2, 3], self._config.belt.top_z + _CLEAR_HEIGHT)
        try:
            yield from self._to_pose(X_WT, straight=True, held=held)
        except PlanError:
            return  # it stands high enough, or the next motion finds a way

    def _to_pose(
        self, X_WT: Array, *, straight: bool = False, held: bool = False, give_way: GiveWay = never
    ) -> Skill[None]:
        radius = self._held_radius() if held else 0.0
        path = self._planner.plan_to_pose(
            self.body.q_rest, X_WT, self.body.speed_cap, straight=straight, held_radius=radius
        )
        yield from self.body.follow(path, give_way)

    def _held_radius(self) -> float:
        """Of the sphere about the TCP that surely encloses the held onion [m]."""
        largest = 0.5 * self._config.onions.diameter[1]
        return _HELD_MARGIN + (min(self.target.track.radius, largest) if self.target else largest)

    def _grasp_pose(self, grasp: Grasp) -> Array:
        p_WO = grasp.track.p_WO.copy()
        p_WO[2] = max(p_WO[2], self._config.belt.top_z + _FINGERTIP + _BELT_GAP)
        return self._planner.nearer_turn(self._planner.grasp_pose(p_WO, grasp.yaw), self.body.q_rest)

    def _reachable(self, grasp: Grasp) -> bool:
        return self._planner.reachable(self._grasp_pose(grasp), self._config.motion.hover)

    def _p_WT(self) -> Array:
        p: Array = self._planner.kinematics.X_WT(self.body.q_rest)[:3, 3]
        return p


__all__ = ["Ended", "Skills"]
