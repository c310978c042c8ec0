"""The mirror of the cell beside the controller: it shows what the simulation shows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from cell.config import load
from cell.errors import ConfigError
from hil.emulator.exchange import Ball, Snapshot
from hil.emulator.mirror import MirrorBackend, check_surroundings
from hil.sim.backend import SimBackend
from hil.sim.person.persona import PERSONAS
from hil.sim.physics import bullet
from hil.sim.render.renderer import gl_problem

CONFIG = load()
NO_GL = gl_problem()
pytestmark = pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
PERIOD = CONFIG.arm.control_period
T0 = 4e9
"""Wall clock of the first report [s]: later than any now, since time never runs backwards."""


@contextmanager
def sim(seed: int, onions: int, person: str) -> Iterator[SimBackend]:
    backend = SimBackend(CONFIG, seed, onions, person)
    backend.connect()
    try:
        yield backend
    finally:
        backend.close()


@contextmanager
def mirror(seed: int, onions: int, person: str, rate: float = 10.0) -> Iterator[MirrorBackend]:
    """rate: of the person's camera [Hz]."""
    camera = msgspec.structs.replace(CONFIG.cameras["person"], rate=rate)
    config = msgspec.structs.replace(CONFIG, cameras={**CONFIG.cameras, "person": camera})
    backend = MirrorBackend(config, seed, onions, person)
    backend.connect()
    try:
        yield backend
    finally:
        backend.close()


def report(backend: SimBackend, t: float, batch: int = 1) -> Snapshot:
    """What a plant in the state of this simulation would say."""
    world = backend.world
    return Snapshot(
        t, batch, world.signal, world.gripper.holding, 0, world.arm.angles(), world.gripper.fingers(),
        tuple(ball.pose for ball in balls(backend)),
    )  # fmt: skip


def balls(backend: SimBackend) -> tuple[Ball, ...]:
    """The onions of a simulation as a plant gets them."""
    world = backend.world
    out = []
    for onion, body in zip(world.onions, world.onion_bodies, strict=True):
        p, q = bullet.getBasePositionAndOrientation(body, physicsClientId=world.client)
        out.append(Ball(onion.mass, onion.collision_radius, (*p, *q)))
    return tuple(out)


def test_the_same_batch_and_the_same_pictures() -> None:
    with sim(3, 8, "") as real, mirror(3, 8, "") as seen:
        assert seen.batch().number == 1
        assert seen.batch().balls == balls(real)
        real.command_light("requested")
        for _ in range(40):
            real.command_joints(np.array(CONFIG.arm.home) + 0.05, np.zeros(6))
            real.advance()
        seen.live(report(real, T0))
        real.request_frame("belt")
        seen.request_frame("belt")
        for _ in range(10):
            real.advance()
        seen.live(report(real, T0 + 0.08))
        (wanted,), (got,) = real.take_frames(), seen.take_frames()
        assert got.t == T0 and got.seq == wanted.seq == 1
        assert np.array_equal(got.rgb, wanted.rgb) and np.array_equal(got.depth, wanted.depth)
        assert seen.camera_info("belt").fx == real.camera_info("belt").fx


def test_the_person_lives_in_the_mirror() -> None:
    """Against a plant that only lets the hand carry: what is held, moves, and is let go."""
    with sim(1, 8, "") as plant, mirror(1, 8, "ana", rate=1.0) as seen:
        held: set[int] = set()
        last, frames = None, []
        for k in range(round(25.0 / PERIOD)):
            hand = seen.live(report(plant, T0 + k * PERIOD))
            gesture = seen.truth().person.gesture if k % 50 == 0 else ""  # type: ignore[union-attr]
            if gesture:
                plant.command_light("requested" if gesture == "down" else "collaborative")
            if hand.onion >= 0:
                held.add(hand.onion)
                X_WO = np.eye(4)
                X_WO[:3, 3] = hand.pose[:3]
                plant.world.set_onion_pose(hand.onion, X_WO)
            elif last is not None and last.onion >= 0:
                assert last.batch == 1
            last = hand
            frames += seen.take_frames()
            plant.world.substep()
        truth = seen.truth()
        assert truth.person is not None and truth.person.name == "ana"
        assert truth.t == pytest.approx(T0 + 25.0, abs=0.1)
        assert held and truth.by_human.sum() >= len(held) - 1 > 0
        assert {frame.camera for frame in frames} == {"person"}
        assert len(frames) == pytest.approx(25, abs=1)


def test_a_camera_that_cannot_keep_up_leaves_pictures_out() -> None:
    with sim(1, 2, "") as plant, mirror(1, 2, "ana") as seen:
        for k in range(100):  # eight pictures' time, and nobody looks
            seen.live(report(plant, T0 + k * PERIOD))
        (frame,) = seen.take_frames()
        assert frame.t == pytest.approx(T0, abs=0.11)
        seen.live(report(plant, T0 + 100 * PERIOD))
        seen.live(report(plant, T0 + 115 * PERIOD))
        (frame,) = seen.take_frames()
        assert frame.t >= T0 + 100 * PERIOD


def test_reports_of_another_batch_move_no_onions() -> None:
    with sim(1, 4, "") as plant, mirror(1, 4, "ana") as seen:
        before = seen.truth()
        assert seen.live(report(plant, T0, batch=0)).onion == -1
        assert np.array_equal(seen.truth().p_WO, before.p_WO)
        assert seen.truth().t == T0


def test_contacts_are_the_plants() -> None:
    with sim(1, 2, "") as plant, mirror(1, 2, "") as seen:
        snapshot = report(plant, T0)
        seen.note_contact("1.000 s: robot touches belt")
        seen.live(replace(snapshot, contacts=7))
        assert seen.truth().arm_contacts == 7
        assert seen.truth().contact_log == ("1.000 s: robot touches belt",)


def test_a_new_batch_and_a_new_person() -> None:
    with mirror(1, 4, "ana") as seen:
        batch = seen.renew(2, 6, "bo")
        assert batch.number == 2 and len(batch.balls) == 6 and seen.read_belt().batch == 2
        assert seen.truth().person.name == "bo"  # type: ignore[union-attr]
        with pytest.raises(ConfigError, match="onions must be from 0 to 15, got 99"):
            seen.renew(2, 99, "bo")
        assert seen.renew(2, 3, "").number == 3
        assert seen.truth().person is None


def test_impossible_surroundings() -> None:
    check_surroundings(0, 0, "")
    for persona in PERSONAS:
        check_surroundings(2**63 - 1, 15, persona)
    with pytest.raises(ConfigError, match="persona 'zoe' is unknown; legal values: none, ana, bo"):
        check_surroundings(0, 3, "zoe")
    with pytest.raises(ConfigError, match="seed must be from 0 to"):
        check_surroundings(-1, 3, "")
