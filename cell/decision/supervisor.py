"""The supervisor: one pure tick from inputs to outputs.

Each tick the running skill gets the new inputs. When it ends, the finite-state machine moves
by the skill's outcome and the policy table names the next action. `tick` does no I/O and reads
no clock: recorded inputs replayed through it give the same outputs, byte for byte.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from cell.config import CellConfig
from cell.decision.companion import Companion
from cell.decision.fsm import Task
from cell.decision.io import Inputs, Outputs
from cell.decision.modes import NOBODY, ModeState, Permit, PermitKeeper, decide
from cell.decision.operator import Operator
from cell.decision.policy import PolicyTable
from cell.decision.primitives import Primitives, Skill, SkillError
from cell.decision.skills import Ended, Skills
from cell.decision.stopped import StoppedRound
from cell.errors import PlanError
from cell.frames import Array
from cell.motion.planner import Planner
from cell.motion.views import InspectionViews
from cell.perception.look import Eye, OnionDetector
from cell.wire.types import Event, Frame, Hands, SupervisorState
from cell.wire.vocabulary import Action

_MOST_FAILURES = 5
"""Skills that may fail in a row before the round is given up; looking at the belt does not count."""
_YIELDS = ("yielded", "yielding")
"""Ends at which the robot gave way to the person."""
_COUNTED_ELSEWHERE = ("missed_grasp", "lost_onion", "unreachable", *_YIELDS)
"""Ends that are no failures, or that the tracker counts per onion until it is set aside."""
_INFO, _WARN, _ERROR = 20, 30, 40


class Supervisor:
    """Sorts one batch.

    Args:
        config: the cell. policy: the table to follow.
        planner, views: motion. detector: finds onions in images.
        holder: name under which it holds the command lease.
        person: watches the person; None in a cell without one.
    """

    def __init__(
        self,
        config: CellConfig,
        policy: PolicyTable,
        planner: Planner,
        views: InspectionViews,
        detector: OnionDetector,
        holder: str = "supervisor",
        person: Companion | None = None,
    ) -> None:
        self._config, self._policy, self._person = config, policy, person
        self._body = Primitives(config, holder)
        self._skills = Skills(self._body, planner, views, Eye(config, detector), person)
        self._permits = PermitKeeper(config)
        self._task = Task()
        self._asked_bin = -1
        self._yields = 0
        self._signal = ""
        self._body.obstructed = self._in_the_way
        self._operator = Operator()
        self._stop = StoppedRound(config.supervisor.stop_patience)
        self._recovering = False
        self._running: Skill[Ended] | None = None
        self._action = Action.NO_OP
        self._failures = 0
        self._started: float | None = None
        self._reason = ""
        self._events: list[Event] = []
        self._result: tuple[bool, str] = (False, "")

    def look(self, frames: tuple[Frame, ...]) -> None:
        """Look at frames ahead of the tick that brings them; `tick` comes to the same without it."""
        if self._person is not None:
            self._person.look(frames, self._onions())

    def tick(self, inputs: Inputs) -> Outputs:
        """One decision cycle; see `Inputs` and `Outputs`."""
        self._body.inputs = inputs
        self._started = inputs.t if self._started is None else self._started
        self._operator.update(inputs.operator, inputs.arm.stopped)
        self._body.held = self._operator.hold
        self._tell(_INFO, self._operator.news)
        permit = self._watch_person(inputs)
        if not self._result[0]:
            self._reconsider()
        mode = self._mode(permit, inputs)
        self._body.speed_cap = mode.cap
        if not self._result[0]:
            self._work(inputs)
            mode = self._mode(permit, inputs)  # the policy may have changed it, or a wait begun
            self._body.speed_cap = mode.cap
        if not self._result[0]:
            self._show(mode)
        detections = tuple(self._skills.looking.detections)
        self._skills.looking.detections.clear()
        while self._skills.looking.news:
            self._say(_WARN, self._skills.looking.news.pop(0))
        events, self._events = tuple(self._events), []
        done, failure = self._result
        hands: tuple[Hands, ...] = ()
        if self._person is not None:
            hands = tuple(self._person.hands)
            self._person.hands.clear()
        commands = self._body.take_outbox()
        return Outputs(commands, self._state(mode), detections, events, hands, done, failure)

    # -- the person and the mode ------------------------------------------------------------------

    def _watch_person(self, inputs: Inputs) -> Permit:
        """Take in what the person camera shows; what it permits."""
        person = self._person
        if person is None:
            return NOBODY
        held = 0.5 * self._config.onions.diameter[1] if inputs.gripper.holding else 0.0
        person.update(inputs, held, self._onions())
        self._tell(_INFO, person.news)
        return self._permits.update(inputs.t, person.sensed(inputs.t))

    def _onions(self) -> Array:
        """Onions that are known of (N, 4): centre and radius [m]."""
        tracks = self._skills.tracker.tracks
        return np.array([[*t.p_WO, t.radius] for t in tracks]).reshape(-1, 4)

    def _reconsider(self) -> None:
        """A changed belief may change the mode at once, in the middle of an action."""
        bin = self._policy.belief_bin(self._belief)
        if bin == self._asked_bin or self._running is None:
            return
        self._asked_bin = bin
        action = self._policy.action(self._task.state(bin))
        if action in (Action.SPEED_UP, Action.SLOW_DOWN):
            self._task.apply(action, Ended("done"))
            self._say(_INFO, f"{action.name.lower()}: belief {self._belief:.2f}")

    def _mode(self, permit: Permit, inputs: Inputs) -> ModeState:
        stopped, waiting = inputs.arm.stopped, self._body.waiting
        return decide(
            self._config.motion, self._task.own_type, permit, stopped, waiting,
            recovering=self._recovering, operator=self._operator,
        )  # fmt: skip

    def _in_the_way(self, q: Array) -> bool:
        """Whether the arm is to wait before it moves through configurations (N, 6) [rad]."""
        person = self._person
        return self._operator.hold or (person is not None and person.in_the_way(q, self._body.waiting))

    def _show(self, mode: ModeState) -> None:
        """Put the mode on the light when it changes."""
        signal = mode.signal(self._belief)
        if signal != self._signal:
            self._signal = signal
            self._body.show(signal)

    @property
    def _belief(self) -> float:
        """P(the person is fatigued); 0 where there is nobody."""
        return 0.0 if self._person is None else self._person.belief

    # -- the loop -------------------------------------------------------------------------------

    def _work(self, inputs: Inputs) -> None:
        if inputs.arm.stopped:
            self._while_stopped(inputs)
            return
        if self._stop.over():
            self._recovering, self._running = True, self._skills.recover()
            if (ended := self._guard(next)) is not None:
                self._recovered(ended)
            return
        assert self._started is not None
        if inputs.t - self._started > self._config.supervisor.round_timeout:
            self._finish(f"the round took longer than {self._config.supervisor.round_timeout:g} s")
            return
        ended = self._advance(inputs)
        if self._recovering:
            if ended is not None:
                self._recovered(ended)
            return
        # Actions that need no time (mode changes) follow one another within the same tick.
        for _ in range(4):
            if ended is not None and not self._conclude(ended):
                return
            if self._running is not None:
                return
            ended = self._begin()
        if ended is not None:
            self._conclude(ended)

    def _while_stopped(self, inputs: Inputs) -> None:
        """Nothing runs until an operator lifts the stop; without one the round ends."""
        if not self._stop.wait(inputs, self._operator, self._body):
            self._finish(f"the arm was stopped: {inputs.arm.stop_reason}")
            return
        self._tell(_WARN, self._stop.news)
        if self._running is not None or self._recovering:
            self._running, self._recovering = None, False
            self._task.apply(self._action, Ended("stopped"))
            self._skills.target = None

    def _recovered(self, ended: Ended) -> None:
        self._recovering, self._action = False, Action.NO_OP
        if not ended.done:
            self._finish(f"no way on after the stop: {ended.code}: {ended.reason}")

    def _advance(self, inputs: Inputs) -> Ended | None:
        """Let the running skill see the inputs; its end, if it ended."""
        return None if self._running is None else self._guard(lambda skill: skill.send(inputs))

    def _begin(self) -> Ended | None:
        """Ask the policy and start what it says; the end, if it ended at once."""
        self._asked_bin = self._policy.belief_bin(self._belief)
        state = self._task.state(self._asked_bin)
        self._action = self._policy.action(state)
        skills = self._skills
        starts: dict[Action, Callable[[], Skill[Ended]]] = {
            Action.NO_OP: skills.no_op,
            Action.DETECT: skills.detect,
            Action.DETECT_PICK: skills.detect_pick,
            Action.PICK: skills.pick,
            Action.INSPECT: skills.inspect,
            Action.PLACE_ON_CONVEYOR: skills.place_on_conveyor,
            Action.PLACE_IN_BIN: partial(skills.place_in_bin, self._task.in_bin),
        }
        if self._action not in starts:
            return Ended("done")  # a mode change: the task state does it
        self._running = starts[self._action]()
        return self._guard(next)

    def _guard(self, step: Callable[[Skill[Ended]], None]) -> Ended | None:
        """Run one step of the skill and turn every way it can end into `Ended`."""
        assert self._running is not None
        try:
            step(self._running)
            return None
        except StopIteration as stop:
            ended: Ended = stop.value
        except SkillError as error:
            ended = Ended(error.code, error.reason)
        except PlanError as error:
            ended = Ended("no_path", str(error))
        self._running = None
        return ended

    def _conclude(self, ended: Ended) -> bool:
        """Move the task state by how the action ended; False when the round is over."""
        self._reason = f"{ended.code}: {ended.reason}" if ended.reason else ended.code
        self._task.apply(self._action, ended)
        if self._person is not None:
            self._person.robot_decided(self._body.now)
        self._yields += ended.code in _YIELDS
        level = _INFO if ended.done else _WARN
        self._say(level, f"{self._action.name.lower()}: {self._reason}")
        if ended.code == "nothing_left":
            self._finish("")
            return False
        if ended.done and self._action is not Action.DETECT:
            self._failures = 0
        elif not ended.done and ended.code not in _COUNTED_ELSEWHERE:
            self._failures += 1
        if ended.code == "stopped" or self._failures >= _MOST_FAILURES:
            self._finish(f"{self._action.name.lower()} failed: {self._reason}")
            return False
        return True

    def _finish(self, failure: str) -> None:
        self._result = (True, failure)
        self._running = None
        if failure:
            self._say(_ERROR, failure)

    # -- what watchers see ------------------------------------------------------------------------

    def _tell(self, level: int, news: list[str]) -> None:
        for text in news:
            self._say(level, text)
        news.clear()

    def _say(self, level: int, text: str) -> None:
        self._events.append(Event(self._body.now, level, "supervisor", text))

    def _state(self, mode: ModeState) -> SupervisorState:
        task, target, person = self._task, self._skills.target, self._person
        action, confidence = (Action.NO_OP, 0.0) if person is None else person.action
        age = 0.0 if person is None else person.sensed(self._body.now).age
        x, y, z = (0.0, 0.0, 0.0) if target is None else target.track.p_WO
        return SupervisorState(
            t=self._body.now,
            mode=int(mode.mode),
            action=int(self._action),
            phase="done" if self._result[0] else self._action.name.lower(),
            onion_location=int(task.onion),
            eef_location=int(task.eef),
            prediction=int(task.prediction),
            own_type=int(task.own_type),
            belief=self._belief,
            requested_industrial=mode.requested,
            permitted_industrial=mode.permitted,
            separation=mode.separation,
            speed_cap=mode.cap,
            binding_cap=mode.binding,
            sorted=task.in_bin + task.on_conveyor,
            in_bin=task.in_bin,
            on_conveyor=task.on_conveyor,
            remaining=len(self._skills.tracker.waiting()),
            reason=self._reason,
            target=(float(x), float(y), float(z)),
            human_action=int(action),
            human_confidence=confidence,
            gesture="" if person is None else person.sign,
            separation_age=age,
            yields=self._yields,
            light=self._signal,
            by_human=0 if person is None else person.placed,
        )
