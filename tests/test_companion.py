"""Looking at frames ahead of their tick changes when it is done, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell.config import load
from cell.decision.belief import make_belief
from cell.decision.companion import Companion
from cell.decision.io import Inputs
from cell.frames import Array
from cell.motion.collision import CollisionModel
from cell.perception.hands.gesture import Gesture
from cell.perception.person import PersonView
from cell.perception.separation import Cloud
from cell.wire.types import ArmStatus, BeltState, Frame, GripperState, Hands, JointState

CONFIG = load()
COLLISION = CollisionModel(CONFIG)
NO_ONIONS = np.zeros((0, 4))


class NotingEye:
    """Sees nobody, and notes what it was shown."""

    def __init__(self) -> None:
        self.shown: list[tuple[float, Array, Array | None]] = []

    def look(self, frame: Frame, arm: Array, onions: Array, full: Array | None = None) -> PersonView:
        self.shown.append((frame.t, arm, full))
        cloud = Cloud(frame.t, np.zeros((0, 3)), np.zeros(0), 1.0)
        return PersonView(frame.t, cloud, (), Hands(frame.t, "person", ()), Gesture.NONE, Gesture.NONE, "")


def frame(t: float, camera: str = "person") -> Frame:
    return Frame(camera, round(t * 100), t, np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.float32))


def inputs(t: float, *frames: Frame) -> Inputs:
    q = np.array(CONFIG.arm.home) + 0.3 * np.sin(t)
    joints = JointState(t, q, np.zeros(6), np.zeros(6))
    gripper = GripperState(t, 0.085, 0.085, False, False)
    return Inputs(t, joints, ArmStatus(t), gripper, BeltState(t, 1, False, 0.0), frames)


def lived(ahead: bool, latency: float) -> list[tuple[float, Array, Array | None]]:
    """What the eye was shown in two seconds of ticks, with frames of a camera of 10 Hz."""
    eye = NotingEye()
    companion = Companion(CONFIG, eye, make_belief(CONFIG.supervisor.belief), COLLISION)
    waiting = [0.1 * k for k in range(20)]
    for k in range(50):
        now = 0.04 * k
        due = [t for t in waiting if t + latency <= now + 1e-9]
        waiting = [t for t in waiting if t not in due]
        frames = (frame(now, "belt"), *(frame(t) for t in due))
        if ahead:
            companion.look(frames, NO_ONIONS)
        companion.update(inputs(now, *frames), 0.0, NO_ONIONS)
    return eye.shown


@pytest.mark.parametrize("latency", [0.0, 0.03, 0.06, 0.25])
def test_it_sees_the_same_beside_the_same_arm(latency: float) -> None:
    plain, ahead = lived(False, latency), lived(True, latency)
    assert len(plain) == len(ahead) > 15
    for (t, arm, _), (t_ahead, arm_ahead, _) in zip(plain, ahead, strict=True):
        assert t == t_ahead and (arm == arm_ahead).all()


def test_a_frame_is_looked_at_once_and_ahead_where_it_can_be() -> None:
    eye = NotingEye()
    companion = Companion(CONFIG, eye, make_belief(CONFIG.supervisor.belief), COLLISION)
    companion.look((frame(0.0),), NO_ONIONS)  # nothing is known of the arm yet
    assert not eye.shown
    companion.update(inputs(0.2), 0.0, NO_ONIONS)
    companion.look((frame(0.1),), NO_ONIONS)
    assert [t for t, _, _ in eye.shown] == [0.1]
    companion.update(inputs(0.24, frame(0.1)), 0.0, NO_ONIONS)
    assert len(eye.shown) == 1 and companion.sensed(0.24).fresh
    companion.update(replace(inputs(0.28), frames=(frame(0.1),)), 0.0, NO_ONIONS)
    assert len(eye.shown) == 1


def test_a_late_tick_does_not_move_the_arm_in_a_frame() -> None:
    """Between two ticks 0.12 s apart the arm is where it was at the exposure, not where a tick found it."""
    eye = NotingEye()
    seen = {}
    for exposure in (0.0, 0.03, 0.06, 0.12):
        companion = Companion(CONFIG, eye, make_belief(CONFIG.supervisor.belief), COLLISION)
        companion.update(moving(0.0), 0.0, NO_ONIONS)
        companion.update(moving(0.12, frame(exposure)), 0.0, NO_ONIONS)
        seen[exposure] = eye.shown[-1][1]
    for exposure, arm in seen.items():
        there = Companion(CONFIG, eye, make_belief(CONFIG.supervisor.belief), COLLISION)
        there.update(moving(exposure, frame(exposure)), 0.0, NO_ONIONS)
        assert np.abs(arm - eye.shown[-1][1]).max() < 1e-9


def moving(t: float, *frames: Frame) -> Inputs:
    """Inputs of an arm that turns steadily, at 1 rad/s."""
    known = inputs(t, *frames)
    return replace(known, joints=replace(known.joints, q=np.array(CONFIG.arm.home) + t))
