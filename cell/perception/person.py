"""From one frame of the person camera to what the supervisor wants to know of the person."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cell.config import CellConfig
from cell.frames import Array
from cell.perception.hand_regions import Region, hand_regions
from cell.perception.hands.depth import isolate, locate_palm
from cell.perception.hands.gesture import Gesture, classify
from cell.perception.hands.landmarks import Hand
from cell.perception.hands.roi import Roi
from cell.perception.hands.tracker import HandTracker
from cell.perception.hands.vote import GestureVote, VoteConfig
from cell.perception.separation import Cloud, Separation
from cell.wire.types import Frame, Hands, SeenHand

_STILL = 0.45
"""A hand that moves faster than this makes no sign [m/s]."""
_PATIENT = 6
"""After so many frames without a hand the networks look at every other one only."""
_OTHER_HAND = 0.22
"""A region this far from a hand that holds something is the other hand [m]."""
_SAME_HAND = 0.15
"""A region this far from the last frame's may be the same hand [m]."""


class HandFinder(Protocol):
    """What is needed of `cell.perception.hands.tracker.HandTracker`."""

    def update(self, rgb: NDArray[np.uint8], candidates: list[Roi]) -> tuple[Hand, ...]: ...

    def reset(self) -> None: ...


@dataclass(frozen=True)
class PersonView:
    """What one frame shows.

    Attributes:
        t: exposure [s]. cloud: the person's points. regions: ends of arms.
        hands: found by the networks. sign: that counts now, "" for none.
        glimpse: sign of this frame alone, however often it was seen.
        problem: why the frame is not to be trusted; empty when it is.
    """

    t: float
    cloud: Cloud
    regions: tuple[Region, ...]
    hands: Hands
    sign: Gesture
    glimpse: Gesture
    problem: str


class PersonEye:
    """The person camera's geometry with the hand networks.

    Args:
        config: the cell. finder: the hand networks; made from `config.gestures` if None.
    """

    def __init__(self, config: CellConfig, finder: HandFinder | None = None) -> None:
        g = config.gestures
        self._config = config
        self._separation = Separation(config)
        self._finder = finder or HandTracker(Path(g.models) if g.models else None)
        self._vote = GestureVote(VoteConfig(votes=g.votes, window=g.window))
        self._last: tuple[float, tuple[Region, ...]] = (-1.0, ())
        self._idle = 0

    def look(self, frame: Frame, arm: Array, onions: Array, full: Array | None = None) -> PersonView:
        """Take in a frame.

        Args:
            frame, arm, onions: see `Separation.look`.
            full: where the hand is that holds an onion (3,) [m]: a thumb on an onion is no sign.
        """
        cloud = self._separation.look(frame, arm, onions)
        problem = self._problem(cloud)
        regions = () if problem else hand_regions(cloud.p_WP, self._config)
        raised = self._may_sign(frame.t, regions)
        if full is not None:
            raised = [r for r in raised if np.linalg.norm(r.p_W - full) > _OTHER_HAND]
        hands, glimpse = self._signs(frame, raised)
        sign = self._vote.push(frame.t, glimpse, allowed=bool(raised))
        self._last = (frame.t, regions)
        return PersonView(frame.t, cloud, regions, hands, sign, glimpse, problem)

    def _problem(self, cloud: Cloud) -> str:
        if cloud.share < self._config.separation.least_seen:
            return f"the person camera is blocked: {100 * cloud.share:.0f} % of its pixels have depth"
        return ""

    def _may_sign(self, t: float, regions: tuple[Region, ...]) -> list[Region]:
        """Regions high enough over the belt, and still since the last frame."""
        least = self._config.belt.top_z + self._config.gestures.height
        then, before = self._last
        out = []
        for region in regions:
            if region.p_W[2] < least:
                continue
            moved = min((float(np.linalg.norm(region.p_W - r.p_W)) for r in before), default=np.inf)
            if moved < _SAME_HAND and moved <= _STILL * max(t - then, 1e-3):
                out.append(region)
        return out

    def _signs(self, frame: Frame, raised: list[Region]) -> tuple[Hands, Gesture]:
        """The hands in the raised regions, and the one sign they show, if it is only one."""
        if not raised:
            self._finder.reset()
            self._idle = 0
        # Where no hand was found lately, every other frame will do.
        if not raised or (self._idle >= _PATIENT and self._idle % 2):
            self._idle += bool(raised)
            return Hands(frame.t, frame.camera, ()), Gesture.NONE
        scene = self._separation.scene
        self._idle += 1
        rois = [self._roi(r) for r in raised]
        away = [self._distance(r) for r in raised]
        found = self._finder.update(isolate(frame.rgb, frame.depth, away, scene.pinhole.fx), rois)
        if found:
            self._idle = 0
        hands, signs = [], set()
        for hand in found:
            middle = hand.landmarks.mean(axis=0)
            nearest = min(range(len(rois)), key=lambda i: np.hypot(*(middle - (rois[i].u, rois[i].v))))
            palm = locate_palm(hand, frame.depth, scene.pinhole, away[nearest])
            if palm is None or not palm.plausible:
                continue
            p_WH = scene.X_WC[:3, :3] @ palm.p_CP + scene.p_WC
            reading = classify(hand, up_C=scene.X_WC[2, :3])
            if reading.gesture is not Gesture.NONE and self._in_zone(p_WH):
                signs.add(reading.gesture)
            x, y, z = (float(v) for v in p_WH)
            side = "right" if hand.p_right > 0.5 else "left"
            hands.append(SeenHand(side, hand.presence, reading.gesture.value, (x, y, z), hand.landmarks))
        return Hands(frame.t, frame.camera, tuple(hands)), signs.pop() if len(signs) == 1 else Gesture.NONE

    def _in_zone(self, p_WH: Array) -> bool:
        return bool(p_WH[2] >= self._config.belt.top_z + self._config.gestures.height)

    def _distance(self, region: Region) -> float:
        """Of a region along the optical axis [m]."""
        scene = self._separation.scene
        return float(scene.X_WC[:3, 2] @ (region.p_W - scene.p_WC))

    def _roi(self, region: Region) -> Roi:
        """The square of the image round a region."""
        scene = self._separation.scene
        p_C = scene.X_WC[:3, :3].T @ (region.p_W - scene.p_WC)
        u, v = scene.pinhole.project(p_C)
        side = self._config.gestures.crop * scene.pinhole.fx / float(p_C[2])
        return Roi(float(u), float(v), float(side))
