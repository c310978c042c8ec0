"""The moving figure of a person: feet, trunk and two arms, each on its path, at any time."""

from __future__ import annotations

import numpy as np

from cell.config import CellConfig
from cell.frames import Array
from hil.sim.person.keyposes import UPRIGHT, KeyPoses
from hil.sim.person.motion import Blended, Drift, Path, Reach, Shaken, Still, Turning, reach_time
from hil.sim.person.stance import Arm, Stance

_STEP = 0.9
"""Length of one step [m]."""
_BENDING = 0.62
"""Mean speed at which a trunk bends [rad/s]."""
_EYES = (0.09, 1.58)
"""The eyes of a person of mean height who stands upright: ahead of the feet, above the floor [m]."""


class Figure:
    """One person's body over time; everything is a function of the time asked for.

    Args:
        keys: the poses of this person. config: the cell. hand_speed: mean speed of reaching [m/s].
        pace: factor on durations. place: of the feet at the start (2,) [m].
    """

    def __init__(
        self, keys: KeyPoses, config: CellConfig, hand_speed: float, pace: float, place: Array
    ) -> None:
        self._keys, self._speed, self._pace = keys, hand_speed, pace
        self._floor = config.floor_z
        self._paths: dict[str, Path] = {side: Still(keys.hanging[side]) for side in "LR"}
        self._trunk = Drift(UPRIGHT, UPRIGHT, -1.0, 1.0)
        self._feet = Drift(place, place, -1.0, 1.0)
        self._walked = 0.0

    # -- commands: each returns when it will be over [s] -----------------------------------------------

    def reach(
        self, side: str, goal: Arm, now: float, *, rise: float = 0.0, fall: float = 0.0,
        window: tuple[float, float] = (0.0, 1.0), trunk: Array | None = None, ease: bool = False,
    ) -> float:  # fmt: skip
        """Bring a hand to `goal`; the trunk follows as far as it must, or goes to `trunk`.

        Args:
            rise, fall, window: see `motion.Reach`. ease: the elbow stays as `goal` has it.
        """
        if trunk is None:
            trunk = self._keys.trunk(goal, side)
        if not ease:
            goal = self._keys.settled(goal, side, trunk)
        start = self.arm(side, now)
        bend = float(np.abs(trunk - self._trunk.at(now)).max())
        duration = self._pace * max(reach_time(start, goal, self._speed, rise, fall), bend / _BENDING)
        self._bend(trunk, now, duration)
        return self._follow(side, Reach(start, goal, now, duration, rise=rise, fall=fall, window=window), now)

    def close(self, side: str, fingers: Array, now: float, duration: float) -> float:
        """Change the fingers only."""
        start = self.arm(side, now)
        goal = Arm(start.p, start.R, start.swivel, fingers)
        return self._follow(side, Reach(start, goal, now, duration), now)

    def turn(self, side: str, now: float, duration: float, axis: Array, swing: float) -> float:
        """Turn the hand to and fro before the eyes."""
        return self._follow(side, Turning(self.arm(side, now), now, duration, axis, swing), now)

    def sway(self, side: str, now: float, rng: np.random.Generator, sway: float, sway_turn: float) -> float:
        """Hold the hand as still as a person can, until the next command."""
        return self._follow(side, Shaken(self.arm(side, now), now, rng, sway, sway_turn), now)

    def walk(self, goal: Array, now: float, speed: float) -> float:
        """Go to `goal` (2,) [m], facing the belt all the way."""
        start = self._feet.at(now)
        duration = 1.875 * float(np.linalg.norm(goal - start)) / speed
        self._feet = Drift(start, np.asarray(goal, float), now, duration)
        return self._feet.end

    def _follow(self, side: str, path: Path, now: float) -> float:
        old = self._paths[side]
        self._paths[side] = path if now >= old.end else Blended(old, path, now)
        return self._paths[side].end

    def _bend(self, trunk: Array, now: float, duration: float) -> None:
        before = self._trunk if now < self._trunk.end else None
        self._trunk = Drift(self._trunk.at(now), trunk, now, duration, before)

    # -- what is --------------------------------------------------------------------------------------

    def arm(self, side: str, t: float) -> Arm:
        """An arm in P."""
        return self._paths[side].at(t)

    def grip(self, side: str, t: float) -> Array:
        """The grip point of a hand in the world (3,) [m]."""
        p, (x, y) = self._paths[side].point(t), self._feet.at(t)
        return np.array([x - p[0], y - p[1], self._floor + p[2]])

    def grip_turn(self, side: str, t: float) -> Array:
        """Orientation of a hand in the world (3, 3)."""
        R = self._paths[side].at(t).R
        return np.array([-R[0], -R[1], R[2]])

    def eyes(self, t: float) -> Array:
        """About where the person looks from, in the world (3,) [m]."""
        (x, y), lean = self._feet.at(t), self.lean(t)
        ahead, up = _EYES
        back = 0.6 * np.array([np.sin(lean), 1 - np.cos(lean)])  # the hips are 0.6 m below the eyes
        return np.array([x - ahead - back[0], y, self._floor + up - back[1]])

    def lean(self, t: float) -> float:
        """Of the trunk [rad]."""
        return float(self._trunk.at(t)[0])

    def stance(self, t: float) -> Stance:
        """Everything, for posing the body."""
        x, y = (float(v) for v in self._feet.at(t))
        lean, twist, nod = (float(v) for v in self._trunk.at(t))
        return Stance(x, y, np.pi, self.arm("L", t), self.arm("R", t), lean, twist, nod, self._stride(t))

    def _stride(self, t: float) -> float:
        """Swing of the legs while walking: by the way gone, and less the slower."""
        a, b = self._feet.at(t - 0.02), self._feet.at(t + 0.02)
        speed = float(np.linalg.norm(b - a)) / 0.04
        way = float(np.linalg.norm(self._feet.at(t) - self._feet.at(self._feet.end)))
        return float(np.sin(np.pi * way / _STEP)) * min(1.0, speed / 0.8)
