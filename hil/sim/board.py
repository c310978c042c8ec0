"""The calibration board between the finger pads, as the renderer draws it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.cameras import board_pose, board_size
from cell.frames import pose, rotation
from cell.settings import BoardConfig
from hil.sim.render.mesh import Mesh, box_mesh
from hil.sim.render.scene import Scene, Visual

LABEL = 9
THICKNESS = 0.003
"""[m]"""
_TEXELS = 64
"""Per square; a multiple of 32, so that halving the texture five times moves no corner."""
_WHITE: tuple[float, float, float, float] = (0.93, 0.93, 0.93, 1.0)


def add_board(scene: Scene, board: BoardConfig, robot: int, tcp_link: int) -> None:
    """Put the board between the finger pads of PyBullet's body `robot`.

    It has no collision shape: nothing pushes it, and the planner keeps it clear.
    """
    X_TB = board_pose(board) @ pose(rotation(board.turn), board.shift)
    width, height = board_size(board)
    back = pose(p=(0.0, 0.0, THICKNESS / 2 + 1e-4))
    plate = Visual(robot, tcp_link, X_TB @ back, box_mesh((width, height, THICKNESS)), _WHITE, None, LABEL)
    scene.add(plate)
    scene.add(Visual(robot, tcp_link, X_TB, _front(width, height), _WHITE, _texture(board), LABEL))


def _front(width: float, height: float) -> Mesh:
    """The printed face: two triangles seen from -z."""
    x, y = width / 2, height / 2
    vertices = [[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]
    uv = [[0, 1], [1, 1], [1, 0], [0, 0]]
    return Mesh.of(vertices, [[0, 2, 1], [0, 3, 2]], [[0, 0, -1.0]] * 4, uv)


def _texture(board: BoardConfig) -> NDArray[np.uint8]:
    """The pattern with its margin, shape (H, W, 4) uint8; nothing is marked."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
    charuco = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square, board.square * board.marker, dictionary
    )
    size = board.columns * _TEXELS, board.rows * _TEXELS
    grey = np.asarray(charuco.generateImage(size, marginSize=0, borderBits=1), np.uint8)
    margin = round(board.margin * _TEXELS)
    grey = np.pad(grey, margin, constant_values=255)
    return np.dstack([grey, grey, grey, np.zeros_like(grey)])
