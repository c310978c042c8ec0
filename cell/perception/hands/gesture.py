"""Thumbs up and thumbs down from the landmarks of one hand.

A sign is a closed hand whose thumb is straight, away from the fingers, points up or down in the
image, and is the hand's extreme in that direction. Whatever is not clearly one of the two is
none of them: a sign is never guessed. The camera must be upright (image up = world up).
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


class Gesture(Enum):
    """What a hand says."""

    NONE = ""
    UP = "up"
    DOWN = "down"


@dataclass(frozen=True)
class GestureRule:
    """Thresholds of `classify`.

    Attributes:
        curl: largest mean ratio of the distances wrist-fingertip and wrist-knuckle.
        thumb_away: least distance of the thumb's tip from index and middle finger, in lengths
            from the wrist to the middle knuckle.
        thumb_bend: largest angle between the thumb's last two bones [rad].
        tilt: largest angle between the thumb and image up (or down) [rad].
        margin_up, margin_down: by how much the thumb's tip must be above (below) all of the
            rest of the hand, in palm sizes.
    """

    curl: float = 1.4
    thumb_away: float = 0.4
    thumb_bend: float = np.deg2rad(60.0)
    tilt: float = np.deg2rad(50.0)
    margin_up: float = 0.1
    margin_down: float = 0.1


@dataclass(frozen=True)
class Features:
    """What `classify` looks at; see `GestureRule`.

    Attributes:
        curl, thumb_away, thumb_bend: of the world landmarks.
        direction: of the thumb against image up, 0 = up, pi = down [rad].
        margin_up, margin_down: of the thumb's tip, in palm sizes; negative inside the hand.
    """

    curl: float
    thumb_away: float
    thumb_bend: float
    direction: float
    margin_up: float
    margin_down: float


@dataclass(frozen=True)
class Reading:
    """What one image of a hand says.

    Attributes:
        gesture: the sign, or NONE. features: behind it.
        score: by how much the tightest threshold is kept, 0..1; 0 for NONE.
    """

    gesture: Gesture
    features: Features
    score: float


def measure(landmarks: Array, world: Array) -> Features:
    """Features of landmarks (21, 2) [px] and world landmarks (21, 3) [m]."""
    wrist = world[0]
    tips = np.linalg.norm(world[_TIPS] - wrist, axis=1)
    knuckles = np.linalg.norm(world[_KNUCKLES] - wrist, axis=1)
    away = np.linalg.norm(world[_NEIGHBOURS] - world[4], axis=1).min()
    thumb = landmarks[4] - landmarks[2]
    length = np.linalg.norm(landmarks[9] - landmarks[0]) + np.linalg.norm(landmarks[5] - landmarks[17])
    palm = max(float(length), 1e-6)
    rest = landmarks[_REST, 1]
    return Features(
        curl=float((tips / np.maximum(knuckles, 1e-6)).mean()),
        thumb_away=float(away / max(float(knuckles[1]), 1e-6)),
        thumb_bend=_angle(world[3] - world[2], world[4] - world[3]),
        direction=_angle(thumb, np.array([0.0, -1.0])),
        margin_up=float(rest.min() - landmarks[4, 1]) / palm,
        margin_down=float(landmarks[4, 1] - rest.max()) / palm,
    )


def classify(hand: Hand, rule: GestureRule | None = None) -> Reading:
    """The sign that `hand` shows in this one image.

    Args:
        hand: with landmarks in an upright image.
        rule: thresholds; those fitted to the networks if None.
    """
    rule = rule or GestureRule()
    f = measure(hand.landmarks, hand.world)
    up = f.direction < np.pi / 2
    direction = f.direction if up else np.pi - f.direction
    margin, least = (f.margin_up, rule.margin_up) if up else (f.margin_down, rule.margin_down)
    slack = min(
        (rule.curl - f.curl) / rule.curl,
        (f.thumb_away - rule.thumb_away) / rule.thumb_away,
        (rule.thumb_bend - f.thumb_bend) / rule.thumb_bend,
        (rule.tilt - direction) / rule.tilt,
        (margin - least) / 0.3,
    )
    if not slack > 0.0:  # also when a landmark is not finite
        return Reading(Gesture.NONE, f, 0.0)
    return Reading(Gesture.UP if up else Gesture.DOWN, f, min(1.0, slack))


def _angle(a: Array, b: Array) -> float:
    """Angle between two vectors [rad]; pi / 2 for a vector without length."""
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.arccos(np.clip(a @ b / length, -1.0, 1.0))) if length > 1e-12 else np.pi / 2
