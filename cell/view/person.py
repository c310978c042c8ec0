"""The person as the person camera sees them: coloured points, and the nearest of them to the arm."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.config import CellConfig
from cell.frames import Array
from cell.motion.collision import CollisionModel
from cell.motion.past import state_at
from cell.perception.separation import Separation
from cell.view.moment import Moment
from cell.view.onions import Onion

_MOST = 3000
"""Most points that are drawn."""
_REMEMBERED = 1.0
"""A frame arrives at most so long after its exposure [s]."""


@dataclass(frozen=True)
class Figure:
    """points (M, 3) [m], colours (M, 3) uint8, and the line between arm and person, (2, 3) [m] or None."""

    points: Array
    colours: NDArray[np.uint8]
    line: Array | None


@dataclass(frozen=True)
class _Then:
    """What a camera may see of the robot at t [s]: joints, width of the fingers, spheres (N, 4) of onions."""

    t: float
    q: Array
    width: float | None
    holding: bool
    onions: Array


class PersonFigure:
    """Makes figures from frames of the person camera, by the rules of the measured separation.

    A frame shows what was there at its exposure: arm and onions are remembered until it comes, or what
    has just moved away would be drawn as a person.
    """

    def __init__(self, config: CellConfig) -> None:
        self._separation = Separation(config)
        self._collision = CollisionModel(config)
        self._radius = 0.5 * config.onions.diameter[1]
        self._drawn = -1.0
        self._past: deque[_Then] = deque()

    def note(self, moment: Moment, onions: list[Onion]) -> None:
        """Remember where things are; frames of this moment come later."""
        joints, gripper = moment.joints, moment.gripper
        if joints is None or (self._past and joints.t == self._past[-1].t):
            return
        if self._past and not 0.0 < joints.t - self._past[-1].t < _REMEMBERED:  # another time of a recording
            self._past.clear()
        width = None if gripper is None else round(gripper.width, 2)
        known = np.array([[*o.p_WO, o.radius] for o in onions]).reshape(-1, 4)
        self._past.append(_Then(joints.t, joints.q, width, gripper is not None and gripper.holding, known))
        while self._past[0].t < joints.t - _REMEMBERED:
            self._past.popleft()

    def update(self, moment: Moment) -> Figure | None:
        """The figure of a new frame; None when there is none."""
        frame = moment.frames.get("person")
        if frame is None or not self._past or frame.t == self._drawn:
            return None
        self._drawn = frame.t
        then = state_at(self._past, frame.t)
        p, r, _ = self._collision.spheres(
            then.q[None], width=then.width, held_radius=self._radius if then.holding else 0.0
        )
        arm = np.column_stack([p[0], r])
        cloud = self._separation.look(frame, arm, then.onions)
        points = cloud.p_WP
        distance, nearest = cloud.distance(arm)
        line = None if not np.isfinite(distance) else np.stack([_surface(arm, nearest), nearest])
        if len(points) > _MOST:
            points = points[np.linspace(0, len(points) - 1, _MOST).astype(int)]
        return Figure(points, self._colours(points, frame.rgb), line)

    def _colours(self, points: Array, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        scene = self._separation.scene
        p_C = (points - scene.p_WC) @ scene.X_WC[:3, :3]
        uv = np.round(scene.pinhole.project(p_C)).astype(int) if len(points) else np.zeros((0, 2), int)
        height, width = rgb.shape[:2]
        found = rgb[np.clip(uv[:, 1], 0, height - 1), np.clip(uv[:, 0], 0, width - 1)]
        return np.asarray(found)


def _surface(spheres: Array, p: Array) -> Array:
    """The point (3,) of the spheres (S, 4) that is nearest to p (3,)."""
    away = p - spheres[:, :3]
    distance = np.linalg.norm(away, axis=1)
    i = int(np.argmin(distance - spheres[:, 3]))
    out: Array = spheres[i, :3] + away[i] * (spheres[i, 3] / max(float(distance[i]), 1e-9))
    return out
