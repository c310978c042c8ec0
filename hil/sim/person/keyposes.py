"""Where a person's hands go in this cell: from places in the world to arms that can be posed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cell.config import CellConfig
from cell.frames import Array, rot_y, rot_z
from cell.settings import Vec3
from hil.sim.person.hands import shape
from hil.sim.person.reach import Poser, hand_frame
from hil.sim.person.stance import Arm, Stance

UPRIGHT = np.array([0.05, 0.0, 0.12])
"""Trunk of a person who stands at ease: lean, twist, nod [rad]."""
WORKING = np.array([0.14, 0.0, 0.40])
"""Trunk of a person who looks over the belt."""
SIDES = {"left": "L", "right": "R"}
_STRETCH = 0.96
"""A person leans until the arm needs no more than this part of its length."""
_BENDS = sorted(
    ((0.05 + 0.1 * step, twist) for step in range(9) for twist in (0.0, 0.2, 0.4, 0.6)),
    key=lambda bend: bend[0] + 0.5 * bend[1],
)
"""Lean and twist of the trunk [rad], less effort first."""
_TO_WRIST = np.array([-0.089, 0.0, -0.062])
"""From the grip point to the wrist, in the hand's frame [m]."""


class KeyPoses:
    """Arms and trunks of one person, in P, for a person who faces the belt (yaw pi).

    Args:
        poser: of the person's body. config: the cell. side: "L" or "R", the hand that works.
    """

    def __init__(self, poser: Poser, config: CellConfig, side: str) -> None:
        self._poser, self._config, self.side = poser, config, side
        self._out = 1.0 if side == "L" else -1.0
        self._station = np.array([*config.person.station, config.floor_z])
        self._belt_z = config.belt.top_z - config.floor_z
        self._swivels: dict[tuple[str, bytes, bytes, bytes], float] = {}
        self._shoulders: dict[tuple[float, float, str], tuple[Array, float]] = {}
        self.hanging = {s: poser.hanging(s) for s in "LR"}

    def in_P(self, p_W: Array) -> Array:
        """A point of the world (3,) [m] as seen by the person at the station."""
        d = np.asarray(p_W, float) - self._station
        return np.array([-d[0], -d[1], d[2]])

    # -- the hand that works -----------------------------------------------------------------------

    def ready(self) -> Arm:
        """Over the near edge of the belt, empty."""
        return self._before((0.34, 0.18, 0.20), (0.85, -0.35, 0.1), (0.1, -0.5, -1.0), "relaxed")

    def take(self, p_W: Array, fingers: str) -> Arm:
        """Round an onion at `p_W`, from above and from the near side."""
        p = self.in_P(p_W)
        shoulder = np.array([0.15, 0.17 * self._out])
        ahead = p[:2] - shoulder
        ahead = ahead / np.linalg.norm(ahead)
        frame = hand_frame((*(0.72 * ahead), -0.69), (*(-0.69 * ahead), -0.72))
        return Arm(p, frame, 0.0, shape(fingers))

    def home(self) -> Arm:
        """In front of the body, with an onion."""
        return self._before((0.36, 0.14, 0.22), (0.8, -0.45, 0.0), (0.0, -0.6, -0.8), "grip")

    def inspect(self) -> Arm:
        """Before the eyes."""
        return self._before((0.36, 0.06, 0.38), (0.72, -0.62, 0.25), (-0.35, 0.05, 0.95), "grip")

    def drop(self, p_W: Array) -> Arm:
        """Over the bin, the palm down."""
        p = self.in_P(p_W)
        frame = hand_frame((0.75, 0.25 * float(np.sign(p[1])), -0.5), (-0.3, 0.0, -1.0))
        return Arm(p, frame, 0.0, shape("grip"))

    # -- signs ---------------------------------------------------------------------------------------

    def sign(self, sign: str, slant: float, fingers: Array) -> Arm:
        """The left hand held out with the thumb "up" or "down", or "level" on the way between.

        Args:
            slant: how far the thumb is from the vertical [rad]. fingers: as from `hands.shape`.
        """
        roll = {"up": 0.0, "level": np.pi / 2, "down": np.pi}[sign] + slant
        if sign == "down":  # elbow out and hand before the chest, or the wrist cannot turn so far
            R = rot_z(np.deg2rad(-25.0)) @ rot_y(np.deg2rad(20.0))
            R_palm = hand_frame(R[:, 0], R @ np.array([0.0, -np.cos(roll), -np.sin(roll)]))
            return Arm(np.array([0.26, 0.38, self._belt_z + 0.35]), R_palm, 0.0, fingers)
        palm = (0.1, -np.cos(roll), -np.sin(roll))
        p = np.array([0.36, 0.30, self._belt_z + (0.26 if sign == "up" else 0.30)])
        return Arm(p, hand_frame((0.97, 0.05, 0.15), palm), 0.0, fingers)

    # -- trunk and elbow -----------------------------------------------------------------------------

    def trunk(self, arm: Arm, side: str) -> Array:
        """Lean, twist and nod, (3,) [rad], of least effort from which a hand reaches `arm`."""
        wrist = arm.p + arm.R @ _TO_WRIST
        out = 1.0 if side == "L" else -1.0
        for lean, twist in _BENDS:
            trunk = np.array([lean, -out * twist, 0.25 + 0.3 * lean])
            if (lean, twist, side) not in self._shoulders:
                self._shoulders[lean, twist, side] = self._poser.shoulder(self._stance(trunk), side)
            shoulder, far = self._shoulders[lean, twist, side]
            if np.linalg.norm(wrist - shoulder) <= _STRETCH * far:
                break
        return trunk

    def settled(self, arm: Arm, side: str, trunk: Array) -> Arm:
        """The same arm with the elbow where it is most at ease."""
        key = (side, arm.p.tobytes(), arm.R.tobytes(), trunk.tobytes())
        if key not in self._swivels:  # ready, home and inspect come again and again
            stance = self._stance(trunk).with_arm(side, arm)
            self._swivels[key] = self._poser.best_swivel(stance, side).arm(side).swivel
        return replace(arm, swivel=self._swivels[key])

    def _stance(self, trunk: Array) -> Stance:
        lean, twist, nod = (float(v) for v in trunk)
        return Stance(0.0, 0.0, 0.0, self.hanging["L"], self.hanging["R"], lean, twist, nod)

    def _before(self, p: Vec3, along: Vec3, palm: Vec3, fingers: str) -> Arm:
        """An arm of the working hand, given for the left one; `p` is above the belt's height."""
        x, y, z = p
        mirror = np.array([1.0, self._out, 1.0])
        frame = hand_frame(mirror * along, mirror * palm)
        return Arm(np.array([x, y * self._out, self._belt_z + z]), frame, 0.0, shape(fingers))
