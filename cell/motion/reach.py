"""The check of a cell's geometry: can the arm get to every place that sorting needs?

Runs when a cell is loaded, so that an impossible layout is a sentence before the round begins
and not a failed plan in the middle of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from cell.config import CellConfig
from cell.errors import ConfigError
from cell.frames import Array, pose, rot_x, rot_z
from cell.motion.collision import CollisionModel
from cell.motion.kinematics import Kinematics
from cell.motion.planner import DROP_YAWS, drop_place
from cell.motion.views import InspectionViews

_GRID = (4, 7)
"""Places checked across and along the pick window, edges and corners included."""
_YAWS = (0.0, np.pi / 4, np.pi / 2, -np.pi / 4)
_FINGERTIP_GAP = 0.017
"""The lowest grasp: fingertips reach 11 mm beyond the TCP and stay 6 mm off the belt [m]."""


def check_reachable(config: CellConfig) -> None:
    """Check home, the drop pose, every grasp and hover pose of the pick window, and the inspection views.

    Raises:
        ConfigError: names the configuration key and the first pose that cannot be had.
    """
    kinematics, model = Kinematics(config), CollisionModel(config)
    home = np.array(config.arm.home)
    least = config.motion.clearance
    gap, pair = model.nearest(home)
    if gap < least:
        raise ConfigError(
            f"arm.home: the arm would be {1000 * gap:.0f} mm from touching ({pair}); choose another home"
        )
    _check_drop(config, kinematics, model, home)
    for key, X_WT in _window(config):
        solutions = kinematics.ik(X_WT, home)
        x, y, z = X_WT[:3, 3]
        if not solutions:
            raise ConfigError(
                f"{key} at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of reach of the UR3e; "
                "shrink the pick window or move the belt"
            )
        clear = model.clearance(np.array(solutions), touching=True)
        if clear.max() < least:
            _, pair = model.nearest(solutions[int(np.argmax(clear))], touching=True)
            raise ConfigError(
                f"{key} at ({x:.3f}, {y:.3f}, {z:.3f}) m is in reach only by touching something "
                f"({pair}); shrink the pick window or move what is in the way"
            )
    InspectionViews(config)  # raises when there are none


def _window(config: CellConfig) -> Iterator[tuple[str, Array]]:
    """Configuration key with the pose's name, and the pose, of each grasp and hover."""
    b, motion = config.belt, config.motion
    small, large = (d / 2 for d in config.onions.diameter)
    where = "belt.pick_x, belt.pick_y: the"
    grasps = [(f"{where} grasp", h) for h in sorted({max(small, _FINGERTIP_GAP), large})]
    for x in np.linspace(*b.pick_x, _GRID[0]):
        for y in np.linspace(*b.pick_y, _GRID[1]):
            for yaw in _YAWS:
                for key, height in [*grasps, (f"{where} hover pose", large + motion.hover)]:
                    yield key, pose(rot_z(yaw) @ rot_x(np.pi), (x, y, b.top_z + height))


def _check_drop(config: CellConfig, kinematics: Kinematics, model: CollisionModel, home: Array) -> None:
    x, y, z = drop_place(config.bin, 0)
    spread = config.bin.drop_spread
    if spread > 0.5 * min(config.bin.size[:2]) - 0.5 * config.onions.diameter[1]:
        raise ConfigError(f"bin.drop_spread: onions let go {spread:g} m off the centre hit the bin's wall")
    for dx, dy in [(0.0, 0.0), *itertools.product((-spread, spread), repeat=2)]:
        _check_drop_at((x + dx, y + dy, z), config, kinematics, model, home)


def _check_drop_at(
    p_WT: tuple[float, float, float],
    config: CellConfig,
    kinematics: Kinematics,
    model: CollisionModel,
    home: Array,
) -> None:
    best, solutions = -np.inf, 0
    pair = ""
    for yaw in DROP_YAWS:
        for q in kinematics.ik(pose(rot_z(yaw) @ rot_x(np.pi), p_WT), home):
            solutions += 1
            gap, near = model.nearest(q, held_radius=config.onions.diameter[1] / 2)
            if gap > best:
                best, pair = gap, near
    x, y, z = p_WT
    if not solutions:
        raise ConfigError(
            f"bin.center: the drop pose at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of reach of the UR3e; "
            "move the bin nearer to the robot"
        )
    if best < config.motion.clearance:
        raise ConfigError(
            f"bin.center: the drop pose at ({x:.3f}, {y:.3f}, {z:.3f}) m is in reach only by touching "
            f"something ({pair}); move the bin, raise bin.drop_height, or lower bin.drop_spread"
        )
