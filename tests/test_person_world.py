"""The simulated person in the simulated cell: onions in the hands, pictures, truth, distances."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec
import numpy as np
import pytest

from cell.config import CellConfig, load
from cell.errors import BackendError, ConfigError
from cell.frames import look_at, pose, rot_x
from cell.motion.kinematics import Kinematics
from cell.wire.vocabulary import SIGNALS, Action
from hil.sim.backend import SimBackend
from hil.sim.light import COLORS
from hil.sim.person.presence import Presence
from hil.sim.physics import bullet
from hil.sim.render.renderer import gl_problem

CONFIG = load()
NO_GL = gl_problem()
pytestmark = pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
PERSON, LIGHT = 7, 8


def silent(config: CellConfig = CONFIG) -> CellConfig:
    """The cell without free-running cameras, which would only take time here."""
    person = msgspec.structs.replace(config.cameras["person"], rate=0.0)
    return msgspec.structs.replace(config, cameras={**config.cameras, "person": person})


@contextmanager
def cell(
    person: str = "ana", seed: int = 1, onions: int = 10, config: CellConfig | None = None
) -> Iterator[SimBackend]:
    backend = SimBackend(config or silent(), seed, onions, person)
    backend.connect()
    try:
        yield backend
    finally:
        backend.close()


def presence(backend: SimBackend) -> Presence:
    assert backend.world.person is not None
    return backend.world.person


def respond(backend: SimBackend) -> None:
    """A robot that understands every sign at once and does nothing else."""
    gesture = presence(backend).agent.gesture
    if gesture:
        backend.command_light("requested" if gesture == "down" else "collaborative")


def run(
    backend: SimBackend, until: Callable[[], bool], limit: float, each: Callable[[], None] = lambda: None
) -> None:
    while not until():
        respond(backend)
        backend.advance()
        each()
        assert backend.now() < limit, "it took too long"


def test_a_person_sorts_tires_rests_and_goes_on() -> None:
    with cell(onions=12) as backend:
        who = presence(backend).agent
        run(backend, lambda: len(who.gestures) == 2 and len(who.sorted_) >= 7, 120.0)
        run(backend, lambda: who.held is None, 140.0)
        for _ in range(60):
            backend.advance()
        truth = backend.truth()
        assert truth.person is not None and truth.person.name == "ana"
        assert [g.sign for g in truth.person.gestures] == ["down", "up"]
        assert all(g.answered > g.shown for g in truth.person.gestures)
        assert truth.person.contacts == 0 and truth.arm_contacts == 0
        assert set(np.flatnonzero(truth.by_human)) == who.sorted_
        for i in who.sorted_:
            assert truth.place[i] == ("bin" if truth.blemished[i] else "belt")
            if not truth.blemished[i]:
                assert truth.p_WO[i, 0] > CONFIG.belt.pick_x[1] + 0.03
        assert "floor" not in truth.place


def test_a_held_onion_follows_the_hand_and_lies_still_afterwards() -> None:
    with cell() as backend:
        who, world = presence(backend).agent, backend.world
        worst, posed, steps = 0.0, 0.0, 0.0
        last: dict[int, np.ndarray] = {}

        def each() -> None:
            nonlocal worst, posed, steps
            if who.held is None:
                last.clear()
                return
            p = world.onion_pose(who.held)[:3, 3]
            worst = max(worst, float(np.linalg.norm(p - who.figure.grip("R", world.time))))
            if who.held in last:
                steps = max(steps, float(np.linalg.norm(p - last[who.held])))
            last[who.held] = p
            if world._substep % 100 == 0:
                shown = presence(backend).poser.grip(presence(backend).pose(), "R")
                posed = max(posed, float(np.linalg.norm(p - shown)))

        run(backend, lambda: len(who.sorted_) == 3, 30.0, each)
        assert worst < 0.01 and posed < 0.025 and steps < 2.0 * CONFIG.arm.control_period
        for _ in range(250):
            backend.advance()
        first = min(who.sorted_)
        v, _ = bullet.getBaseVelocity(world.onion_bodies[first], physicsClientId=world.client)
        assert np.linalg.norm(v) < 0.01


def test_what_the_robot_has_lifted_is_the_robots() -> None:
    kinematics = Kinematics(CONFIG)
    with cell(person="ana", seed=3, onions=3) as backend:
        world, sight = backend.world, presence(backend).sight
        onion = max(range(3), key=lambda i: sight.place(i)[0])
        p = sight.place(onion)
        q = np.array(CONFIG.arm.home)
        wide = CONFIG.gripper.stroke
        for up, width in ((0.0, wide), (0.0, 0.0), (0.12, 0.0), (0.0, 0.0), (0.0, wide), (0.1, wide)):
            goal = kinematics.ik_near(pose(rot_x(np.pi), p + np.array([0.0, 0.0, up])), q)
            if width > 0.0 and up == 0.0 and onion not in sight.dealt:
                world.arm.place(goal)
                q = goal
            backend.command_gripper(width, 0.15, 30.0)
            for s in np.linspace(0.0, 1.0, 70):
                backend.command_joints(q + (goal - q) * (3 * s**2 - 2 * s**3), np.zeros(6))
                backend.advance()
                assert presence(backend).agent.held != onion
            if up > 0.1:
                assert sight.in_gripper == onion
            q = goal
        assert onion in sight.dealt and sight.in_gripper is None
        assert world.place_of(onion) == "belt" and not sight.free(onion)
        world.arm.place(np.array(CONFIG.arm.home))
        backend.command_joints(np.array(CONFIG.arm.home), np.zeros(6))
        who = presence(backend).agent
        for _ in range(round(15.0 / CONFIG.arm.control_period)):
            backend.advance()
            assert who.held != onion
        assert onion not in who.sorted_


def digest(person: str) -> str:
    with cell(person, onions=8) as backend:
        for _ in range(700):
            respond(backend)
            backend.advance()
        backend.request_frame("person")
        for _ in range(20):
            backend.advance()
        (frame,) = backend.take_frames()
        truth = backend.truth()
        assert truth.person is not None
        parts = (truth.p_WO, truth.person.p_WH, np.array([truth.person.separation]), frame.rgb, frame.depth)
        return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def test_the_same_seed_gives_the_same_bits() -> None:
    assert digest("chen") == digest("chen")


# -- pictures -------------------------------------------------------------------------------------------


def test_the_person_camera_sees_the_sign_and_the_resting_person() -> None:
    with cell("dana") as backend:
        who = presence(backend)
        camera = backend._cameras["person"]

        def labels() -> np.ndarray:
            backend.world.refresh()
            assert backend._renderer is not None
            return backend._renderer.render(camera.X_WC, camera.pinhole, camera.near, camera.far).labels

        run(backend, lambda: bool(who.agent.gesture), 60.0)
        hand = who.poser.landmarks(who.pose(), "L")
        p_C = (hand - camera.X_WC[:3, 3]) @ camera.X_WC[:3, :3]
        uv = camera.pinhole.project(p_C)
        assert np.all(uv > 10) and np.all(uv < (camera.pinhole.width - 10, camera.pinhole.height - 10))
        assert np.ptp(uv, axis=0).max() > 40.0  # pixels: large enough for the hand networks
        seen = labels()
        shown = [seen[round(v), round(u)] == PERSON for u, v in uv]
        assert np.mean(shown) > 0.8
        run(backend, lambda: who.agent.fatigued and who.agent.figure.stance(backend.now()).x > 1.94, 80.0)
        seen = labels()
        assert (seen == PERSON).sum() > 8000
        assert (seen[:, -1] == PERSON).sum() < 60  # not cut off at the picture's edge


def test_nobody_costs_nothing_and_is_nobody() -> None:
    with cell(person="", config=CONFIG) as backend:
        for _ in range(60):
            backend.advance()
        assert backend.take_frames() == []
        truth = backend.truth()
        assert truth.person is None and not truth.by_human.any() and len(truth.by_human) == 10


def test_a_person_needs_the_gl_renderer() -> None:
    tiny = msgspec.structs.replace(CONFIG, renderer="tiny")
    with pytest.raises(BackendError, match="--person none"):
        SimBackend(tiny, 1, 3, "ana").connect()


def test_an_unknown_person_is_an_error_that_lists_the_names() -> None:
    with pytest.raises(ConfigError, match="ana, bo"):
        SimBackend(CONFIG, 1, 3, "nobody").connect()


def test_the_mode_light_shows_its_signal() -> None:
    assert set(COLORS) == set(SIGNALS)
    x, y, z = CONFIG.cameras["belt"].position
    X_WC = look_at((x + 0.8, y, z + 0.1), (x - 0.05, y, z + 0.05))
    with cell(person="", onions=1) as backend:
        pinhole = backend._cameras["belt"].pinhole
        assert backend._renderer is not None
        for signal in ("off", "collaborative", "requested", "industrial", "stopped"):
            backend.command_light(signal)
            image = backend._renderer.render(X_WC, pinhole, 0.05, 5.0)
            lit = image.rgb[image.labels == LIGHT]
            assert len(lit) > 100
            strongest = np.argsort(lit.mean(axis=0))[::-1]
            expected = {"collaborative": [1], "industrial": [2], "stopped": [0], "requested": [0, 1]}
            if signal == "off":
                assert lit.mean() < 110
            else:
                assert list(strongest[: len(expected[signal])]) == expected[signal]
        with pytest.raises(BackendError, match="collaborative"):
            backend.command_light("pink")


# -- distances ------------------------------------------------------------------------------------------


def test_separation_agrees_with_the_physics_engines_own_distance() -> None:
    """Every vertex as a small ball, asked of PyBullet one by one."""
    with cell() as backend:
        who, world = presence(backend), backend.world
        run(backend, lambda: who.agent.action == Action.PICK, 10.0)
        for _ in range(60):
            backend.advance()
        q = np.array([-0.3, -1.2, -1.9, -1.6, 1.57, 0.0])
        world.arm.place(q)
        radius, c = 0.001, world.client
        shape = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=radius, physicsClientId=c)
        ball = bullet.createMultiBody(0, shape, physicsClientId=c)
        at = who.pose()
        least = np.inf
        for p in who.body.points(at.G, at.p, 2):
            if p[0] > 0.9:
                continue
            bullet.resetBasePositionAndOrientation(ball, p.tolist(), [0, 0, 0, 1], physicsClientId=c)
            points = bullet.getClosestPoints(world.robot, ball, 1.0, physicsClientId=c)
            least = min([least, *(point[8] + radius for point in points)])
        assert who.separation() == pytest.approx(least, abs=0.005)
        assert 0.02 < who.separation() < 0.6


def test_touching_the_person_is_noticed() -> None:
    with cell() as backend:
        who, world = presence(backend), backend.world
        run(backend, lambda: who.agent.held is not None, 10.0)
        hand = who.agent.figure.grip("R", world.time)
        before = backend.truth()
        assert before.person is not None and before.person.contacts == 0 and before.person.separation > 0.1
        over = pose(rot_x(np.pi), hand + np.array([0.0, 0.0, 0.05]))
        world.arm.place(Kinematics(CONFIG).ik_near(over, np.array(CONFIG.arm.home)))
        for _ in range(8):
            backend.advance()
        truth = backend.truth()
        assert truth.person is not None
        assert truth.person.separation == 0.0 and truth.person.contacts > 0
