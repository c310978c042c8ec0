"""What the person decides and does: sorts, tires, says so, rests, comes back.

Unfatigued, a person looks for an onion, picks it, inspects it if it looks sound, and puts it into
the bin or back onto the conveyor; fatigued, it shows thumbs-down and does nothing until rested:
the human's policy of the sorting domain, acted out in seconds.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cell.config import CellConfig
from cell.frames import Array
from cell.wire.types import ShownGesture
from cell.wire.vocabulary import Action
from hil.sim.person.figure import Figure
from hil.sim.person.hands import shape
from hil.sim.person.keyposes import SIDES, UPRIGHT, WORKING, KeyPoses
from hil.sim.person.persona import MAX_SIGNALS, Persona
from hil.sim.person.places import drop_place, free_place
from hil.sim.person.reach import Poser
from hil.sim.person.surroundings import Surroundings
from hil.sim.person.watch import SignWatch

THUMBS_UP, THUMBS_DOWN = Action.SPEED_UP, Action.SLOW_DOWN
"""The human's actions 7 and 8 have the numbers of the robot's mode changes."""
_SHY = 0.15
"""A person does not start for an onion that the robot's tool is this near to [m] ..."""
_YIELD = 0.085
"""... and lets go of one that the tool comes this near to [m]."""
_MOVED = 0.03
"""An onion that moved this far while the hand came is taken anew [m]."""
_UPRIGHT = 0.2
"""With less lean than this a person shows a sign [rad]."""
_IDLE = 1.5
"""After this long without anything to do the hands go down [s]."""


class Agent:
    """One person at work; call `advance` once per control period.

    Args:
        persona: who. config: the cell. poser: of the body. seed: with the persona, decides all chance.

    Attributes:
        figure: the body's motion. action: an `Action`. gesture: "", "up" or "down", while shown.
        fatigued: true type. held: the onion in the hand, or None. sorted_: onions put away so far.
        gestures: all signs so far.
    """

    def __init__(self, persona: Persona, config: CellConfig, poser: Poser, seed: int) -> None:
        self.persona, self._config = persona, config
        self._rng = np.random.default_rng([seed, zlib.crc32(persona.name.encode())])
        self.side = SIDES[persona.hand]
        self._keys = KeyPoses(poser, config, self.side)
        self._station, self._rest = np.array(config.person.station), np.array(config.person.rest)
        self.figure = Figure(self._keys, config, persona.hand_speed, persona.pace, self._station)
        self.action, self.gesture, self.fatigued = Action.DETECT, "", False
        self.held: int | None = None
        self.sorted_: set[int] = set()
        self.gestures: list[ShownGesture] = []
        self._since_rest = self._signals = 0
        self._now = 0.0
        self._life = self._live()
        self._around: Surroundings

    def advance(self, now: float, around: Surroundings) -> None:
        """Live on until time `now` [s], in these surroundings."""
        self._now, self._around = now, around
        next(self._life)

    # -- the policy ------------------------------------------------------------------------------------

    def _live(self) -> Iterator[None]:
        yield from self._wait(float(self._rng.uniform(0.2, 0.8)))
        while True:
            onion = self._choose()
            if onion is None:
                yield from self._idle()
                continue
            done = len(self.sorted_)
            yield from self._sort(onion)
            if len(self.sorted_) > done and self._tires():
                yield from self._recover()

    def _sort(self, onion: int) -> Iterator[None]:
        self.action = Action.DETECT
        self.figure.reach(self.side, self._keys.ready(), self._now, trunk=WORKING)
        yield from self._wait(self._seconds(self.persona.detect))
        slip = self._slip()
        bad = self._around.shows_blemish(onion, self.figure.eyes(self._now))
        self.action = Action.PICK
        yield from self._pick(onion)
        if self.held is None:
            return
        if not bad and slip != "skip":
            self.action = Action.INSPECT
            yield from self._inspect()
            bad = self._around.blemished(onion)
        if bad != (slip == "misjudge"):
            self.action = Action.PLACE_IN_BIN
            yield from self._place_in_bin()
        else:
            self.action = Action.PLACE_ON_CONVEYOR
            yield from self._place_on_conveyor()
        self.sorted_.add(onion)
        self._since_rest += 1

    def _choose(self) -> int | None:
        """The farthest onion from the robot that is free and out of its tool's way."""
        near, far = self._config.person.reach_x
        best, best_x = None, near
        tool = self._around.tool()
        for onion in range(self._around.count()):
            if onion in self.sorted_ or not self._around.free(onion):
                continue
            p = self._around.place(onion)
            if best_x <= p[0] <= far and np.linalg.norm(p[:2] - tool[:2]) > _SHY:
                best, best_x = onion, float(p[0])
        return best

    def _tires(self) -> bool:
        """Whether fatigue came with the last onion; a person without work left does not mind."""
        least, most = self.persona.tires_after
        threshold = int(self._rng.integers(least, most + 1))
        left = any(self._around.free(i) and i not in self.sorted_ for i in range(self._around.count()))
        return self._since_rest >= threshold and self._signals < MAX_SIGNALS and left

    def _slip(self) -> str:
        if self._rng.random() >= self.persona.mistakes:
            return ""
        return "skip" if self._rng.random() < 0.5 else "misjudge"

    # -- actions ---------------------------------------------------------------------------------------

    def _pick(self, onion: int) -> Iterator[None]:
        figure, keys = self.figure, self._keys
        p_WO = self._around.place(onion)
        goal = keys.take(p_WO, "open")
        end = figure.reach(self.side, goal, self._now, rise=0.05, fall=0.12, window=(0.1, 0.6))
        while self._now < end:
            if not self._mine(onion, p_WO):
                self._withdraw()
                return
            yield
        end = figure.close(self.side, shape("grip"), self._now, 0.2 * self.persona.pace)
        while self._now < end:
            yield
        if not self._mine(onion, p_WO):
            self._withdraw()
            return
        self.held = onion
        yield from self._until(figure.reach(self.side, keys.home(), self._now, rise=0.12))

    def _mine(self, onion: int, p_WO: Array) -> bool:
        """The onion is still there to be taken."""
        if not self._around.free(onion) or np.linalg.norm(self._around.place(onion) - p_WO) > _MOVED:
            return False
        return bool(np.linalg.norm(self._around.tool() - p_WO) > _YIELD)

    def _withdraw(self) -> None:
        self.action = Action.NO_OP
        self.figure.reach(self.side, self._keys.ready(), self._now, rise=0.08, trunk=WORKING)

    def _inspect(self) -> Iterator[None]:
        figure, arm = self.figure, self._keys.inspect()
        yield from self._until(figure.reach(self.side, arm, self._now, trunk=WORKING))
        seconds = self._seconds(self.persona.inspect)
        axis = figure.arm(self.side, self._now).R[:, 0]
        yield from self._until(figure.turn(self.side, self._now, seconds, axis, 0.7))

    def _place_in_bin(self) -> Iterator[None]:
        p_W = drop_place(self._config.person.bin, self._rng)
        end = self.figure.reach(self.side, self._keys.drop(p_W), self._now, rise=0.05, fall=0.10)
        yield from self._until(end)
        yield from self._let_go(0.0)

    def _place_on_conveyor(self) -> Iterator[None]:
        around, onion = self._around, self.held
        assert onion is not None
        others = [around.place(i)[:2] for i in range(around.count()) if i != onion]
        xy = free_place(self._config, np.array(others).reshape(-1, 2), around.tool()[:2], self._rng)
        p_W = np.array([*xy, self._config.belt.top_z + around.radius(onion) + 0.003])
        goal = self._keys.take(p_W, "grip")
        yield from self._until(self.figure.reach(self.side, goal, self._now, fall=0.12))
        yield from self._let_go(0.12)

    def _let_go(self, rise: float) -> Iterator[None]:
        end = self.figure.close(self.side, shape("open"), self._now, 0.15 * self.persona.pace)
        yield from self._until(end)
        self.held = None
        yield from self._wait(0.08)
        self.figure.reach(self.side, self._keys.ready(), self._now, rise=rise, trunk=WORKING)

    def _idle(self) -> Iterator[None]:
        """No onion to take: look out for one, the hands down if it takes long."""
        self.action = Action.DETECT
        since, down = self._now, False
        while self._choose() is None:
            if not down and self._now - since > _IDLE:
                down = True
                self._hands_down(self.side)
            for _ in range(12):  # a person looks about ten times a second
                yield

    # -- fatigue -----------------------------------------------------------------------------------------

    def _recover(self) -> Iterator[None]:
        """Say so, step back, rest, come back, say so."""
        self.fatigued = True
        self._signals += 1
        yield from self._sign("down")
        self._hands_down("L")
        yield from self._until(self.figure.walk(self._rest, self._now, self.persona.walk))
        yield from self._wait(float(self._rng.uniform(*self.persona.rest)))
        self.fatigued, self._since_rest = False, 0
        yield from self._until(self.figure.walk(self._station, self._now, self.persona.walk))
        yield from self._sign("up")
        self._hands_down("L")

    def _sign(self, sign: str) -> Iterator[None]:
        """Hold up a thumb until the robot shows that it understood, or patience ends."""
        who, figure = self.persona, self.figure
        self.action = Action.NO_OP
        self._hands_down(self.side)
        slant = float(self._rng.normal(0.0, who.roll))
        fingers = shape("thumb", self._rng, who.sloppiness)
        while figure.lean(self._now) > _UPRIGHT:  # the trunk comes up first
            yield
        for way in ("up",) if sign == "up" else ("level", "down"):
            arm = self._keys.sign(way, slant if way == sign else 0.0, fingers)
            yield from self._until(figure.reach("L", arm, self._now, window=(0.2, 0.8), trunk=WORKING))
        figure.sway("L", self._now, self._rng, who.wobble, who.wobble_turn)
        watch = SignWatch(who, sign, self._now)
        self.action, self.gesture = THUMBS_UP if sign == "up" else THUMBS_DOWN, sign
        self.gestures.append(ShownGesture(sign, self._now, -1.0))
        while not watch.over(self._now, self._around.signal):
            yield
        self.gestures[-1] = replace(self.gestures[-1], answered=watch.answered)
        self.action, self.gesture = Action.NO_OP, ""

    def _hands_down(self, side: str) -> None:
        over_belt = self.figure.grip(side, self._now)[0] < self._config.belt.x[1] + 0.05
        rise = 0.15 if over_belt else 0.0
        self.figure.reach(side, self._keys.hanging[side], self._now, rise=rise, trunk=UPRIGHT, ease=True)

    # -- time --------------------------------------------------------------------------------------------

    def _seconds(self, bounds: tuple[float, float]) -> float:
        return self.persona.pace * float(self._rng.uniform(*bounds))

    def _wait(self, seconds: float) -> Iterator[None]:
        yield from self._until(self._now + seconds)

    def _until(self, end: float) -> Iterator[None]:
        while self._now < end:
            yield
