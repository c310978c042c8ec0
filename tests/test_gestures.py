"""Signs: what counts as thumbs up or down, and for how long it must be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.perception.hands.gesture import Gesture, GestureRule, classify
from cell.perception.hands.landmarks import Hand
from cell.perception.hands.roi import Roi, rotation
from cell.perception.hands.vote import GestureVote, VoteConfig

NONE, UP, DOWN = Gesture.NONE, Gesture.UP, Gesture.DOWN


def thumbs_up() -> Hand:
    """A right fist seen from the thumb's side of the fingers, thumb up; metres and pixels."""
    points = [(0.0, 0.0, 0.0), (15, -30, 0), (40, -50, 0), (45, -80, 0), (45, -108, 0)]
    for k in range(4):
        y = -18 + 18 * k
        points += [(80, y, 5), (95, y, -30), (65, y, -35), (55, y, -10)]
    return seen(np.array(points) * 1e-3)


def seen(world: np.ndarray) -> Hand:
    """A hand as a distant camera sees it."""
    world = world - world.mean(axis=0)
    return Hand(world[:, :2] * 1500 + 300, world, 1.0, 0.5, 1.0, Roi(300, 300, 300))


def turned(hand: Hand, angle: float) -> Hand:
    """The hand turned in the image by `angle` [rad]."""
    world = hand.world.copy()
    world[:, :2] = world[:, :2] @ rotation(angle).T
    return replace(hand, landmarks=(hand.landmarks - 300) @ rotation(angle).T + 300, world=world)


def mirrored(hand: Hand) -> Hand:
    """The other hand."""
    return replace(hand, landmarks=hand.landmarks * (-1, 1) + (600, 0), world=hand.world * (-1, 1, 1))


def test_up_and_down() -> None:
    hand = thumbs_up()
    for one in (hand, mirrored(hand)):
        assert classify(one).gesture is UP
        assert 0 < classify(one).score <= 1
        assert classify(turned(one, np.pi)).gesture is DOWN


@settings(deadline=None, max_examples=40)
@given(st.floats(-3.1, 3.1))
def test_the_sign_never_points_the_wrong_way(angle: float) -> None:
    reading = classify(turned(thumbs_up(), angle))
    if reading.gesture is not NONE:
        assert (reading.gesture is UP) == (abs(angle) < np.pi / 2)
    if np.pi * 0.4 < abs(angle) < np.pi * 0.6:
        assert reading.gesture is NONE


def test_sideways_open_and_tucked_thumb_are_nothing() -> None:
    hand = thumbs_up()
    assert classify(turned(hand, np.pi / 2)).gesture is NONE
    open_hand = hand.world.copy()
    for k in range(4):
        open_hand[5 + 4 * k : 9 + 4 * k] = open_hand[5 + 4 * k] + np.outer(np.arange(4) * 0.025, [1, 0, 0])
    assert classify(replace(hand, world=open_hand)).gesture is NONE
    tucked = hand.world.copy()
    tucked[4] = tucked[6]
    assert classify(replace(hand, world=tucked)).gesture is NONE


def test_degenerate_landmarks_are_nothing() -> None:
    hand = thumbs_up()
    for value in (0.0, np.nan, np.inf):
        with np.errstate(invalid="ignore"):
            broken = replace(hand, landmarks=np.full((21, 2), value), world=np.full((21, 3), value))
            assert classify(broken).gesture is NONE


def test_a_hand_that_lies_flat_shows_no_sign() -> None:
    """The row of knuckles lies along the line of sight instead: a hand seen from its edge."""
    flat = thumbs_up().world
    for k in range(4):
        flat[5 + 4 * k : 9 + 4 * k] += (0.0, 0.027 - 0.018 * k, 0.03 * k - 0.045)
    assert classify(seen(flat)).gesture is NONE


def test_up_is_the_worlds() -> None:
    """A camera that looks 40 degrees down sees an upright row of knuckles tilted away."""
    hand, angle = thumbs_up(), np.deg2rad(40)
    up_C = np.array([0.0, -np.cos(angle), -np.sin(angle)])
    world = hand.world @ np.array(
        [[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]]
    )
    # The image is scaled by its spread, which turning the hand changes a little.
    knuckles = classify(seen(world), up_C=up_C).features.knuckles
    assert knuckles == pytest.approx(classify(hand).features.knuckles, abs=0.05)
    assert classify(seen(world)).features.knuckles > knuckles + 0.5


def test_rule_can_be_changed() -> None:
    assert classify(thumbs_up(), GestureRule(threshold=1.1)).gesture is NONE
    assert classify(thumbs_up(), GestureRule(least_margin=2.0)).gesture is NONE


# -- votes ---------------------------------------------------------------------------------------


def run(signs: list[Gesture], rate: float = 10.0, config: VoteConfig | None = None) -> list[Gesture]:
    vote = GestureVote(config)
    return [vote.push(i / rate, g, True) for i, g in enumerate(signs)]


def test_three_of_five() -> None:
    assert run([UP, UP, UP]) == [NONE, NONE, UP]
    assert run([UP, NONE, UP, NONE, UP]) == [NONE] * 4 + [UP]
    assert run([UP, NONE, NONE, UP, NONE, NONE, UP, NONE]) == [NONE] * 8


def test_hold_counts_time_not_images() -> None:
    assert run([UP] * 4, rate=100.0) == [NONE] * 4
    assert run([DOWN] * 4, rate=10.0)[-1] is DOWN


def test_it_ends_and_may_flicker() -> None:
    assert run([UP, UP, UP, NONE, UP, NONE, NONE, NONE, NONE]) == [NONE, NONE, UP, UP, UP, UP, UP, NONE, NONE]


@settings(deadline=None, max_examples=40)
@given(st.lists(st.sampled_from([UP, DOWN, NONE]), max_size=30))
def test_sign_is_never_guessed(signs: list[Gesture]) -> None:
    for i, out in enumerate(run(signs)):
        window = signs[max(0, i - 4) : i + 1]
        if out is not NONE:
            assert (DOWN if out is UP else UP) not in window
            assert out in window


def test_gap_and_permission_start_over() -> None:
    vote = GestureVote()
    vote.push(0.0, UP, True)
    vote.push(0.1, UP, True)
    assert vote.push(1.0, UP, True) is NONE
    vote.push(1.1, UP, True)
    assert vote.push(1.2, UP, False) is NONE
    assert vote.push(1.3, UP, True) is NONE
    vote.push(1.4, UP, True)
    assert vote.push(1.5, UP, True) is UP
    assert vote.push(2.5, NONE, True) is NONE


def test_old_images_are_ignored() -> None:
    vote = GestureVote()
    for _ in range(10):
        assert vote.push(0.0, UP, True) is NONE


def test_impossible_votes() -> None:
    with pytest.raises(ValueError, match="votes <= window"):
        VoteConfig(votes=6, window=5)
