"""All that the supervisor knows of the person: points, signs, action, belief, and how near they are."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cell.config import CellConfig
from cell.decision.belief import Belief
from cell.decision.io import Inputs
from cell.decision.modes import Sensed
from cell.frames import Array
from cell.motion.collision import CollisionModel
from cell.motion.past import state_at
from cell.perception.hands.gesture import Gesture
from cell.perception.human_action import HumanActions
from cell.perception.person import PersonView
from cell.wire.types import Frame, Hands
from cell.wire.vocabulary import Action

_REMEMBERED = 1.0
"""Joint states are kept this long to look up those of an exposure [s]."""
_EVENTS = 1.0
"""An action that lasts is observed again after so long [s]: the domain's mean time between events."""
_NEAR = 400
"""So many of the person's points, the nearest to the arm, are looked at for the way ahead."""
_BACKING = 0.005
"""A motion that takes the arm away from the person by this much is never in the way [m]."""
_OVER_BELT = 0.30


@dataclass(frozen=True)
class _Then:
    t: float
    q: Array
    width: float
    held: float


class Eye(Protocol):
    """What is needed of `cell.perception.person.PersonEye`."""

    def look(self, frame: Frame, arm: Array, onions: Array, full: Array | None = None) -> PersonView: ...


class Companion:
    """The person beside the robot.

    Args:
        eye: the person camera. belief: fed with what is observed. collision: the arm's spheres.
        actions: the person's action by what the eye sees; made if None.
    """

    def __init__(
        self,
        config: CellConfig,
        eye: Eye,
        belief: Belief,
        collision: CollisionModel,
        actions: HumanActions | None = None,
    ) -> None:
        self._config, self._eye, self._belief, self._collision = config, eye, belief, collision
        self._actions = actions or HumanActions(config)
        self._past: deque[_Then] = deque()
        self._view: PersonView | None = None
        self._ahead: PersonView | None = None
        self._fed: Action | None = None
        self._fed_at = 0.0
        self._fresh = False
        self.news: list[str] = []
        self.hands: list[Hands] = []

    # -- taking in -------------------------------------------------------------------------------------

    def look(self, frames: Iterable[Frame], onions: Array) -> None:
        """Look at the first of these frames ahead of the tick that will bring it.

        In real time looking takes longer than deciding: what is read of the arm after it is fresh
        when a motion is changed. The tick comes to the same with or without it.
        """
        frame = next((f for f in frames if self._is_news(f)), None)
        if frame is not None and self._past and frame.t <= self._past[-1].t:
            self._ahead = self._look(frame, onions)

    def update(self, inputs: Inputs, held_radius: float, onions: Array) -> None:
        """One tick: the arm's state, and any frame of the person camera."""
        width = round(inputs.gripper.width, 2)  # a few widths, so that the spheres are made once
        now = _Then(inputs.t, inputs.joints.q, width, held_radius)
        self._past.append(now)
        while self._past[0].t < inputs.t - _REMEMBERED:
            self._past.popleft()
        self._fresh = False
        for frame in inputs.frames:
            if not self._is_news(frame):
                continue
            before = Gesture.NONE if self._view is None else self._view.sign
            ahead, self._ahead = self._ahead, None
            if ahead is None or ahead.t != frame.t:
                ahead = self._look(frame, onions)
            self._view = view = ahead
            self._fresh = True
            self.hands.append(view.hands)
            self._observe()
            if view.sign is not before and view.sign is not Gesture.NONE:
                self.news.append(f"the person shows thumbs {view.sign.value}")

    def _is_news(self, frame: Frame) -> bool:
        return frame.camera == "person" and (self._view is None or frame.t > self._view.t)

    def _look(self, frame: Frame, onions: Array) -> PersonView:
        """A frame, beside the arm as it was at the exposure."""
        return self._eye.look(frame, self._arm(state_at(self._past, frame.t)), onions, self._actions.full)

    def _observe(self) -> None:
        """Feed the belief when the person's action has changed, and as often as events come in the domain."""
        assert self._view is not None
        reading = self._actions.update(self._view)
        if reading.confidence <= 0.0:
            return
        if reading.action is not self._fed or reading.t - self._fed_at >= _EVENTS:
            self._feed(reading.action, reading.t)

    def robot_decided(self, t: float) -> None:
        """An action of the robot ended at t [s]: in the domain people are observed at such events."""
        if self._fed is not None:
            self._feed(self._fed, t)

    def _feed(self, action: Action, t: float) -> None:
        self._fed, self._fed_at = action, t
        self._belief.observe(action)

    # -- what is known ---------------------------------------------------------------------------------

    @property
    def belief(self) -> float:
        """P(the person is fatigued)."""
        return self._belief.value

    @property
    def action(self) -> tuple[Action, float]:
        """What the person does, and how surely."""
        reading = self._actions.reading
        return reading.action, reading.confidence

    @property
    def sign(self) -> str:
        return "" if self._view is None else self._view.sign.value

    @property
    def placed(self) -> int:
        """Onions that the person was seen to sort."""
        return self._actions.placed

    @property
    def busy(self) -> bool:
        """The person seems to hold an onion."""
        return self._actions.busy

    def sensed(self, t: float) -> Sensed:
        """The separation from the arm as it is now."""
        if self._view is None:
            return Sensed(float("inf"), float("inf"), "no frame of the person camera has come", fresh=False)
        distance, _ = self._view.cloud.distance(self._arm(self._past[-1]))
        sign_up = self._fresh and self._view.glimpse is Gesture.UP
        return Sensed(distance, t - self._view.t, self._view.problem, sign_up, self._fresh)

    def near(self, p_W: Array, radius: float) -> bool:
        """Whether the person is nearer than `radius` [m] to a place (3,) on the belt, seen from above."""
        points = self._points()
        low = points[points[:, 2] < self._config.belt.top_z + _OVER_BELT]
        return bool(len(low)) and bool((np.linalg.norm(low[:, :2] - p_W[:2], axis=1) < radius).any())

    def over_window(self) -> bool:
        """Whether the person's hands are over the robot's part of the belt, where they may hide onions."""
        belt, points = self._config.belt, self._points()
        return bool((points[:, 0] < belt.pick_x[1] + 0.05).any())

    def in_the_way(self, q: Array, waiting: bool) -> bool:
        """Whether configurations (N, 6) [rad] come too near to the person; see `following.Obstructed`."""
        points = self._points()
        if not len(points):
            return False
        limit = self._config.separation.release if waiting else self._config.separation.hold
        now = self._past[-1]
        here = float(_clearance(points, self._arm(now)))
        p, r, _ = self._collision.spheres(q, width=now.width, held_radius=now.held)
        ahead = min(_clearance(points, np.column_stack([one, r])) for one in p)
        return bool(ahead < limit and ahead < here - _BACKING)

    # -- internals -------------------------------------------------------------------------------------

    def _points(self) -> Array:
        return np.zeros((0, 3)) if self._view is None else self._view.cloud.p_WP[:_NEAR]

    def _arm(self, then: _Then) -> Array:
        p, r, _ = self._collision.spheres(then.q[None], width=then.width, held_radius=then.held)
        return np.column_stack([p[0], r])


def _clearance(points: Array, spheres: Array) -> float:
    """Least distance [m] between points (N, 3) and spheres (S, 4)."""
    c = spheres[:, :3]
    squared = (points * points).sum(1)[:, None] + (c * c).sum(1) - 2.0 * (points @ c.T)
    return float((np.sqrt(np.maximum(squared, 0.0)) - spheres[:, 3]).min())
