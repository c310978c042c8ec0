"""A quick stand-in for the person camera: the supervisor is told what the simulation knows.

For development and sweeps only, and marked in every result. The rate and the latency are the
camera's; separation, action and sign are exact, and of the body only the hands and forearms are
points that the arm keeps away from. The product never uses it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell.config import CellConfig
from cell.decision.belief import Belief
from cell.decision.companion import Companion
from cell.decision.io import Inputs
from cell.decision.modes import Sensed
from cell.errors import BackendError
from cell.frames import Array
from cell.motion.collision import CollisionModel
from cell.perception.hand_regions import Region
from cell.perception.hands.gesture import Gesture
from cell.perception.human_action import ActionReading, HumanActions
from cell.perception.person import PersonView
from cell.perception.separation import Cloud
from cell.wire.types import Frame, Hands, Truth
from cell.wire.vocabulary import Action

RATE, LATENCY = 10.0, 0.06
"""Of the reference cell's person camera [Hz], [s]."""
_EMPTY = (np.zeros((0, 0, 3), np.uint8), np.zeros((0, 0), np.float32))
_RADII = np.array(
    [[0.0, 0.0, 0.0], [0.0, 0.0, 0.045], [0.0, 0.0, -0.045], [0.0, 0.045, 0.0], [0.0, -0.045, 0.0]]
)
_FULL = (Action.INSPECT, Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN)


class Witness:
    """What was true of the person, moment by moment; fed from outside the supervisor."""

    def __init__(self) -> None:
        self._seen: list[Truth] = []

    def tell(self, truth: Truth) -> None:
        """Take in what is true now."""
        self._seen.append(truth)
        del self._seen[:-64]

    @property
    def known(self) -> bool:
        return bool(self._seen)

    def at(self, t: float) -> Truth:
        """The newest that is not later than t [s], else the oldest kept."""
        return next((truth for truth in reversed(self._seen) if truth.t <= t + 1e-9), self._seen[0])


class TrueEye:
    """In the place of `PersonEye`: a view made of the truth at the exposure."""

    def __init__(self, witness: Witness) -> None:
        self._witness = witness

    def look(self, frame: Frame, arm: Array, onions: Array, full: Array | None = None) -> PersonView:
        del arm, onions, full
        person = self._witness.at(frame.t).person
        if person is None:
            raise BackendError("--perception truth needs a simulated person")
        points = np.concatenate([_arm_points(p) for p in person.p_WH])
        sign = Gesture(person.gesture)
        regions = tuple(Region(p, 20) for p in person.p_WH)
        cloud = Cloud(frame.t, points, np.full(len(points), frame.t), 1.0)
        return PersonView(frame.t, cloud, regions, Hands(frame.t, "person", ()), sign, sign, "")


class TrueActions(HumanActions):
    """In the place of the judgement by the hand's place: the action itself."""

    def __init__(self, config: CellConfig, witness: Witness) -> None:
        super().__init__(config)
        self._witness = witness

    def update(self, view: PersonView) -> ActionReading:
        truth = self._witness.at(view.t)
        assert truth.person is not None
        action = Action(truth.person.action)
        began = self.reading.began if action is self.reading.action else view.t
        self.busy = action in _FULL
        self.placed = int(truth.by_human.sum())
        self.reading = ActionReading(view.t, action, 1.0, began)
        return self.reading


class OracleBelief:
    """The truth as a belief."""

    def __init__(self, witness: Witness) -> None:
        self._witness = witness

    @property
    def value(self) -> float:
        person = self._witness.at(np.inf).person if self._witness.known else None
        return float(person is not None and person.fatigued)

    def observe(self, action: Action) -> float:
        del action
        return self.value


class TrueCompanion(Companion):
    """`Companion` whose frames carry no pixels and whose separation is the true one."""

    def __init__(
        self, config: CellConfig, witness: Witness, belief: Belief, collision: CollisionModel
    ) -> None:
        super().__init__(config, TrueEye(witness), belief, collision, TrueActions(config, witness))
        self._witness, self._count = witness, 0

    def update(self, inputs: Inputs, held_radius: float, onions: Array) -> None:
        if self._witness.known:
            exposed = np.floor((inputs.t - LATENCY) * RATE + 1e-9)
            if exposed > self._count:
                self._count = int(exposed)
                frame = Frame("person", self._count, self._count / RATE, *_EMPTY)
                inputs = replace(inputs, frames=(*inputs.frames, frame))
        super().update(inputs, held_radius, onions)

    def sensed(self, t: float) -> Sensed:
        seen = super().sensed(t)
        if not self._witness.known or seen.problem:
            return seen
        person = self._witness.at(t).person
        assert person is not None
        return replace(seen, separation=person.separation)


def _arm_points(p_WH: Array) -> Array:
    """Points round a hand and its forearm, which leads back to the person: (M, 3) [m]."""
    back = np.array([0.30, 0.0, 0.08])
    middle = p_WH + np.linspace(0.0, 1.0, 7)[:, None] * back
    out: Array = (middle[:, None, :] + _RADII[None]).reshape(-1, 3)
    return out
