"""What the emulated controller moves: set-points, grasps, forces, batches, the person's hand."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.config import load
from cell.errors import BackendError, ConfigError, DecodeError
from cell.wire.vocabulary import SIGNALS
from hil.emulator.exchange import Ball, Batch, Exchange, Hand, Message, Snapshot, Touch, decode, encode
from hil.emulator.interfaces import PERIOD
from hil.emulator.plant import IdealPlant, WorldPlant
from hil.sim.physics import bullet
from hil.ur3e.lamp import BITS, MASK, lamp_bits, lamp_signal

CONFIG = load()
HOME = np.array(CONFIG.arm.home)
REST = np.zeros(6)
SOMEWHERE = (0.35, -0.1, -0.1, 0.0, 0.0, 0.0, 1.0)


class Clock:
    """Time that stands still unless moved."""

    t = 100.0

    def now(self) -> float:
        return self.t

    def sleep_until(self, t: float) -> None:
        self.t = max(self.t, t)


@contextmanager
def world_plant() -> Iterator[tuple[WorldPlant, Exchange]]:
    """A plant at home, and the other end of its link."""
    ours, theirs = (Exchange(sock) for sock in Exchange.pair())
    plant = WorldPlant(CONFIG, ours, Clock())
    try:
        yield plant, theirs
    finally:
        plant.close()
        ours.close()
        theirs.close()


def rest(plant: WorldPlant, seconds: float) -> None:
    for _ in range(round(seconds / PERIOD)):
        plant.step(HOME, REST)


def snapshots(exchange: Exchange) -> list[Snapshot]:
    return [m for m in exchange.receive(1000) if isinstance(m, Snapshot)]


def tool(plant: WorldPlant) -> tuple[float, float, float]:
    state = bullet.getLinkState(plant.world.robot, plant.world.tcp_link, physicsClientId=plant.world.client)
    x, y, z = state[4]
    return x, y, z


# -- without physics ----------------------------------------------------------------------------------


def test_the_ideal_arm_is_at_the_set_point_and_feels_nothing() -> None:
    plant = IdealPlant(CONFIG)
    plant.step(HOME + 0.1, REST + 0.5)
    measured = plant.measure()
    assert np.array_equal(measured.q, HOME + 0.1) and np.array_equal(measured.qd, REST + 0.5)
    assert not measured.wrench.any() and not measured.effort.any()


def test_the_ideal_gripper_moves_at_its_speed_and_stops_at_an_object() -> None:
    plant = IdealPlant(CONFIG)
    gripper = plant.gripper
    gripper.command(0.0, 0.1, 30.0)
    assert gripper.state() == (CONFIG.gripper.stroke, True, False)  # before the plant took it, too
    for _ in range(100):
        plant.step(HOME, REST)
    assert gripper.state()[0] == pytest.approx(CONFIG.gripper.stroke - 0.02)
    gripper.object = 0.05
    for _ in range(300):
        plant.step(HOME, REST)
    assert gripper.state() == (pytest.approx(0.05), False, True)
    gripper.command(0.08, 0.1, 30.0)
    for _ in range(300):
        plant.step(HOME, REST)
    assert gripper.state() == (pytest.approx(0.08), False, False)


# -- the simulated cell -------------------------------------------------------------------------------


def test_the_arm_follows_its_set_point_without_lag() -> None:
    with world_plant() as (plant, _):
        worst = 0.0
        for k in range(500):
            t = k * PERIOD
            plant.step(HOME + 0.1 * (1 - math.cos(3 * t)), REST + 0.3 * math.sin(3 * t))
            if k > 10:
                before = HOME + 0.1 * (1 - math.cos(3 * (t - PERIOD)))  # set-points are taken over a step on
                worst = max(worst, float(np.abs(plant.measure().q - before).max()))
        assert worst < 2e-3


def test_lamp_fingers_and_joints_are_reported_every_control_period() -> None:
    with world_plant() as (plant, other):
        plant.outputs(lamp_bits("requested") | 0b1000_0000)
        rest(plant, 4 * CONFIG.arm.control_period)
        said = snapshots(other)
        assert len(said) == 4
        assert said[-1].signal == "requested" and not said[-1].holding
        assert said[-1].t == Clock.t and said[-1].batch == 0 and said[-1].onions == ()
        assert np.allclose(said[-1].q, HOME, atol=1e-3)
        assert sum(said[-1].fingers) == pytest.approx(CONFIG.gripper.stroke, abs=1e-3)


def test_a_new_batch_comes_while_the_arm_goes_on() -> None:
    with world_plant() as (plant, other):
        balls = tuple(Ball(0.15, 0.035, (0.3, y, -0.115, 0.0, 0.0, 0.0, 1.0)) for y in (-0.2, 0.0, 0.2))
        other.send(Batch(1, balls))
        rest(plant, 0.2)
        assert plant.batch == 1
        other.send(Batch(2, balls[:2]))
        rest(plant, 0.4)
        last = snapshots(other)[-1]
        assert last.batch == plant.batch == 2 and len(last.onions) == 2
        assert np.allclose(
            [pose[:3] for pose in last.onions], [ball.pose[:3] for ball in balls[:2]], atol=2e-3
        )
        assert np.allclose(plant.measure().q, HOME, atol=1e-3)


def test_what_the_hand_holds_goes_with_it_until_it_is_let_go() -> None:
    with world_plant() as (plant, other):
        other.send(Batch(1, (Ball(0.15, 0.035, (0.3, 0.0, -0.115, 0.0, 0.0, 0.0, 1.0)),)))
        rest(plant, 0.1)
        up = (0.5, 0.1, 0.3, 0.0, 0.0, 0.0, 1.0)
        other.send(Hand(Clock.t, 1, 0, up, (0.0, 0.0, 0.0)))
        rest(plant, 0.5)
        assert np.allclose(snapshots(other)[-1].onions[0][:3], up[:3], atol=2e-3)
        other.send(Hand(Clock.t, 1, -1, up, (0.0, 0.0, 0.0)))
        rest(plant, 0.2)
        assert snapshots(other)[-1].onions[0][2] < 0.3 - 0.15  # it falls


def test_a_hand_of_an_old_batch_moves_nothing() -> None:
    with world_plant() as (plant, other):
        other.send(Batch(2, (Ball(0.15, 0.035, (0.3, 0.0, -0.115, 0.0, 0.0, 0.0, 1.0)),)))
        rest(plant, 0.1)
        other.send(Hand(Clock.t, 1, 0, (0.5, 0.1, 0.3, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)))
        other.send(Hand(Clock.t, 2, 7, (0.5, 0.1, 0.3, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)))
        rest(plant, 0.1)
        assert snapshots(other)[-1].onions[0][2] < 0.0


def test_a_held_onion_weighs_on_the_flange() -> None:
    mass = 0.18
    with world_plant() as (plant, other):
        assert not plant.measure().wrench.any()
        there = (*tool(plant), 0.0, 0.0, 0.0, 1.0)
        other.send(Batch(1, (Ball(mass, 0.035, there),)))
        other.send(Hand(Clock.t, 1, 0, there, (0.0, 0.0, 0.0)))
        rest(plant, 0.02)
        other.send(Hand(Clock.t, 1, 0, there, (0.0, 0.0, 0.0)))  # a hand holds it until the fingers do
        plant.gripper.command(0.03, 0.1, 30.0)
        rest(plant, 0.6)
        width, moving, holding = plant.gripper.state()
        assert holding and not moving and width == pytest.approx(0.07, abs=2e-3)
        other.send(Hand(Clock.t, 1, -1, there, (0.0, 0.0, 0.0)))
        rest(plant, 0.3)
        assert plant.gripper.state()[2]
        assert np.allclose(plant.measure().wrench, [0, 0, -mass * 9.81, 0, 0, 0], atol=1e-9)
        assert snapshots(other)[-1].holding


def test_forbidden_contacts_are_counted_and_told() -> None:
    with world_plant() as (plant, other):
        low = HOME - [1.79, 0, 0, 0, 0, 0]  # over the belt
        plant.world.arm.place(low)
        for _ in range(400):
            low[1] -= 0.6 / 400
            plant.step(low, REST)
        messages = other.receive(1000)
        told = [m.text for m in messages if isinstance(m, Touch)]
        assert told and all("robot touches" in text for text in told) and len(told) <= 20
        assert [m for m in messages if isinstance(m, Snapshot)][-1].contacts >= len(told)
        assert np.linalg.norm(plant.measure().wrench[:3]) > 1.0


def test_the_plant_does_not_wait_for_surroundings_that_do_not_listen() -> None:
    with world_plant() as (plant, other):
        rest(plant, 3.0)
        assert len(snapshots(other)) < 375  # more than fit were dropped, and nothing hung
        rest(plant, 0.1)
        assert snapshots(other)
        other.close()
        rest(plant, 0.1)


def test_a_control_period_that_does_not_fit_the_cycle() -> None:
    arm = msgspec.structs.replace(CONFIG.arm, control_period=0.005)
    with pytest.raises(ConfigError, match=r"multiple of the controller's cycle, 0\.002 s"):
        WorldPlant(msgspec.structs.replace(CONFIG, arm=arm))


# -- the lamp -----------------------------------------------------------------------------------------


def test_every_signal_has_a_colour_of_its_own() -> None:
    assert sorted(BITS) == sorted(SIGNALS) and len(set(BITS.values())) == len(BITS)
    for signal in SIGNALS:
        assert lamp_bits(signal) & ~MASK == 0
        assert lamp_signal(lamp_bits(signal) | ~MASK & 0xFFFF) == signal
    assert lamp_signal(0b101) == lamp_signal(0b110) == "off"
    with pytest.raises(BackendError, match="got 'pink'; legal values: off, "):
        lamp_bits("pink")


# -- the link -----------------------------------------------------------------------------------------

MESSAGES: list[Message] = [
    Snapshot(1.5, 2, "hold", True, 3, (0.1, 0.2, 0.3, 0.4, 0.5, 0.6), (0.01, 0.02), (SOMEWHERE, SOMEWHERE)),
    Snapshot(1.5, 0, "off", False, 0, (0.0,) * 6, (0.0, 0.0), ()),
    Hand(2.5, 1, -1, SOMEWHERE, (0.1, 0.2, 0.3)),
    Batch(7, (Ball(0.1, 0.03, SOMEWHERE),)),
    Touch("3.000 s: robot touches belt"),
]


@pytest.mark.parametrize("message", MESSAGES)
def test_messages_survive_the_link(message: Message) -> None:
    assert decode(encode(message)) == message
    for cut in range(len(encode(message))):
        if cut and isinstance(message, Touch):
            continue  # a shorter line is a line
        with pytest.raises(DecodeError):
            decode(encode(message)[:cut])


@given(st.binary(max_size=300))
@settings(max_examples=200)
def test_rubbish_on_the_link_is_a_decode_error(data: bytes) -> None:
    with suppress(DecodeError):
        decode(data)
