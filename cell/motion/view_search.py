"""The search for inspection poses.

A view is given by where the camera stands in the TCP frame: its tilt from the tool's axis and
its azimuth about it. A few patterns of such directions show nearly all of an onion; the search
finds the place, the turn about the line of sight and the order with the least motion. All views
share one place, so between them the tool only turns, which no tool speed cap slows down.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice, pairwise, permutations

import numpy as np

from cell.cameras import camera_pinhole, camera_pose
from cell.config import CellConfig
from cell.errors import ConfigError, PlanError
from cell.frames import Array, pose
from cell.limits import Q_MAX, QD_MAX
from cell.motion.coverage import Onion
from cell.motion.planner import Planner

PATTERNS = (
    ((60, 30), (60, 210), (100, 120), (100, 300)),
    ((50, 30), (70, 210), (100, 120), (100, 300)),
    ((50, 150), (70, 330), (90, 60), (90, 240)),
    ((60, 30), (60, 210), (90, 120), (90, 300)),
    ((70, 30), (70, 120), (70, 210), (70, 300)),
    ((60, 30), (60, 120), (60, 210), (60, 300)),
)
"""Tilt and azimuth [deg] of the camera in the TCP frame per view: the best patterns of four on a
10 x 30 degree grid, found by trying all of them against `coverage.Onion`. Each may also be taken
half a turn further, which exchanges the fingers."""
_ENOUGH = 0.97
"""Among patterns that show this share of an onion, motion decides."""
RADIUS = 0.035
"""Of the onion that views are searched for [m]."""
_IMAGE_MARGIN = 60.0
_DISTANCE = (0.40, 0.65)
_CLEARANCE = 0.02
_TURNS = np.linspace(0, 2 * np.pi, 12, endpoint=False)
_PLANS_TRIED, _PLANS_COMPARED = 30, 4
_ACCELERATION = 7.0
"""Used for comparing motions [rad/s^2]."""


@dataclass(frozen=True)
class View:
    """One inspection pose: joint angles q (6,) [rad] and TCP pose X_WT (4, 4)."""

    q: Array
    X_WT: Array


@dataclass(frozen=True)
class _Plan:
    """Rough time [s] of the motions, and the arm poses (V, 6) [rad] in order."""

    cost: float
    q: Array


class ViewSearch:
    """The search for one cell, deterministic."""

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self._planner = Planner(config, thorough=False)
        camera = config.cameras["belt"]
        self._pinhole = camera_pinhole(camera)
        self._X_WC = camera_pose(camera)
        belt, home = config.belt, np.array(config.arm.home)
        hover = [
            self._planner.grasp_pose(np.array([x, y, belt.top_z + RADIUS + config.motion.hover]), 0.0)
            for x in np.linspace(*belt.pick_x, 3)
            for y in np.linspace(*belt.pick_y, 5)
        ]
        self._q_hover = np.array([self._planner.kinematics.ik_near(X, home) for X in hover])
        self._p_hover = np.array([X[:3, 3] for X in hover])
        self._onion = Onion(RADIUS)
        self._before = self._onion.seen_on_belt(config)
        self._near = self._q_hover[len(hover) // 2]

    def best(self) -> tuple[View, ...]:
        """The views with the least motion of the best pattern that can be had.

        Raises:
            ConfigError: no pattern can be had.
        """
        places = [(p, self._axes(p)) for p in self._places()]
        shows = {(k, half): self._shows(k, half) for k in range(len(PATTERNS)) for half in (0, 1)}
        good = [pattern for pattern, share in shows.items() if share >= _ENOUGH]
        rest = sorted(set(shows) - set(good), key=lambda pattern: -shows[pattern])
        for patterns in (good, *([pattern] for pattern in rest)):
            plans: list[_Plan] = []
            for k in sorted({k for k, _ in patterns}):
                halves = [half for j, half in patterns if j == k]
                for p, axes in places:
                    plans += self._plans(p, axes, PATTERNS[k], halves)
            ranked = sorted(plans, key=lambda plan: plan.cost)[:_PLANS_TRIED]
            possible = (true for plan in ranked if (true := self._planned(plan)) is not None)
            compared = list(islice(possible, _PLANS_COMPARED))
            if compared:
                best = min(compared, key=lambda plan: plan.cost)
                return tuple(View(q, self._planner.kinematics.X_WT(q)) for q in best.q)
        raise ConfigError(
            "no inspection pose in reach shows a held onion to the belt camera; "
            "move cameras.belt.position nearer to the arm"
        )

    def _shows(self, k: int, half: int) -> float:
        """Share of an onion that pattern k, half a turn further or not, and the view on the belt show."""
        seen = []
        for tilt, azimuth in np.radians(PATTERNS[k]):
            a = azimuth + np.pi * half
            c = np.array([np.sin(tilt) * np.cos(a), np.sin(tilt) * np.sin(a), np.cos(tilt)])
            seen.append(self._onion.seen_from(np.mean(_DISTANCE) * c))
        return float(np.where(np.any(seen, axis=0), 1.0, self._before).mean())

    def _places(self) -> list[Array]:
        """Places (3,) [m] in view of the camera and near the pick window, nearest first."""
        belt, p_WC = self._config.belt, self._X_WC[:3, 3]
        out = []
        for x in np.arange(belt.pick_x[0] - 0.10, belt.pick_x[1] + 0.001, 0.05):
            for y in np.arange(belt.pick_y[0], belt.pick_y[1] + 0.001, 0.06):
                for z in np.arange(belt.top_z + 0.17, belt.top_z + 0.55, 0.05):
                    p = np.array([x, y, z])
                    near, far = _DISTANCE
                    if near <= float(np.linalg.norm(p_WC - p)) <= far and self._in_image(p):
                        out.append(p)
        return sorted(out, key=lambda p: float(np.linalg.norm(self._p_hover - p, axis=1).mean()))[:40]

    def _axes(self, p_WT: Array) -> dict[int, Array]:
        """Per tilt [deg], arm poses (K, 6) [rad] that hold an onion at p_WT free and in sight.

        The last joint stands so that the camera's azimuth in the TCP frame is zero.
        """
        c = self._X_WC[:3, 3] - p_WT
        c /= np.linalg.norm(c)
        u = np.cross(c, [0.0, 0.0, 1.0])
        u /= np.linalg.norm(u)
        v = np.cross(c, u)
        out = {}
        for tilt in sorted({t for pattern in PATTERNS for t, _ in pattern}):
            angle, found = np.radians(tilt), []
            for turn in _TURNS:
                aside = np.cos(turn) * u + np.sin(turn) * v
                z_T = np.cos(angle) * c + np.sin(angle) * aside
                x_T = np.sin(angle) * c - np.cos(angle) * aside  # c lies in the plane of x and z
                X_WT = pose(np.column_stack([x_T, np.cross(z_T, x_T), z_T]), p_WT)
                q = self._planner.kinematics.ik(X_WT, self._near)
                found += [s for s in q if self._planner.kinematics.at_home_in(s)]
            out[tilt] = self._usable(np.array(found).reshape(-1, 6), p_WT)
        return out

    def _usable(self, q: Array, p_WT: Array) -> Array:
        """Those of the arm poses (K, 6) that touch nothing and do not hide the onion."""
        if not len(q):
            return q
        model = self._planner.collision
        clear = model.clearance(q, held_radius=self._config.onions.diameter[1] / 2) >= _CLEARANCE
        hidden = model.hides(q, self._X_WC[:3, 3], p_WT, radius=RADIUS, tool=False)[:, 0]
        return q[clear & ~hidden]

    def _plans(
        self, p_WT: Array, axes: dict[int, Array], pattern: tuple[tuple[int, int], ...], halves: list[int]
    ) -> list[_Plan]:
        """At most one plan at a place: the order and arm poses with the least motion."""
        steps = []
        for tilt, azimuth in pattern:
            q = axes[tilt].copy()
            if not len(q):
                return []
            q[:, 5] -= np.radians(azimuth)
            steps.append(q)
        ends = [self._transfer(p_WT, q[:, :5]) for q in steps]
        between = {
            (a, b): _turn_time(_shorter_way(steps[b][None] - steps[a][:, None]))
            for a, b in permutations(range(len(steps)), 2)
        }
        found = []
        for order in permutations(range(len(steps))):
            cost, chosen = ends[order[0]], []
            for a, b in pairwise(order):
                through = cost[:, None] + between[a, b]
                chosen.append(through.argmin(axis=0))
                cost = through.min(axis=0)
            picks = [int((cost + ends[order[-1]]).argmin())]
            for back in reversed(chosen):
                picks.append(int(back[picks[-1]]))
            poses = [steps[o][j] for o, j in zip(order, reversed(picks), strict=True)]
            found += self._turned(p_WT, np.array(poses), halves)
        return sorted(found, key=lambda plan: plan.cost)[:1]

    def _turned(self, p_WT: Array, q: Array, halves: list[int]) -> list[_Plan]:
        """Plans with the last joint taken round the shorter way from one view (row of q) to the next."""
        q[1:, 5] = q[0, 5] + np.cumsum(_shorter_way(np.diff(q, axis=0))[:, 5])
        turning = float(_turn_time(np.diff(q, axis=0)).sum())
        plans = []
        for half_turns in range(-4, 5):
            turned = q.copy()
            turned[:, 5] -= np.pi * half_turns
            if half_turns % 2 not in halves or np.abs(turned[:, 5]).max() > Q_MAX[5] - 0.2:
                continue
            cost = turning + float(self._transfer(p_WT, turned[[0, -1]]).sum())
            plans.append(_Plan(cost, turned))
        return plans

    def _transfer(self, p_WT: Array, q: Array) -> Array:
        """Rough mean time (K,) [s] between the pick window and the first J joints (K, J) at p_WT.

        The mean is over the window's places, and over both speed caps.
        """
        motion = self._config.motion
        way = np.linalg.norm(self._p_hover - p_WT, axis=1) / motion.speed_margin
        joints = _turn_time(q[:, None] - self._q_hover[:, : q.shape[1]])
        caps = (motion.collaborative_speed, motion.industrial_speed)
        out: Array = np.mean([np.maximum(way / cap, joints).mean(axis=1) for cap in caps], axis=0)
        return out

    def _planned(self, plan: _Plan) -> _Plan | None:
        """The plan with its true time; None if there is no way.

        From above the belt through all views, then half the time back there, half to the bin,
        which is on average reached from any of the views.
        """
        planner, radius = self._planner, self._config.onions.diameter[1] / 2
        speed = self._config.motion.collaborative_speed

        def time(a: Array, b: Array) -> float:
            return planner.plan_joints(a, b, speed, held_radius=radius).duration

        try:
            cost = sum(time(a, b) for a, b in pairwise([self._near, *plan.q]))
            to_bin = [
                planner.plan_to_pose(q, planner.drop_pose(q), speed, held_radius=radius).duration
                for q in plan.q
            ]
            return _Plan(cost + 0.5 * time(plan.q[-1], self._near) + 0.5 * float(np.mean(to_bin)), plan.q)
        except PlanError:
            return None

    def _in_image(self, p_W: Array) -> bool:
        p_C = self._X_WC[:3, :3].T @ (p_W - self._X_WC[:3, 3])
        if p_C[2] <= 0:
            return False
        u, v = self._pinhole.project(p_C)
        m = _IMAGE_MARGIN
        return bool(m <= u <= self._pinhole.width - m and m <= v <= self._pinhole.height - m)


def _shorter_way(dq: Array) -> Array:
    """Joint steps (..., 6) [rad] with whole turns of the last joint taken off."""
    dq = dq.copy()
    dq[..., 5] -= 2 * np.pi * np.round(dq[..., 5] / (2 * np.pi))
    return dq


def _turn_time(dq: Array) -> Array:
    """Rough time (...) [s] for steps (..., J) [rad] of the first J joints, from rest to rest."""
    dq, speed = np.abs(dq), QD_MAX[: dq.shape[-1]]
    ramp = speed**2 / _ACCELERATION
    time = np.where(dq < ramp, 2 * np.sqrt(dq / _ACCELERATION), dq / speed + speed / _ACCELERATION)
    out: Array = time.max(axis=-1)
    return out
