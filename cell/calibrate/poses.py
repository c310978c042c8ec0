"""Which arm poses to look at the board from: in view, free, and together the most telling.

Candidates are drawn at random in the camera's view. Of those that the arm reaches without touching
anything, the next is always the one that adds most to what is known (the determinant of the information
about all 16 unknowns), which spreads them over the image, the distance and the tilt by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.calibrate.board import Board
from cell.calibrate.model import PRIOR, SIZE, Guess
from cell.calibrate.solve import CORNER_NOISE
from cell.config import CellConfig
from cell.errors import CalibrationError
from cell.frames import Array, inverse, pose, rot_z, rotation
from cell.motion.planner import Planner

_TRIES, _ENOUGH = 12000, 60
"""Poses drawn at most, and candidates that suffice."""
_CLEARANCE = 0.03
_IMAGE_MARGIN = 22.0
"""Corners must be so far inside the image [px], with the markers beside them ..."""
_LEAST_INSIDE = 0.6
"""... and so many of all, as a share."""
_TILT = np.deg2rad(48.0)
"""Largest angle between the board's normal and the line of sight."""
_LEAST_SQUARE = 11.0
"""Side of a square in the picture below which markers are not read [px]."""
_REACH = (0.15, 0.72)
"""Distances of the board's middle from the base that are tried [m]."""
_HIDDEN = 0.006


@dataclass(frozen=True)
class Pose:
    """One arm pose: joint angles q (6,) [rad], TCP pose X_WT (4, 4)."""

    q: Array
    X_WT: Array


class PoseSearch:
    """Poses for one camera.

    Args:
        planner, carrying: of the bare arm, and with the board in its gripper.
        guess: what is known of camera and board so far. seed: of the candidates.
    """

    def __init__(
        self, config: CellConfig, board: Board, planner: Planner, carrying: Planner, guess: Guess, seed: int
    ) -> None:
        self._config, self._board, self._planner, self._carrying = config, board, planner, carrying
        self._guess = guess
        self._rng = np.random.default_rng([seed, 0xCA11])

    def best(self, count: int) -> list[Pose]:
        """`count` poses, the most telling first.

        Raises:
            CalibrationError: too few can be had; says how many.
        """
        found = self._candidates(max(_ENOUGH, 2 * count))
        if len(found) < count:
            raise CalibrationError(
                f"only {len(found)} arm poses in reach show the board to the camera, {count} are wanted; "
                "a larger or differently held board ('board' in the configuration), another place of the "
                "camera, or fewer --views would help"
            )
        J = self._guess.jacobian(np.array([p.X_WT for p in found]), self._board.points_B)
        J = J * self._inside(np.array([p.X_WT for p in found]))[:, :, None, None]
        J = J.reshape(len(found), -1, SIZE) * PRIOR / CORNER_NOISE
        each = J.transpose(0, 2, 1) @ J
        known, left, chosen = np.eye(SIZE), list(range(len(found))), []
        for _ in range(count):
            gain = np.linalg.slogdet(known + each[left])[1]
            chosen.append(left.pop(int(np.argmax(gain))))
            known = known + each[chosen[-1]]
        return [found[i] for i in chosen]

    def _candidates(self, wanted: int) -> list[Pose]:
        out: list[Pose] = []
        for _ in range(_TRIES):
            if len(out) == wanted:
                break
            X_WB = self._draw()
            if X_WB is not None and (found := self._arm(X_WB @ inverse(self._guess.X_TB))) is not None:
                out.append(found)
        return out

    def _draw(self) -> Array | None:
        """A pose X_WB of the board that the camera sees whole; None when this try shows none."""
        rng, guess = self._rng, self._guess
        direction = rng.normal(size=3)
        p_WB = rng.uniform(*_REACH) * direction / np.linalg.norm(direction)
        p_CB = inverse(guess.X_WC)[:3] @ np.append(p_WB, 1.0)
        if p_CB[2] < 0.1 or guess.pinhole.fx * self._board.config.square / p_CB[2] < _LEAST_SQUARE:
            return None
        ray = p_CB / np.linalg.norm(p_CB)
        facing = rotation(np.arccos(ray[2]) * _unit(np.cross([0.0, 0.0, 1.0], ray)))
        axis = rng.uniform(0, 2 * np.pi)
        tilt = rotation(_TILT * np.sqrt(rng.uniform()) * np.array([np.cos(axis), np.sin(axis), 0.0]))
        X_WB: Array = guess.X_WC @ pose(facing @ tilt @ rot_z(rng.uniform(-np.pi, np.pi)), p_CB)
        inside = self._inside((X_WB @ inverse(guess.X_TB))[None])
        return X_WB if inside.mean() >= _LEAST_INSIDE else None

    def _inside(self, X_WT: Array) -> NDArray[np.bool_]:
        """Which corners are well inside the image at tool poses (V, 4, 4), shape (V, N)."""
        uv = self._guess.corners(X_WT, self._board.points_B)
        size = np.array([self._guess.pinhole.width, self._guess.pinhole.height])
        return np.asarray(((uv > _IMAGE_MARGIN) & (uv < size - 1 - _IMAGE_MARGIN)).all(axis=2))

    def _arm(self, X_WT: Array) -> Pose | None:
        """How the arm gets there without touching or hiding anything; None when it cannot."""
        q = np.array(self._planner.kinematics.ik(X_WT, np.array(self._config.arm.home))).reshape(-1, 6)
        if not len(q):
            return None
        q = q[self._carrying.collision.clearance(q, width=0.0) > _CLEARANCE]
        if not len(q):
            return None
        p_WP = self._board.outline_B @ (X_WT @ self._guess.X_TB)[:3, :3].T + (X_WT @ self._guess.X_TB)[:3, 3]
        hidden = self._planner.collision.hides(q, self._guess.X_WC[:3, 3], p_WP, radius=_HIDDEN)
        q = q[~hidden.any(axis=1)]
        return Pose(q[0], X_WT) if len(q) else None


def _unit(v: Array) -> Array:
    length = float(np.linalg.norm(v))
    return v / length if length > 1e-12 else np.zeros(3)
