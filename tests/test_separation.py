"""How near the person is, from rendered depth against the simulation's truth, and what blinds it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from cell.config import load
from cell.frames import Array
from cell.motion.collision import CollisionModel
from cell.perception.hand_regions import hand_regions
from cell.perception.scene import EmptyScene
from cell.perception.separation import STRIDE, Cloud, Separation
from cell.wire.types import Frame
from hil.sim.backend import SimBackend
from hil.sim.render.renderer import gl_problem

CONFIG = load()
NO_GL = gl_problem()
pytestmark = pytest.mark.skipif(bool(NO_GL), reason=NO_GL)


class Watched:
    """A person at work beside a resting arm, every frame of the person camera with its truth."""

    def __init__(self, seconds: float, persona: str = "ana") -> None:
        backend = SimBackend(CONFIG, 5, 15, persona)
        backend.connect()
        self.home = np.array(CONFIG.arm.home)
        p, r, _ = CollisionModel(CONFIG).spheres(self.home[None])
        self.arm: Array = np.column_stack([p[0], r])
        self.frames: list[Frame] = []
        self.truth: dict[float, float] = {}
        self.hands: dict[float, Array] = {}
        first = backend.truth()
        self.onions: Array = np.column_stack([first.p_WO, first.radius])
        """As the belt camera knows them from its first look; those taken since are still listed."""
        while backend.now() < seconds:
            backend.command_joints(self.home, np.zeros(6))
            backend.advance()
            self.frames += [f for f in backend.take_frames() if f.camera == "person"]
            if round(backend.now() / CONFIG.arm.control_period) % 2 == 0:
                person = backend.truth().person
                assert person is not None
                self.truth[round(backend.now(), 3)] = person.separation
                self.hands[round(backend.now(), 3)] = person.p_WH
        backend.close()

    def at(self, t: float) -> float:
        times = sorted(self.truth)
        return float(np.interp(t, times, [self.truth[s] for s in times]))


@pytest.fixture(scope="module")
def watched() -> Iterator[Watched]:
    yield Watched(6.0)


def clouds(watched: Watched) -> list[Cloud]:
    separation = Separation(CONFIG)
    return [separation.look(f, watched.arm, watched.onions) for f in watched.frames]


def test_the_error_stays_small(watched: Watched) -> None:
    errors = np.array([c.distance(watched.arm)[0] - watched.at(c.t) for c in clouds(watched)])
    assert len(errors) > 50
    assert np.percentile(np.abs(errors), 95) <= 0.040
    assert errors.max() <= 0.060


def test_working_hands_are_found(watched: Watched) -> None:
    """One of the regions is at the hand that reaches over the belt."""
    found = []
    for c in clouds(watched):
        t = min(watched.hands, key=lambda s: abs(s - c.t))
        hand = watched.hands[t][1]
        if hand[0] < CONFIG.belt.x[1] - 0.05:
            regions = hand_regions(c.p_WP, CONFIG)
            found.append(any(np.linalg.norm(r.p_W - hand) < 0.12 for r in regions))
    assert len(found) > 10 and np.mean(found) > 0.9


def test_a_covered_camera_sees_nobody_and_says_so(watched: Watched) -> None:
    frame = watched.frames[-1]
    cloud = Separation(CONFIG).look(
        replace(frame, depth=np.zeros_like(frame.depth)), watched.arm, np.zeros((0, 4))
    )
    assert cloud.share == 0.0 < CONFIG.separation.least_seen
    assert cloud.distance(watched.arm)[0] == np.inf


def test_an_empty_cell_holds_nobody() -> None:
    """Depth of the fixed parts alone, with the camera's noise, and onions on the belt."""
    scene = EmptyScene(CONFIG, "person", 1)
    depth = np.where(np.isfinite(scene.depth) & (scene.depth < 6.0), scene.depth, 0.0).astype(np.float32)
    rng = np.random.default_rng(0)
    depth = depth + np.where(depth > 0, 0.003 * depth**2 * rng.standard_normal(depth.shape), 0).astype(
        np.float32
    )
    frame = Frame("person", 1, 0.0, np.zeros((*depth.shape, 3), np.uint8), depth.astype(np.float32))
    cloud = Separation(CONFIG).look(frame, np.zeros((0, 4)), np.zeros((0, 4)))
    assert len(cloud.p_WP) < 5


def test_what_the_arm_hides_is_remembered_for_a_while(watched: Watched) -> None:
    """A board-like arm before the person: the points behind it stay, and go after a time."""
    separation = Separation(CONFIG)
    first = watched.frames[20]
    before = separation.look(first, watched.arm, np.zeros((0, 4)))
    near = before.p_WP[:200]
    scene = EmptyScene(CONFIG, "person", STRIDE)
    middle = near.mean(axis=0)
    ball = np.array([*(scene.p_WC + 0.7 * (middle - scene.p_WC)), 0.25])
    depth = first.depth.copy()
    full = EmptyScene(CONFIG, "person", 1)
    to_ball = ball[:3] - full.p_WC
    rays = full.rays_W.astype(float)
    b = rays @ to_ball
    a = (rays * rays).sum(-1)
    inside = b * b - a * (to_ball @ to_ball - ball[3] ** 2)
    hit = inside > 0
    surface = np.where(hit, (b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
    depth = np.where(surface < np.where(depth > 0, depth, np.inf), surface, depth).astype(np.float32)
    for k, expected in ((1, True), (3, True), (12, False)):
        frame = replace(first, t=first.t + 0.1 * k, depth=depth)
        cloud = separation.look(frame, ball[None], np.zeros((0, 4)))
        kept = any(np.linalg.norm(cloud.p_WP - middle, axis=1) < 0.05) if len(cloud.p_WP) else False
        assert kept is expected or bool(kept) is expected
