"""What the person does, from hands that move as people's do: one scene after the other."""

from __future__ import annotations

import numpy as np
import pytest

from cell.config import load
from cell.frames import Array
from cell.perception.hand_regions import Region
from cell.perception.hands.gesture import Gesture
from cell.perception.human_action import HumanActions
from cell.perception.person import PersonView
from cell.perception.separation import Cloud
from cell.wire.types import Hands
from cell.wire.vocabulary import Action

CONFIG = load()
READY, EYES = (0.57, 0.10, 0.08), (0.56, 0.05, 0.12)
ONION = (0.42, 0.05, CONFIG.belt.top_z + 0.04)
STRIP = (0.53, -0.05, CONFIG.belt.top_z + 0.04)
BIN = (CONFIG.person.bin.center[0], CONFIG.person.bin.center[1], CONFIG.person.bin.center[2] + 0.08)
HANGING = (0.85, -0.35, -0.12)
FRAME = 0.1


class Scene:
    """A person at the belt whose working hand goes from place to place, seen ten times a second."""

    def __init__(self) -> None:
        self.actions = HumanActions(CONFIG)
        self.t = 0.0
        self.at = np.array(READY)
        self.seen: list[Action] = []

    def view(
        self, hand: Array | None, sign: Gesture = Gesture.NONE, x: float = 0.85, problem: str = ""
    ) -> None:
        """One frame with the working hand somewhere and the trunk at `x` [m]."""
        self.t += FRAME
        body = np.tile([x, -0.05, 0.3], (200, 1))
        regions = [Region(np.array(HANGING), 40)]
        if hand is not None:
            regions.insert(0, Region(np.asarray(hand, float), 60))
        cloud = Cloud(self.t, body, np.full(200, self.t), 0.9)
        view = PersonView(self.t, cloud, tuple(regions), Hands(self.t, "person", ()), sign, sign, problem)
        self.seen.append(self.actions.update(view).action)

    def go(self, place: tuple[float, float, float], speed: float = 0.6) -> Scene:
        """Move the hand there in a straight line."""
        start, end = self.at, np.array(place)
        steps = max(1, int(np.linalg.norm(end - start) / (speed * FRAME)))
        for k in range(1, steps + 1):
            self.view(start + (end - start) * k / steps)
        self.at = end
        return self

    def stay(self, seconds: float) -> Scene:
        for _ in range(round(seconds / FRAME)):
            self.view(self.at)
        return self

    def order(self) -> list[Action]:
        """The actions seen, each once in a row."""
        return [a for a, b in zip(self.seen, [None, *self.seen], strict=False) if a is not b]


def picked() -> Scene:
    scene = Scene().stay(0.6).go(ONION).stay(0.4)
    return scene.go((0.50, 0.08, 0.05)).go(EYES).stay(1.5)


def test_a_blemished_onion_goes_into_the_bin() -> None:
    scene = picked().go((0.66, 0.25, 0.10)).go(BIN).stay(0.5).go(READY).stay(0.5)
    assert scene.order() == [
        Action.DETECT, Action.PICK, Action.INSPECT, Action.PLACE_IN_BIN, Action.DETECT
    ]  # fmt: skip
    assert scene.actions.placed == 1 and not scene.actions.busy


def test_a_sound_onion_goes_onto_the_strip() -> None:
    scene = picked().go((0.55, 0.0, 0.02)).go(STRIP, 0.4).stay(0.5).go((0.54, 0.0, 0.02)).go(READY).stay(0.4)
    assert scene.order() == [
        Action.DETECT, Action.PICK, Action.INSPECT, Action.PLACE_ON_CONVEYOR, Action.DETECT
    ]  # fmt: skip
    assert scene.actions.placed == 1 and not scene.actions.busy


def test_a_hand_with_an_onion_is_known_as_full() -> None:
    scene = picked()
    full = scene.actions.full
    assert full is not None and np.linalg.norm(full - EYES) < 0.05
    assert Scene().stay(0.5).actions.full is None


@pytest.mark.parametrize(
    ("sign", "action"), [(Gesture.UP, Action.SPEED_UP), (Gesture.DOWN, Action.SLOW_DOWN)]
)
def test_only_a_recognised_sign_is_a_thumb(sign: Gesture, action: Action) -> None:
    scene = Scene().stay(0.5)
    scene.view(np.array([0.6, -0.37, 0.2]), sign)
    assert scene.seen[-1] is action and scene.actions.reading.confidence > 0.9
    scene.view(np.array([0.6, -0.37, 0.2]))
    assert scene.seen[-1] is not action


def test_somebody_who_stands_back_or_is_gone_does_nothing() -> None:
    scene = Scene().stay(0.5)
    scene.view(None, x=1.9)
    assert scene.seen[-1] is Action.NO_OP
    assert scene.actions.reading.confidence > 0.9


def test_a_blocked_camera_says_nothing() -> None:
    scene = Scene().stay(0.5)
    scene.view(None, problem="the person camera is blocked")
    assert scene.actions.reading.confidence == 0.0


def test_an_onion_is_not_held_for_ever() -> None:
    """Its end was not seen: the round must not wait for it."""
    scene = picked().stay(12.0)
    assert not scene.actions.busy


def test_hands_that_hang_hold_nothing() -> None:
    scene = picked()
    for _ in range(12):
        scene.view(None)
    assert not scene.actions.busy
