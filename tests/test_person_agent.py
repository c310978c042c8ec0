"""What the simulated person decides, and how the hands move: no world, no pictures."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.config import load
from cell.errors import ConfigError
from cell.frames import Array
from cell.wire.vocabulary import Action
from hil.sim.person.agent import THUMBS_DOWN, THUMBS_UP, Agent
from hil.sim.person.body import Body, body_names
from hil.sim.person.keyposes import KeyPoses
from hil.sim.person.motion import Blended, Reach, Turning, rotation
from hil.sim.person.persona import PERSONAS, Persona, persona
from hil.sim.person.places import drop_place, free_place
from hil.sim.person.reach import Poser

CONFIG = load()
PERIOD = CONFIG.arm.control_period
ANA = persona("ana")


@cache
def poser(body: str = ANA.body) -> Poser:
    return Poser(Body(body), CONFIG.floor_z)


class Belt:
    """Surroundings that stand still, apart from what the person carries."""

    def __init__(self, count: int = 10, seed: int = 0, blemish: str = "mixed") -> None:
        rng = np.random.default_rng(seed)
        self.p = np.column_stack(
            [rng.uniform(0.34, 0.43, count), np.linspace(-0.3, 0.3, count), np.full(count, -0.115)]
        )
        kinds = {"mixed": ("sound", "shown", "concealed")}.get(blemish, (blemish,))
        self.kind = [kinds[i % len(kinds)] for i in range(count)]
        self.gone: set[int] = set()
        self.p_WT = np.array([0.0, -0.3, 0.3])
        self.signal = "collaborative"

    def count(self) -> int:
        return len(self.p)

    def place(self, onion: int) -> Array:
        out: Array = self.p[onion].copy()
        return out

    def radius(self, onion: int) -> float:
        return 0.035

    def free(self, onion: int) -> bool:
        return onion not in self.gone

    def shows_blemish(self, onion: int, p_WE: Array) -> bool:
        return self.kind[onion] == "shown"

    def blemished(self, onion: int) -> bool:
        return self.kind[onion] != "sound"

    def tool(self) -> Array:
        return self.p_WT


class Life:
    """A person in such surroundings, and everything that was done: (time, action, held)."""

    def __init__(self, belt: Belt, who: Persona = ANA, seed: int = 1, answers: bool = True) -> None:
        self.belt, self.answers = belt, answers
        self.agent = Agent(who, CONFIG, poser(who.body), seed)
        self.t = 0.0
        self.log: list[tuple[float, int, int | None]] = []

    def run(self, seconds: float) -> Life:
        end = self.t + seconds
        while self.t < end:
            self.step()
        return self

    def step(self) -> None:
        agent = self.agent
        agent.advance(self.t, self.belt)
        if self.answers and agent.gesture:
            self.belt.signal = "requested" if agent.gesture == "down" else "collaborative"
        if agent.held is not None:
            self.belt.p[agent.held] = agent.figure.grip(agent.side, self.t)
        entry = (int(agent.action), agent.held)
        if not self.log or self.log[-1][1:] != entry:
            self.log.append((self.t, *entry))
        self.t += PERIOD

    def actions(self) -> list[int]:
        out: list[int] = []
        for _, action, _ in self.log:
            if not out or out[-1] != action:
                out.append(action)
        return out


# -- people -------------------------------------------------------------------------------------------


def test_there_are_five_people_with_different_bodies_and_looks() -> None:
    assert len(PERSONAS) == 5
    bodies = {p.body for p in PERSONAS.values()}
    assert len(bodies) == 5 and bodies <= set(body_names())
    assert len({p.look for p in PERSONAS.values()}) == 5
    for who in PERSONAS.values():
        assert 2 <= who.tires_after[0] <= who.tires_after[1] <= 5
        assert 15.0 <= who.rest[0] <= who.rest[1] <= 30.0 and 0.8 <= who.walk <= 1.2


def test_an_unknown_person_is_an_error_that_lists_the_names() -> None:
    with pytest.raises(ConfigError, match="ana, bo, chen, dana, efe"):
        persona("zoe")


# -- sorting --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("shown", [Action.DETECT, Action.PICK, Action.PLACE_IN_BIN]),
        ("concealed", [Action.DETECT, Action.PICK, Action.INSPECT, Action.PLACE_IN_BIN]),
        ("sound", [Action.DETECT, Action.PICK, Action.INSPECT, Action.PLACE_ON_CONVEYOR]),
    ],
)
def test_each_kind_of_onion_goes_the_published_way(kind: str, expected: list[int]) -> None:
    life = Life(Belt(1, blemish=kind)).run(12.0)
    assert life.actions() == [*expected, Action.DETECT]
    assert life.agent.sorted_ == {0}
    p = life.belt.p[0]
    if expected[-1] == Action.PLACE_IN_BIN:
        assert np.all(np.abs(p[:2] - CONFIG.person.bin.center[:2]) < np.array(CONFIG.person.bin.size[:2]) / 2)
    else:
        assert CONFIG.person.sorted_x[0] <= p[0] <= CONFIG.person.sorted_x[1]


def test_the_far_part_of_the_belt_comes_first_and_nothing_out_of_reach() -> None:
    belt = Belt(4, blemish="shown")
    belt.p[:, 0] = [0.36, 0.42, 0.30, 0.39]
    life = Life(belt).run(30.0)
    taken = [held for _, action, held in life.log if action == Action.PICK and held is not None]
    assert taken == [1, 3, 0]


def test_a_person_leaves_what_is_at_the_robots_tool() -> None:
    belt = Belt(1)
    belt.p_WT = belt.p[0] + (-0.05, 0.05, 0.1)
    life = Life(belt).run(5.0)
    assert life.actions() == [Action.DETECT]
    belt.p_WT = np.array([0.0, -0.3, 0.3])
    assert life.run(4.0).agent.held == 0


@pytest.mark.parametrize("how", ["tool comes", "robot takes it", "it rolls away"])
def test_a_hand_on_its_way_turns_back(how: str) -> None:
    belt = Belt(1)
    life = Life(belt)
    while life.actions()[-1:] != [Action.PICK]:
        life.step()
    life.run(0.4)
    if how == "tool comes":
        belt.p_WT = belt.p[0] + (0.0, 0.0, 0.05)
    elif how == "robot takes it":
        belt.gone.add(0)
    else:
        belt.p[0, 1] += 0.1
    life.run(0.5)
    assert life.agent.held is None
    if how != "it rolls away":
        life.run(0.8)
        assert life.agent.figure.grip("R", life.t)[2] > CONFIG.belt.top_z + 0.15
        assert life.agent.action == Action.DETECT
    else:
        assert life.run(4.0).agent.held == 0 or life.agent.sorted_


def test_mistakes_skip_the_inspection_or_misjudge() -> None:
    clumsy = replace(ANA, mistakes=1.0, tires_after=(100, 100))
    life = Life(Belt(8, blemish="sound"), clumsy).run(70.0)
    placed = [a for a in life.actions() if a in (Action.PLACE_IN_BIN, Action.PLACE_ON_CONVEYOR)]
    inspected = life.actions().count(Action.INSPECT)
    assert len(placed) == 8
    assert 0 < inspected < 8 and placed.count(Action.PLACE_IN_BIN) == inspected  # misjudged; the rest skipped


# -- fatigue --------------------------------------------------------------------------------------------


def test_a_tired_person_says_so_rests_and_says_when_it_is_over() -> None:
    life = Life(Belt(14))
    fatigued = []
    while len(life.agent.gestures) < 2 or life.agent.gesture:
        life.step()
        if life.agent.fatigued:
            fatigued.append((life.t, life.agent.figure.stance(life.t).x))
        assert life.t < 120.0
    down, up = life.agent.gestures
    assert (down.sign, up.sign) == ("down", "up")
    assert ANA.reaction <= down.answered - down.shown <= 1.0 and up.answered > up.shown
    assert 2 <= len(life.agent.sorted_) <= 5
    assert max(x for _, x in fatigued) == pytest.approx(CONFIG.person.rest[0], abs=1e-6)
    resting = [t for t, x in fatigued if x > CONFIG.person.rest[0] - 1e-3]
    assert ANA.rest[0] - 0.5 <= resting[-1] - resting[0] <= ANA.rest[1] + 0.5
    order = [a for a in life.actions() if a in (THUMBS_DOWN, THUMBS_UP)]
    assert order == [THUMBS_DOWN, THUMBS_UP]
    later = life.actions()
    life.run(10.0)
    assert Action.PICK in life.actions()[len(later) - 1 :]


def test_a_sign_that_nobody_answers_is_given_up() -> None:
    life = Life(Belt(14), answers=False)
    while not life.agent.gestures:
        life.step()
    shown = life.agent.gestures[0].shown
    while life.agent.gesture:
        life.step()
    assert life.t - shown == pytest.approx(ANA.patience, abs=0.05)
    assert life.agent.gestures[0].answered < 0.0
    life.run(4.0)
    assert life.agent.fatigued and life.agent.figure.stance(life.t).x > 1.5


@pytest.mark.parametrize("light", ["off", "hold", "stopped", "collaborative"])
def test_only_request_and_industrial_answer_a_thumbs_down(light: str) -> None:
    life = Life(Belt(14), answers=False)
    life.belt.signal = light
    while not life.agent.gestures:
        life.step()
    assert life.run(3.0).agent.gesture == "down"
    life.belt.signal = "industrial"
    assert life.run(ANA.reaction + 0.1).agent.gesture == ""
    assert life.agent.gestures[0].answered > 0.0


def test_at_most_two_signals_of_fatigue() -> None:
    who = replace(ANA, tires_after=(2, 2), rest=(2.0, 2.0))
    life = Life(Belt(14, blemish="shown"), who).run(110.0)
    assert [g.sign for g in life.agent.gestures] == ["down", "up", "down", "up"]
    assert len(life.agent.sorted_) == 14


def test_signs_are_shown_by_the_empty_left_hand_near_the_camera() -> None:
    life = Life(Belt(14))
    seen = 0
    while life.t < 50.0:
        life.step()
        if life.agent.gesture:
            seen += 1
            p = life.agent.figure.grip("L", life.t)
            assert life.agent.held is None
            assert 0.15 <= p[2] - CONFIG.belt.top_z <= 0.36
            assert 0.5 <= np.linalg.norm(p - CONFIG.cameras["person"].position) <= 1.2
            thumb = life.agent.figure.grip_turn("L", life.t)[:, 1] @ (0.0, 0.0, 1.0)
            assert abs(thumb) > 0.8
    assert seen > 100


# -- chance ---------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_life_and_another_seed_another() -> None:
    lives = [Life(Belt(10), persona("efe"), seed).run(40.0) for seed in (1, 1, 2)]
    assert lives[0].log == lives[1].log and lives[0].belt.p.tobytes() == lives[1].belt.p.tobytes()
    assert lives[0].log != lives[2].log


# -- motion ---------------------------------------------------------------------------------------------


@cache
def keys(side: str = "R") -> KeyPoses:
    return KeyPoses(poser(), CONFIG, side)


@settings(max_examples=40, deadline=None)
@given(x=st.floats(0.34, 0.56), y=st.floats(-0.33, 0.33), when=st.floats(0.0, 1.2), hold=st.booleans())
def test_an_interrupted_hand_never_jumps(x: float, y: float, when: float, hold: bool) -> None:
    goal = keys().take(np.array([x, y, -0.115]), "open")
    first = Reach(keys().ready(), goal, 0.0, 0.9, rise=0.05, fall=0.12, window=(0.1, 0.6))
    start = first.at(when)
    away = Reach(start, keys().home(), when, 0.7)
    held = Turning(start, when, 1.0, np.array([1.0, 0.0, 0.0]), 0.7)
    path = Blended(first, held if hold else away, when)
    times = np.arange(0.0, 2.5, 0.008)
    arms = [(first if t < when else path).at(float(t)) for t in times]
    p = np.array([arm.p for arm in arms])
    assert np.linalg.norm(np.diff(p, axis=0), axis=1).max() < 0.008 * 3.0
    assert max(rotation(a.R, b.R)[1] for a, b in pairwise(arms)) < 0.008 * 12.0
    for t, arm in zip(times, arms, strict=True):
        assert np.allclose(arm.R @ arm.R.T, np.eye(3), atol=1e-9)
        if t >= when:
            assert np.allclose(path.point(float(t)), arm.p, atol=1e-12)


def test_hands_move_like_hands() -> None:
    """Below 2.5 m/s all the time, never into the belt, and over it when they cross it."""
    life = Life(Belt(10))
    last = {side: life.agent.figure.grip(side, 0.0) for side in "LR"}
    while life.t < 45.0:
        life.step()
        for side in "LR":
            p = life.agent.figure.grip(side, life.t - PERIOD)
            assert np.linalg.norm(p - last[side]) < 2.5 * PERIOD
            if p[0] < CONFIG.belt.x[1]:
                assert p[2] > CONFIG.belt.top_z + 0.03
            last[side] = p


def test_things_are_put_where_there_is_room() -> None:
    rng = np.random.default_rng(0)
    others = np.zeros((0, 2))
    for _ in range(6):
        xy = free_place(CONFIG, others, np.array([0.0, 0.0]), rng)
        assert CONFIG.person.sorted_x[0] <= xy[0] <= CONFIG.person.sorted_x[1]
        if len(others):
            assert np.linalg.norm(others - xy, axis=1).min() > CONFIG.onions.diameter[1]
        others = np.vstack([others, xy])
    bin = CONFIG.person.bin
    for _ in range(50):
        p = drop_place(bin, rng)
        assert np.all(np.abs(p[:2] - bin.center[:2]) + 0.04 <= np.array(bin.size[:2]) / 2)
