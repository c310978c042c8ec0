"""Arm poses that turn the hidden sides of a held onion to the belt camera.

The tool is held with its axis tilted towards the camera, so that the onion's underside shows,
and is then turned about that axis by the last wrist joint, so that every side passes by. The
poses are searched once per cell, deterministically, for what they show and for little motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cell.config import CellConfig
from cell.errors import ConfigError
from cell.frames import Array, Pinhole, look_at, pose
from cell.limits import QD_MAX, tcp_positions
from cell.motion.planner import Planner

SEEN_WITHIN = np.radians(70.0)
"""A patch counts as seen when its normal is within this angle of the direction to the camera."""
_RADIUS = 0.035
_IMAGE_MARGIN = 60.0
_DISTANCE = (0.40, 0.66)
_TILTS = np.radians([70.0, 62.0, 54.0, 46.0])
"""Angles between the tool's axis and the direction to the camera; the first in reach is used."""
_FINGER_BOXES = (
    ((_RADIUS, -0.011, -0.047), (_RADIUS + 0.014, 0.011, 0.011)),
    ((-_RADIUS - 0.014, -0.011, -0.047), (-_RADIUS, 0.011, 0.011)),
    ((-0.065, -0.015, -0.163), (0.065, 0.015, -0.066)),
)
"""What of the gripper can hide the onion, in the TCP frame [m]."""
_PAD_HALF_ANGLE = np.radians(20.0)
"""Round the pads the onion cannot be seen in any pose of this grasp."""


@dataclass(frozen=True)
class View:
    """One inspection pose: joint angles q (6,) [rad] and TCP pose X_WT."""

    q: Array
    X_WT: Array


class InspectionViews:
    """The inspection poses of a cell.

    Attributes:
        views: in the order in which they are taken.
        coverage: share of the onion's surface, pads excepted, seen on the belt or in a view.

    Raises:
        ConfigError: no pose in reach shows a held onion to the belt camera.
    """

    def __init__(self, config: CellConfig) -> None:
        self._planner = Planner(config)
        camera = config.cameras["belt"]
        self._pinhole = Pinhole.from_hfov(camera.width, camera.height, camera.hfov)
        self._X_WC = look_at(camera.position, camera.target)
        normals = _sphere(400)
        self._visible = normals[np.abs(normals[:, 0]) < np.cos(_PAD_HALF_ANGLE)]
        belt = config.belt
        middle = np.array([np.mean(belt.pick_x), np.mean(belt.pick_y), belt.top_z + 0.15])
        self._speed, self._length = config.motion.collaborative_speed, config.gripper.length
        self._q_home = np.array(config.arm.home)
        self._q_start = self._planner.kinematics.ik_near(self._planner.grasp_pose(middle, 0.0), self._q_home)
        views = self._search(config)
        self.views: tuple[View, ...] = tuple(views)
        before = self._seen_on_belt(middle)
        seen = np.any([self._sees(v.X_WT) for v in views], axis=0)
        self.coverage = float(np.mean(np.where(seen, 1.0, before)))

    def _search(self, config: CellConfig) -> list[View]:
        """The quickest among the families of the best tilt that the arm can reach."""
        p_WC = self._X_WC[:3, 3]
        places = []
        for p_WT in _places(config):
            distance = float(np.linalg.norm(p_WC - p_WT))
            if _DISTANCE[0] <= distance <= _DISTANCE[1] and self._in_image(p_WT):
                places.append((p_WT, (p_WC - p_WT) / distance))
        for tilt in _TILTS:
            found: list[tuple[float, list[View]]] = []
            for p_WT, c in places:
                for axis in _axes(c, tilt):
                    views = self._family(p_WT, axis, c)
                    if views is not None:
                        found.append((self._time(views), views))
            if found:
                return min(found, key=lambda item: item[0])[1]
        raise ConfigError(
            "no inspection pose in reach shows a held onion to the belt camera; "
            "move cameras.belt.position nearer to the arm"
        )

    def _time(self, views: list[View]) -> float:
        """Rough time from a typical grasp through all views and on to belt or bin [s]."""
        v = [view.q for view in views]
        there = self._leg(self._q_start, v[0]) + sum(self._leg(a, b) for a, b in pairwise(v))
        return there + 0.5 * (self._leg(v[-1], self._q_start) + self._leg(v[-1], self._q_home))

    def _leg(self, a: Array, b: Array) -> float:
        """Rough time of a joint-space motion: limited by the tool's speed or by the joints [s]."""
        p = tcp_positions(a + np.linspace(0, 1, 8)[:, None] * (b - a), self._length)
        tool = float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum()) / self._speed
        return max(tool, float((np.abs(b - a) / QD_MAX).max())) + 0.3

    def _seen_on_belt(self, p_WO: Array) -> Array:
        """Probability that each patch was seen when the onion lay on the belt, over all yaws."""
        yaws = np.linspace(0, np.pi, 12, endpoint=False)
        c = self._X_WC[:3, 3] - p_WO
        c /= np.linalg.norm(c)
        seen = []
        for yaw in yaws:
            R_WT = self._planner.grasp_pose(p_WO, float(yaw))[:3, :3]
            seen.append(self._visible @ (R_WT.T @ c) > np.cos(SEEN_WITHIN))
        out: Array = np.mean(seen, axis=0)
        return out

    def _family(self, p_WT: Array, z_T: Array, c: Array) -> list[View] | None:
        """Three views round the axis `z_T`; None if the arm cannot reach or is in the way."""
        planner = self._planner
        across = c - (c @ z_T) * z_T
        across /= np.linalg.norm(across)
        views: list[View] = []
        near = self._q_start
        # The camera looks between the fingers first, then past one finger and past the other.
        for turn in np.radians([90.0, 90.0 - 120.0, 90.0 + 120.0])[[1, 0, 2]]:
            side = np.cross(z_T, across)
            x_T = np.cos(turn) * across - np.sin(turn) * side
            X_WT = pose(np.column_stack([x_T, np.cross(z_T, x_T), z_T]), p_WT)
            options = planner.kinematics.ik(X_WT, near)
            q = next((q for q in options if self._clear(q, p_WT)), None)
            if q is None:
                return None
            views.append(View(q, X_WT))
            near = q
        return views

    def _clear(self, q: Array, p_WT: Array) -> bool:
        model = self._planner.collision
        if model.clearance(q[None], width=2 * _RADIUS, held_radius=0.04)[0] < 0.02:
            return False
        p, r, names = model.spheres(q[None], width=2 * _RADIUS)
        p_WC = self._X_WC[:3, 3]
        ray = p_WT - p_WC
        length = float(np.linalg.norm(ray))
        ray /= length
        for centre, radius, name in zip(p[0], r, names, strict=True):
            if name in ("finger", "hand"):
                continue  # what the gripper hides is counted patch by patch
            along = float((centre - p_WC) @ ray)
            across = float(np.linalg.norm(centre - p_WC - along * ray))
            if 0 < along < length and across < radius + 0.035:
                return False
        return True

    def _sees(self, X_WT: Array) -> Array:
        """Which patches of the onion the camera sees, shape (M,) bool."""
        p_TC = X_WT[:3, :3].T @ (self._X_WC[:3, 3] - X_WT[:3, 3])
        p = _RADIUS * self._visible
        ray = p_TC - p
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        facing = np.einsum("ij,ij->i", ray, self._visible) > np.cos(SEEN_WITHIN)
        hidden = np.zeros(len(p), bool)
        for lo, hi in _FINGER_BOXES:
            hidden |= _hits_box(p, ray, np.array(lo), np.array(hi))
        out: Array = facing & ~hidden
        return out

    def _in_image(self, p_W: Array) -> bool:
        p_C = self._X_WC[:3, :3].T @ (p_W - self._X_WC[:3, 3])
        if p_C[2] <= 0:
            return False
        u, v = self._pinhole.project(p_C)
        m = _IMAGE_MARGIN
        return bool(m <= u <= self._pinhole.width - m and m <= v <= self._pinhole.height - m)


def _places(config: CellConfig) -> list[Array]:
    """Places (3,) [m] where the onion may be shown."""
    belt = config.belt
    xs = np.arange(belt.pick_x[0] - 0.05, belt.pick_x[1] + 0.001, 0.05)
    ys = np.arange(-0.25, 0.251, 0.05)
    zs = np.arange(belt.top_z + 0.15, belt.top_z + 0.46, 0.06)
    return [np.array([x, y, z]) for x in xs for y in ys for z in zs]


def _axes(c: Array, tilt: float) -> list[Array]:
    """Tool axes (3,) tilted by `tilt` [rad] from the direction `c` to the camera, all round."""
    u = np.cross(c, [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u)
    v = np.cross(c, u)
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    return [np.cos(tilt) * c + np.sin(tilt) * (np.cos(a) * u + np.sin(a) * v) for a in around]


def _hits_box(p: Array, ray: Array, lo: Array, hi: Array) -> Array:
    """Which rays from points p (M, 3) along unit vectors (M, 3) meet a box, shape (M,) bool."""
    inverse = 1.0 / np.where(np.abs(ray) < 1e-12, 1e-12, ray)
    a, b = (lo - p) * inverse, (hi - p) * inverse
    enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    out: Array = (leave > np.maximum(enter, 1e-6)) & (leave > 0)
    return out


def _sphere(count: int) -> Array:
    """Evenly spread unit vectors, shape (count, 3)."""
    k = np.arange(count) + 0.5
    z, a = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)
