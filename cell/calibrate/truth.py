"""Simulation: cameras that stand and draw a little differently from what is configured, and by how much."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from cell.calibrate.model import Guess
from cell.cameras import true_pinhole, true_pose
from cell.config import CellConfig
from cell.frames import angle_of, inverse
from cell.settings import CameraConfig, MisplacedConfig, Vec3

SHIFT, TURN, FOCAL, CENTRE = 0.006, 0.012, 0.008, 3.0
"""Standard deviations along or about each axis: camera [m], [rad], focal lengths (share), centre [px]."""
_BOARD_SHIFT, _BOARD_TURN = 0.002, 0.02
"""The same of the board in the gripper."""


@dataclass(frozen=True)
class Error:
    """How far a result is from the truth: position [m], rotation [rad], fx and fy (share), cx and cy (share
    of the image's width)."""

    position: float
    rotation: float
    focal: float
    centre: float


def misplaced(config: CellConfig, seed: int) -> CellConfig:
    """The simulated cell: a board in the gripper, cameras off by chance where none is by configuration."""
    cameras = {}
    for index, (name, camera) in enumerate(config.cameras.items()):
        rng = np.random.default_rng([seed, index, 0x0FF])
        off = MisplacedConfig(
            shift=_three(rng, SHIFT),
            turn=_three(rng, TURN),
            focal=(1 + float(rng.normal(0, FOCAL)), 1 + float(rng.normal(0, FOCAL))),
            centre=(float(rng.normal(0, CENTRE)), float(rng.normal(0, CENTRE))),
        )
        cameras[name] = msgspec.structs.replace(camera, simulated=camera.simulated or off)
    rng = np.random.default_rng([seed, 0xB0A2D])
    board = msgspec.structs.replace(
        config.board, mounted=True, shift=_three(rng, _BOARD_SHIFT), turn=_three(rng, _BOARD_TURN)
    )
    return msgspec.structs.replace(config, cameras=cameras, board=board)


def error(camera: CameraConfig, guess: Guess) -> Error:
    """Difference between a simulated camera and what is believed of it."""
    X = inverse(true_pose(camera)) @ guess.X_WC
    true, found = true_pinhole(camera), guess.pinhole
    return Error(
        position=float(np.linalg.norm(X[:3, 3])),
        rotation=angle_of(X[:3, :3]),
        focal=max(abs(found.fx / true.fx - 1), abs(found.fy / true.fy - 1)),
        centre=max(abs(found.cx - true.cx), abs(found.cy - true.cy)) / true.width,
    )


def _three(rng: np.random.Generator, sd: float) -> Vec3:
    x, y, z = rng.normal(0, sd, 3)
    return float(x), float(y), float(z)
