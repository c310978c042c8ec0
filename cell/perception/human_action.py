"""What the person does, from where the working hand is and goes: one of the domain's nine actions.

The place of the hand says most: low over the belt it picks or puts down, at the bin it drops,
raised before the body with an onion it inspects, empty it looks. Where it is on its way, the
direction decides. Whether it holds something follows from what it did before, as for somebody who
watches. Only a recognised sign is a thumb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.config import CellConfig
from cell.frames import Array
from cell.perception.hand_regions import Region
from cell.perception.hands.gesture import Gesture
from cell.perception.person import PersonView
from cell.wire.vocabulary import Action

_LOW = 0.13
"""A hand lower than this over the belt works on it [m]."""
_BIN_MARGIN, _BIN_HEIGHT = 0.04, 0.25
"""A hand so near to the bin's opening and so low over it drops something [m]."""
_AWAY = 0.28
"""A trunk this far behind the working place is away [m]."""
_MOVING = 0.15
"""Faster than this the hand is on its way [m/s]."""
_STILL, _LET_GO = 0.08, 1
"""A hand slower than this [m/s] in so many frames has let go of what it put down."""
_RESTS, _BEFORE_EYES = 2, 0.28
"""A hand that rests for so many frames, so high over the belt [m], looks at an onion."""
_LAST_GLIMPSE = 0.15
"""A sign is over when it was not seen for so long [s]."""
_HEAD = 0.47
"""What is so high over the belt is no working hand, but the head of somebody who bends over it [m]."""
_GRASPS = 0.2
"""A hand that was never slower than this at the belt took nothing [m/s]."""
_OTHER_SIDE = 0.08
"""A raised empty hand this far on the other side than the one that works makes a sign, or just did [m]."""
_OVER_BELT, _EDGE, _SETS_OUT = 0.085, 0.03, 0.10
"""An empty hand this far over the belt [m] reaches for something, and so does one nearer to the edge
that moves inwards this fast [m/s]."""
_HIPS = 0.0
"""A hand lower than this beside the belt hangs [m]."""
_HANGING_FOR = 0.6
"""Hands that hang for so long hold nothing [s]."""
_LEAVES = 0.05
"""A hand that is so far from where it held an onion before the eyes takes it away [m]."""
_PLACING = 2.5
"""Putting an onion down takes at most so long [s]."""
_HOLDS = 9.0
"""An onion is held at most so long [s]."""
_SAME_HAND = 0.30
"""A working hand this far from where it was a frame ago is the other one [m]."""
_SURE, _LIKELY, _GUESS = 0.95, 0.8, 0.6


@dataclass(frozen=True)
class ActionReading:
    """The action at time t [s], with confidence 0..1; `began` is when it was first seen [s]."""

    t: float
    action: Action
    confidence: float
    began: float


class HumanActions:
    """The person's action over time; one instance per round.

    Attributes:
        busy: the person holds an onion, as far as one can tell. placed: onions seen sorted.
    """

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self.busy = False
        self.placed = 0
        self.reading = ActionReading(0.0, Action.NO_OP, 0.0, 0.0)
        self._was_low = self._left = self._was_at_bin = False
        self._rests = 0
        self._t = self._took = 0.0
        self._glimpsed, self._slowest = -1.0, np.inf
        self._side = 0.0
        self._hanging_since: float | None = None
        self._last: tuple[float, Array] | None = None
        self._eyes = self._carrier = np.zeros(3)

    @property
    def full(self) -> Array | None:
        """Where the hand was last seen that holds an onion (3,) [m]; None when there is none."""
        return self._carrier if self.busy else None

    def update(self, view: PersonView) -> ActionReading:
        """Take in a frame's view."""
        self._t = view.t
        action, confidence = self._judge(view)
        began = self.reading.began if action is self.reading.action else view.t
        self.reading = ActionReading(view.t, action, confidence, began)
        return self.reading

    def _judge(self, view: PersonView) -> tuple[Action, float]:
        if self.busy and view.t - self._took > _HOLDS:
            self.busy = False  # nobody looks at an onion for so long: its end was not seen
        if view.problem:
            return Action.NO_OP, 0.0
        if view.glimpse is not Gesture.NONE and view.glimpse is view.sign:
            self._glimpsed = view.t
        if view.sign is not Gesture.NONE and view.t - self._glimpsed < _LAST_GLIMPSE:
            self.busy = self._was_low = False
            return (Action.SPEED_UP if view.sign is Gesture.UP else Action.SLOW_DOWN), _SURE
        if self._away(view):
            self.busy, self._was_low, self._last = False, False, None
            return Action.NO_OP, _SURE
        hand = self._working_hand(view)
        if hand is None or self._hangs(hand.p_W):
            return self._resting(view.t)
        self._hanging_since = None
        self._carrier = hand.p_W
        velocity = self._velocity(view.t, hand.p_W)
        action, confidence = self._by_place(hand.p_W, velocity)
        aside = float(hand.p_W[1] - self._config.person.station[1])
        if action in (Action.PICK, Action.INSPECT) and self.busy:
            self._side = float(np.sign(aside))
        if action is Action.DETECT and self._raised_as_for_a_sign(hand.p_W, aside):
            return Action.NO_OP, _LIKELY
        return action, confidence

    def _raised_as_for_a_sign(self, p: Array, aside: float) -> bool:
        """Whether an empty hand (3,) [m] is the other one, held up; `aside`: how far to one side it is."""
        height = self._config.belt.top_z + self._config.gestures.height
        up = p[2] > height and p[0] > self._config.belt.x[1] - _OVER_BELT
        return bool(up and aside * self._side < -_OTHER_SIDE)

    def _by_place(self, p: Array, v: Array) -> tuple[Action, float]:
        belt, strip = self._config.belt, self._config.person.sorted_x
        speed = float(np.linalg.norm(v))
        self._rests = self._rests + 1 if speed < _STILL else 0
        came, self._was_at_bin = self._was_at_bin, self._at_bin(p)
        if came and not self._was_at_bin and self.reading.action is Action.PLACE_IN_BIN:
            self._put_down()
        if self._was_at_bin:
            if self.busy and self._rests >= _LET_GO:
                self._put_down()
            return (Action.PLACE_IN_BIN, _SURE) if self.busy else self._empty()
        if p[0] < belt.x[1] + 0.02 and p[2] < belt.top_z + _LOW:
            return self._low(p, v, strip[0])
        if self._was_low:  # the hand has come up again
            self._was_low = False
            if self.reading.action is Action.PLACE_ON_CONVEYOR:
                self._put_down()
                self._left = True
            elif self.reading.action is Action.PICK and self._slowest < _GRASPS:
                self.busy, self._took = True, self._t
        return self._raised(p, v, speed)

    def _low(self, p: Array, v: Array, strip: float) -> tuple[Action, float]:
        """The hand is at the belt: it takes or puts down."""
        speed = float(np.linalg.norm(v))
        self._slowest = min(self._slowest, speed) if self._was_low else speed
        self._was_low = True
        before = self.reading.action
        if before is Action.PLACE_ON_CONVEYOR or (self.busy and p[0] > strip - 0.07):
            if self.busy and self._rests >= _LET_GO:
                self._put_down()
                self._left = True
            return (Action.PLACE_ON_CONVEYOR, _LIKELY) if self.busy else self._empty()
        if self._left:  # on its way up from what it put down
            return self._empty()
        return Action.PICK, _LIKELY

    def _raised(self, p: Array, v: Array, speed: float) -> tuple[Action, float]:
        """The hand is in the air before the body."""
        before, edge = self.reading.action, self._config.belt.x[1]
        if not self.busy:
            over = p[0] < edge - _OVER_BELT
            self._left = self._left and over
            reaching = over or (p[0] < edge - _EDGE and v[0] < -_SETS_OUT)
            return (Action.PICK, _GUESS) if reaching and not self._left else self._empty()
        if before in (Action.PLACE_IN_BIN, Action.PLACE_ON_CONVEYOR):
            if self._rests >= _RESTS:
                if p[2] > self._config.belt.top_z + _BEFORE_EYES:
                    self._eyes = p
                    return Action.INSPECT, _GUESS
                self._put_down()  # it must have happened unseen
                return self._empty()
            if self._t - self.reading.began < _PLACING:
                return before, _GUESS
            self._put_down()  # it must have happened unseen
            return self._empty()
        if before is Action.INSPECT:
            return self._inspecting(p, v)
        if before is Action.PICK and speed > _MOVING:
            return Action.PICK, _GUESS
        self._eyes = p
        return Action.INSPECT, _LIKELY

    def _inspecting(self, p: Array, v: Array) -> tuple[Action, float]:
        """An onion is looked at until the hand leaves the place before the eyes."""
        gone = p - self._eyes
        to_bin = np.array(self._config.person.bin.center[:2]) - self._eyes[:2]
        along = float(gone[:2] @ to_bin) / max(float(np.linalg.norm(to_bin)), 1e-6)
        if along > _LEAVES and float(v[:2] @ to_bin) > 0.0:
            return Action.PLACE_IN_BIN, _GUESS
        if gone[2] < -_LEAVES / 2 and v[2] < -_MOVING:
            return Action.PLACE_ON_CONVEYOR, _GUESS
        self._eyes = self._eyes + 0.3 * gone
        return Action.INSPECT, _LIKELY

    def _resting(self, t: float) -> tuple[Action, float]:
        """The hands hang, or are not to be seen."""
        self._hanging_since = t if self._hanging_since is None else self._hanging_since
        self._last = None
        if t - self._hanging_since > _HANGING_FOR:
            if self._was_low and self.reading.action is Action.PLACE_ON_CONVEYOR:
                self._put_down()
            self.busy = self._was_low = False
        if self.busy:
            return self.reading.action, _GUESS
        return self._empty()

    def _empty(self) -> tuple[Action, float]:
        """An empty hand at the belt that reaches for nothing: its owner looks for an onion."""
        return Action.DETECT, _LIKELY

    def _put_down(self) -> None:
        if self.busy:
            self.placed += 1
        self.busy = self._was_low = False

    def _at_bin(self, p: Array) -> bool:
        b = self._config.person.bin
        inside = np.all(np.abs(p[:2] - b.center[:2]) < np.array(b.size[:2]) / 2 + _BIN_MARGIN)
        return bool(inside and p[2] < b.center[2] + _BIN_HEIGHT)

    def _hangs(self, p: Array) -> bool:
        return bool(p[0] > self._config.belt.x[1] + 0.12 and p[2] < _HIPS + 0.1 and not self._at_bin(p))

    def _away(self, view: PersonView) -> bool:
        p = view.cloud.p_WP
        if len(p) < 30:
            return True
        return bool(np.median(p[:, 0]) > self._config.person.station[0] + _AWAY)

    def _working_hand(self, view: PersonView) -> Region | None:
        """The end of the arm that reaches farthest towards the robot, or a hand at the bin."""
        ceiling = self._config.belt.top_z + _HEAD
        regions = [r for r in view.regions if r.p_W[2] < ceiling]
        if not regions:
            return None
        if self.busy:  # that which holds the onion, whatever the other one does
            nearest = min(regions, key=lambda r: float(np.linalg.norm(r.p_W - self._carrier)))
            same = np.linalg.norm(nearest.p_W - self._carrier) < _SAME_HAND
            return nearest if same else None
        foremost = min(regions, key=lambda r: float(r.p_W[0]))
        if foremost.p_W[0] > self._config.belt.x[1] - _OVER_BELT / 2:
            for region in regions:
                if self._at_bin(region.p_W):
                    return region
        return foremost

    def _velocity(self, t: float, p: Array) -> Array:
        """Of the working hand [m/s] (3,); zero when it was not seen just before."""
        last, self._last = self._last, (t, p)
        if last is None or not 0.0 < t - last[0] < 0.35 or np.linalg.norm(p - last[1]) > _SAME_HAND:
            return np.zeros(3)
        out: Array = (p - last[1]) / (t - last[0])
        return out
