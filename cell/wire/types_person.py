"""Messages about the person, and the simulation's ground truth; see `cell.wire.types`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SeenHand:
    """One hand in a camera image.

    Attributes:
        side: "left", "right" or "" (not known): whose hand it is, of the person.
        presence: of the landmark network, 0..1. gesture: "", "up" or "down", of this frame alone.
        p_WH: palm centre in the world (3,) [m]; NaN never: a hand without depth is not reported.
        landmarks: (21, 2) [px] in MediaPipe's order.
    """

    side: str
    presence: float
    gesture: str
    p_WH: tuple[float, float, float]
    landmarks: Array


@dataclass(frozen=True)
class Hands:
    """The hands found in the frame of camera `camera` taken at `t` [s]."""

    t: float
    camera: str
    hands: tuple[SeenHand, ...]


@dataclass(frozen=True)
class TruthRequest:
    """Simulation: ask for the ground truth used to judge a round, never to decide."""

    holder: str


@dataclass(frozen=True)
class ShownGesture:
    """A sign that the simulated person held up.

    Attributes:
        sign: "up" or "down". shown: when the hand was in place [s]. answered: when the person saw
            that the robot had understood [s]; negative as long as it has not.
    """

    sign: str
    shown: float
    answered: float


@dataclass(frozen=True)
class PersonTruth:
    """What the simulated person really is and does; never for deciding.

    Attributes:
        name: persona. fatigued: true type. action: an `Action`. gesture: "", "up" or "down".
        separation: nearest point of the body to robot, gripper and held onion [m].
        p_WH: (2, 3) [m] grip points of the left and the right hand.
        contacts: control ticks in which the robot touched the person.
        gestures: all signs so far.
    """

    name: str
    fatigued: bool
    action: int
    gesture: str
    separation: float
    p_WH: Array
    contacts: int
    gestures: tuple[ShownGesture, ...] = ()


@dataclass(frozen=True)
class Truth:
    """Ground truth of the simulated round.

    Attributes:
        blemished: shape (N,) bool, per onion.
        place: tuple of N words: "belt", "bin", "held" or "floor".
        p_WO: shape (N, 3) [m], onion centres.
        radius: shape (N,) [m], largest half-width.
        arm_contacts: number of control ticks with forbidden contact of the arm.
        contact_log: first few such contacts, readable.
        by_human: shape (N,) bool: the simulated person sorted this onion.
        person: the simulated person, None where there is none.
    """

    t: float
    blemished: NDArray[np.bool_]
    place: tuple[str, ...]
    p_WO: Array
    radius: Array
    arm_contacts: int
    contact_log: tuple[str, ...] = field(default=())
    by_human: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    person: PersonTruth | None = None
