"""The onions as the robot perceives them: located from its detections, followed through its hand.

The wire carries boxes in the belt camera's images; this places them in the world as the supervisor
does. What is in the hand is drawn at the tool, and lies where it was let go until the next look.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.cameras import camera_pinhole, camera_pose
from cell.config import CellConfig
from cell.frames import Array
from cell.limits import tcp_positions
from cell.perception.localise import locate
from cell.view.moment import Moment
from cell.wire.types import Detections, Frame
from cell.wire.vocabulary import Prediction

_ON_BELT = 0.09
"""Centres lower than this over the belt lie on it [m]."""
_TAKEN = 0.05
"""An onion this near to the closing fingers is the one that they take [m]."""


@dataclass(frozen=True)
class Onion:
    """Centre (3,) [m], radius [m], and what is believed of it ("" where nothing is)."""

    p_WO: Array
    radius: float
    label: str


class Perceived:
    """Onions by what the wire tells."""

    def __init__(self, config: CellConfig) -> None:
        camera = config.cameras["belt"]
        self._pinhole = camera_pinhole(camera)
        self._X_WC = camera_pose(camera)
        self._top, self._length = config.belt.top_z, config.gripper.length
        self._on_belt: list[Onion] = []
        self._held: Onion | None = None
        self._looked = -1.0

    def update(self, moment: Moment) -> list[Onion]:
        """All onions at this moment, the held one last."""
        if moment.t < self._looked:
            self._on_belt, self._held, self._looked = [], None, -1.0
        if moment.detections is not None and moment.detections[0].t != self._looked:
            self._look(*moment.detections)
        self._hand(moment)
        return [*self._on_belt, *([] if self._held is None else [self._held])]

    def _look(self, detections: Detections, frame: Frame) -> None:
        self._looked = detections.t
        found = []
        for box in detections.boxes:
            located = locate(box, frame.depth, self._pinhole, self._X_WC)
            if located is not None and located.p_WO[2] < self._top + _ON_BELT:
                found.append(Onion(located.p_WO, located.radius, box.label))
        if found:  # a look at a held onion finds nothing on the belt
            self._on_belt = found

    def _hand(self, moment: Moment) -> None:
        gripper, joints = moment.gripper, moment.joints
        if gripper is None or joints is None:
            return
        p_WT = tcp_positions(joints.q[None], self._length)[0]
        if gripper.holding:
            if self._held is None:
                self._on_belt = [o for o in self._on_belt if np.linalg.norm(o.p_WO - p_WT) > _TAKEN]
            prediction = Prediction.UNKNOWN if moment.state is None else Prediction(moment.state.prediction)
            label = "" if prediction is Prediction.UNKNOWN else prediction.name.lower()
            self._held = Onion(p_WT, max(0.5 * gripper.width, 0.02), label)
        elif self._held is not None:
            if self._held.p_WO[2] < self._top + _ON_BELT:
                self._on_belt.append(self._held)
            self._held = None
