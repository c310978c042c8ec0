"""Which onion next, and fingers that fit between neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.config import load
from cell.decision.targets import best_yaw, choose
from cell.perception.tracking import Track

CONFIG = load()


def track(i: int, x: float, y: float) -> Track:
    return Track(i, np.array([x, y, -0.115]), 0.035, 0.0)


def finger_gap(p: np.ndarray, yaw: float, other: Track) -> float:
    """Least distance of the open fingers' boxes from a neighbour's outline, by dense sampling."""
    axis, across = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    s, w = np.meshgrid(np.linspace(0, 0.014, 8), np.linspace(-0.011, 0.011, 8))
    least = np.inf
    for side in (-1, 1):
        along = side * (CONFIG.gripper.stroke / 2 + s)
        points = p[:2] + along[..., None] * axis + w[..., None] * across
        least = min(least, float(np.linalg.norm(points - other.p_WO[:2], axis=-1).min()) - other.radius)
    return least


def test_alone_the_wrist_does_not_turn() -> None:
    assert best_yaw(track(1, 0.3, 0.0), (track(1, 0.3, 0.0),), CONFIG).yaw == 0.0


def test_the_fingers_turn_away_from_a_neighbour() -> None:
    """Neighbours along x: fingers must close along y; neighbours along y: along x."""
    middle = track(1, 0.3, 0.0)
    along_x = (middle, track(2, 0.3 - 0.09, 0.0), track(3, 0.3 + 0.09, 0.0))
    along_y = (middle, track(2, 0.3, -0.09), track(3, 0.3, 0.09))
    for everything, bad in ((along_x, 0.0), (along_y, np.pi / 2)):
        grasp = best_yaw(middle, everything, CONFIG)
        assert grasp.clearance > 0.012
        for other in everything[1:]:
            assert finger_gap(middle.p_WO, grasp.yaw, other) > 0.012 > finger_gap(middle.p_WO, bad, other)


@settings(max_examples=100, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(0.09, 0.15))
def test_with_one_neighbour_the_fingers_never_touch_it(bearing: float, distance: float) -> None:
    middle = track(1, 0.3, 0.0)
    other = track(2, 0.3 + distance * np.cos(bearing), distance * np.sin(bearing))
    grasp = best_yaw(middle, (middle, other), CONFIG)
    assert -np.pi / 2 <= grasp.yaw <= np.pi / 2
    gap = finger_gap(middle.p_WO, grasp.yaw, other)
    assert gap > 0.005
    assert grasp.clearance <= gap + 1e-3  # the promise is kept, to the sampling


def test_the_nearest_is_taken_unless_it_is_crowded() -> None:
    near, far = track(1, 0.30, 0.0), track(2, 0.30, 0.30)
    assert choose([near, far], (near, far), np.array([0.3, 0.05, 0.0]), CONFIG).track.id == 1
    ring = tuple(
        track(10 + k, 0.3 + 0.07 * np.cos(a), 0.07 * np.sin(a))
        for k, a in enumerate(np.linspace(0, 2 * np.pi, 6, endpoint=False))
    )
    assert choose([near, far], (near, far, *ring), np.array([0.3, 0.05, 0.0]), CONFIG).track.id == 2


def test_fresh_onions_come_before_those_that_failed() -> None:
    failed, fresh = replace(track(1, 0.30, 0.0), attempts=1), track(2, 0.40, 0.30)
    assert choose([failed, fresh], (failed, fresh), np.array([0.3, 0.0, 0.0]), CONFIG).track.id == 2
