"""Thumbs up and thumbs down from the landmarks of one hand.

A sign is a closed hand whose thumb stands away from the fingers, points up or down, and is the
hand's extreme in that direction, with the row of knuckles standing upright too. How well each of
these holds adds up to one score (logistic regression). Whatever is not clearly one of the two
signs is none of them: a sign is never guessed.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from cell.frames import Array
from cell.perception.hands.landmarks import Hand

_TIPS, _KNUCKLES = [8, 12, 16, 20], [5, 9, 13, 17]
_THUMB = [2, 3, 4]
_REST = [i for i in range(21) if i not in _THUMB]
_NEIGHBOURS = [5, 6, 10]
"""Landmarks on which the thumb rests in a fist: index MCP and PIP, middle PIP."""
_FAR = 1.2
_MARGINS = (-0.5, 0.6)
"""Beyond these values a feature says no more."""
LEVEL: Array = np.array([0.0, -1.0, 0.0])
"""World up in the frame of a level camera."""


class Gesture(Enum):
    """What a hand says."""

    NONE = ""
    UP = "up"
    DOWN = "down"


@dataclass(frozen=True)
class GestureRule:
    """Weights of `classify`, fitted by `tools/fit_gestures`, and limits that nothing makes up for.

    The score is 1 / (1 + exp(-x)), x = bias + sum of weight times feature; see `Features`.

    Attributes:
        bias, curl, thumb_away, tilt, knuckles, margin: the weights.
        threshold: least score of a sign.
        most_curl, most_tilt, most_knuckles, least_away, least_margin: limits of a sign's features.
            About 99 % of the images of signs keep each of them.
    """

    bias: float = 4.04
    curl: float = -3.30
    thumb_away: float = 2.56
    tilt: float = -1.26
    knuckles: float = -2.99
    margin: float = 3.03
    threshold: float = 0.5
    most_curl: float = 1.6
    most_tilt: float = np.deg2rad(60.0)
    most_knuckles: float = np.deg2rad(75.0)
    least_away: float = 0.3
    least_margin: float = 0.0


@dataclass(frozen=True)
class Features:
    """What `classify` looks at, for the sign that the thumb's direction suggests.

    Attributes:
        up: whether the thumb points up in the image, rather than down.
        curl: mean ratio of the distances wrist-fingertip and wrist-knuckle; small for a fist.
        thumb_away: least distance of the thumb's tip from index and middle finger, in lengths
            from the wrist to the middle knuckle; at most 1.2.
        tilt: of the thumb in the image, from the vertical [rad].
        knuckles: angle in space between the row of knuckles, little to index finger, and the
            sign's direction [rad]; large for a hand that lies flat. Across the line of sight it
            is measured in the image, which is more exact, and only along it in the world landmarks.
        margin: by how much the thumb's tip is beyond all of the rest of the hand, in palm sizes;
            between -0.5 and 0.6.
    """

    up: bool
    curl: float
    thumb_away: float
    tilt: float
    knuckles: float
    margin: float


@dataclass(frozen=True)
class Reading:
    """What one image of a hand says.

    Attributes:
        gesture: the sign, or NONE. features: behind it.
        score: that the hand shows the sign that `features.up` names, 0..1.
    """

    gesture: Gesture
    features: Features
    score: float


def measure(landmarks: Array, world: Array, up_C: Array) -> Features:
    """Features of landmarks (21, 2) [px] and world landmarks (21, 3) [m]; `up_C` as in `classify`."""
    wrist = world[0]
    tips = np.linalg.norm(world[_TIPS] - wrist, axis=1)
    knuckles = np.maximum(np.linalg.norm(world[_KNUCKLES] - wrist, axis=1), 1e-6)
    away = np.linalg.norm(world[_NEIGHBOURS] - world[4], axis=1).min() / knuckles[1]
    thumb = landmarks[4] - landmarks[2]
    up = bool(thumb[1] < 0.0)
    sign = 1.0 if up else -1.0
    length = np.linalg.norm(landmarks[9] - landmarks[0]) + np.linalg.norm(landmarks[5] - landmarks[17])
    height = -sign * landmarks[:, 1]
    row = world[5] - world[17]
    across = _spread(world[:, :2]) / max(_spread(landmarks), 1e-6)  # metres per pixel
    margin = (height[4] - height[_REST].max()) / max(float(length), 1e-6)
    return Features(
        up=up,
        curl=float((tips / knuckles).mean()),
        thumb_away=float(np.minimum(away, _FAR)),
        tilt=_angle(thumb, np.array([0.0, -sign])),
        knuckles=_angle(np.append(across * (landmarks[5] - landmarks[17]), row[2]), sign * up_C),
        margin=float(np.clip(margin, *_MARGINS)),
    )


def classify(hand: Hand, rule: GestureRule | None = None, up_C: Array | None = None) -> Reading:
    """The sign that `hand` shows in this one image.

    Args:
        hand: with landmarks in an upright image.
        rule: weights; those fitted to the networks if None.
        up_C: direction of world up in the camera frame (3,); that of a level camera if None.
    """
    rule = rule or GestureRule()
    f = measure(hand.landmarks, hand.world, LEVEL if up_C is None else up_C)
    x = rule.bias + rule.curl * f.curl + rule.thumb_away * f.thumb_away + rule.tilt * f.tilt
    x += rule.knuckles * f.knuckles + rule.margin * f.margin
    score = float(1.0 / (1.0 + np.exp(-np.clip(x, -50.0, 50.0))))
    # All written so that a landmark that is not finite makes no sign.
    closed = f.curl <= rule.most_curl
    upright = f.tilt <= rule.most_tilt and f.knuckles <= rule.most_knuckles
    apart = f.thumb_away >= rule.least_away and f.margin >= rule.least_margin
    shown = score >= rule.threshold and closed and upright and apart
    gesture = (Gesture.UP if f.up else Gesture.DOWN) if shown else Gesture.NONE
    return Reading(gesture, f, score)


def _spread(points: Array) -> float:
    """Root mean square distance of points (N, 2) from their middle."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _angle(a: Array, b: Array) -> float:
    """Angle between two vectors [rad]; pi / 2 for a vector without length."""
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.arccos(np.clip(a @ b / length, -1.0, 1.0))) if length > 1e-12 else np.pi / 2
