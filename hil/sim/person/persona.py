"""Five made-up people: how each looks, how fast each works, tires and gestures."""

from __future__ import annotations

from dataclasses import dataclass

from cell.errors import ConfigError, one_of
from hil.sim.person.texture import SKINS, Look

Range = tuple[float, float]

MAX_SIGNALS = 2
"""A person signals fatigue at most this often in a round, as in the published trials."""


@dataclass(frozen=True)
class Persona:
    """One person.

    Attributes:
        name: of the person. body: one of `body.body_names()`. look: colours and sleeve.
        hand: "right" or "left", the one that works; signs are always shown with the left.
        pace: factor on everything's duration, 1 is the reference.
        hand_speed: mean speed of the hand on its way [m/s].
        walk: walking speed [m/s].
        detect, inspect: seconds of looking over the belt, and of looking at an onion in the hand.
        tires_after: least and largest number of onions since the last rest after which fatigue comes.
        rest: length of a rest [s].
        reaction: from what the robot shows to doing something about it [s].
        patience: a sign is held this long when nothing happens [s].
        hold: a sign is held at least this long [s].
        wobble: of a hand that shows a sign [m]. wobble_turn: the same [rad].
        roll: standard deviation of the sign's slant [rad]. sloppiness: of the fingers [rad].
        mistakes: chance that an onion is not inspected, or judged wrongly.
    """

    name: str
    body: str
    look: Look
    hand: str = "right"
    pace: float = 1.0
    hand_speed: float = 0.55
    walk: float = 1.0
    detect: Range = (0.5, 0.9)
    inspect: Range = (1.6, 2.4)
    tires_after: tuple[int, int] = (2, 5)
    rest: Range = (16.0, 24.0)
    reaction: float = 0.45
    patience: float = 12.0
    hold: float = 1.2
    wobble: float = 0.005
    wobble_turn: float = 0.04
    roll: float = 0.08
    sloppiness: float = 0.04
    mistakes: float = 0.0


_ALL = (
    Persona("ana", "slim", Look(SKINS[1], hair=(88, 56, 34), shirt=(176, 64, 60), sleeve=0.40, seed=1)),
    Persona(
        "bo", "tall", Look(SKINS[5], hair=(28, 24, 22), shirt=(58, 92, 140), sleeve=0.97, seed=2),
        pace=1.15, hand_speed=0.50, walk=0.9, rest=(20.0, 30.0), reaction=0.6, hold=1.6,
        wobble=0.008, roll=0.12, mistakes=0.03,
    ),
    Persona(
        "chen", "lean", Look(SKINS[2], hair=(24, 22, 24), shirt=(70, 118, 84), sleeve=0.70, seed=3),
        pace=0.88, hand_speed=0.65, walk=1.2, rest=(15.0, 20.0), reaction=0.35, hold=1.0,
        wobble=0.004, roll=0.06, mistakes=0.02,
    ),
    Persona(
        "dana", "sturdy", Look(SKINS[0], hair=(150, 118, 74), shirt=(208, 190, 140), sleeve=0.12, seed=4),
        pace=1.05, rest=(18.0, 26.0), reaction=0.5, wobble=0.007, wobble_turn=0.06, sloppiness=0.06,
    ),
    Persona(
        "efe", "broad", Look(SKINS[4], hair=(36, 30, 28), shirt=(92, 70, 104), sleeve=0.45, seed=5),
        pace=1.25, hand_speed=0.48, walk=0.8, rest=(22.0, 30.0), reaction=0.7, hold=2.0,
        wobble=0.010, wobble_turn=0.08, roll=0.15, sloppiness=0.06, mistakes=0.06,
    ),
)  # fmt: skip

PERSONAS = {persona.name: persona for persona in _ALL}
"""Everybody, by name."""


def persona(name: str) -> Persona:
    """The person called `name`; raises `ConfigError` listing the names there are."""
    if name not in PERSONAS:
        raise ConfigError(f"person: {one_of(name, PERSONAS)}")
    return PERSONAS[name]
