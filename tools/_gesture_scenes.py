"""Random image sequences of a person who shows a sign, or works: for fitting and for scoring."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.config import load
from cell.frames import Array, Pinhole, look_at, pose, rot_x, rot_y, rot_z
from cell.settings import CameraConfig
from hil.sim.camera import sense, sense_depth
from hil.sim.person.body import Body, body_names
from hil.sim.person.hands import shape
from hil.sim.person.reach import Poser, hand_frame
from hil.sim.person.stance import Arm, Stance
from hil.sim.person.texture import SKINS, Look, paint
from hil.sim.render.gl import GlRenderer
from hil.sim.render.mesh import box_mesh, sphere_mesh
from hil.sim.render.renderer import Lighting
from hil.sim.render.scene import Scene, Visual

SIGNS = ("up", "down")
NEUTRAL = ("grip", "fist", "open", "relaxed", "reach")
RATE = 10.0
"""Images per second."""
_WOBBLE, _WOBBLE_TURN = 0.012, np.deg2rad(5.0)
"""Standard deviations of a held hand's place [m] and turn [rad]."""
_FLOOR, _BELT = -0.95, -0.15
_PERSON, _OTHER = 1, 2
_LEAST_SEEN = 0.8
"""Share of the hand's landmarks, and of its thumb's, that nothing else may hide in the first image;
half of the landmarks must have depth, without which nobody would look for a hand there, and nothing
of the person may be nearer to the camera than it can measure."""
_HIDDEN, _HIDDEN_THUMB = 0.09, 0.04
"""A landmark this far behind what the camera sees is hidden by something else than the hand [m]."""
_POSES, _VIEWS = 10, 6
"""How often another pose is drawn, and for each pose another viewpoint."""
_TILT, _EXTREME = np.deg2rad(30.0), 0.03
"""A sign has its thumb this near to the vertical, and the tip this far beyond the rest of the hand [m];
another pose is drawn otherwise."""
_ATTEMPTS = 60


@dataclass(frozen=True)
class Plan:
    """What a sequence shows.

    Attributes:
        seed: decides everything else. kind: of `SIGNS` or `NEUTRAL`. skin: index into `SKINS`.
        side: "L" or "R". frames: how many images.
    """

    seed: int
    kind: str
    skin: int
    side: str
    frames: int


def plans(count: int, kinds: tuple[str, ...], frames: int, first_seed: int) -> list[Plan]:
    """`count` sequences; kinds, hands and skins take turns, so that every combination comes up."""
    k = len(kinds)
    return [
        Plan(first_seed + i, kinds[i % k], (i // (2 * k)) % len(SKINS), "LR"[(i // k) % 2], frames)
        for i in range(count)
    ]


@dataclass(frozen=True, eq=False)
class View:
    """One image.

    Attributes:
        rgb, depth: as the camera reports them. landmarks: truth (21, 2) [px].
        distance: of the hand along the optical axis [m]. up_C: world up in the camera frame (3,).
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    landmarks: Array
    distance: float
    up_C: Array


@cache
def camera() -> tuple[CameraConfig, Pinhole]:
    """The person camera of the reference cell."""
    config = load().cameras["person"]
    return config, Pinhole.from_hfov(config.width, config.height, config.hfov)


@cache
def _client() -> tuple[int, int]:
    """A PyBullet client with one body that does not move; everything is drawn relative to it."""
    from hil.sim.physics import bullet

    client: int = bullet.connect(bullet.DIRECT)
    return client, bullet.createMultiBody(physicsClientId=client)


@cache
def _poser(name: str) -> Poser:
    return Poser(Body(name), _FLOOR)


def film(plan: Plan) -> Iterator[View]:
    """The images of a sequence, at `RATE`."""
    yield from _Take(plan).images()


class _Take:
    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._rng = rng = np.random.default_rng([0x6E57, plan.seed])
        self._poser = _poser(body_names()[rng.integers(len(body_names()))])
        self._motion: _Motion
        self._scene = Scene()
        self._config, self._pinhole = camera()
        mesh = self._poser.body.mesh
        shirt = [int(v) for v in rng.integers(20, 240, 3)]
        look = Look(
            SKINS[plan.skin],
            shirt=(shirt[0], shirt[1], shirt[2]),
            sleeve=float(rng.choice([0.0, 0.4, 0.7, 0.97])),
            seed=plan.seed,
        )
        anchor = _client()[1]
        self._body = self._scene.add(
            Visual(anchor, -1, np.eye(4), mesh, (1, 1, 1, 1), paint(self._poser.body, look), _PERSON)
        )
        self._onion: int | None = None
        self._furnish(anchor)
        self._light = Lighting(
            direction=(float(rng.normal()), float(rng.normal()) - 0.5, float(rng.uniform(0.6, 2.0))),
            ambient=float(rng.uniform(0.40, 0.65)),
            diffuse=float(rng.uniform(0.35, 0.75)),
            shadows=bool(rng.random() < 0.5),
        )
        self._gain = float(rng.uniform(0.85, 1.1))

    def images(self) -> Iterator[View]:
        renderer = GlRenderer(_client()[0], self._scene, self._light)
        X_WC = self._stage(renderer)
        rng = np.random.default_rng([0x5E45E, self._plan.seed])
        for i in range(self._plan.frames):
            marks = self._set(i)
            image = renderer.render(X_WC, self._pinhole, 0.05, 8.0)
            bright = np.clip(image.rgb * np.float32(self._gain), 0, 255).astype(np.uint8)
            rgb, depth = sense(replace(image, rgb=bright), self._config, rng)
            p_C = (marks - X_WC[:3, 3]) @ X_WC[:3, :3]
            yield View(rgb, depth, self._pinhole.project(p_C), float(p_C[:, 2].mean()), X_WC[2, :3].copy())
        renderer.close()

    def _set(self, i: int) -> Array:
        """Pose the body for image `i`; returns the hand's landmarks in the world (21, 3) [m]."""
        posed = self._poser.pose(self._motion.stance(i))
        vertices, normals = self._poser.body.skin(posed.G, posed.p)
        self._scene.set_vertices(self._body, vertices, normals)
        if self._onion is not None:
            ball = sphere_mesh(0.035)
            at = self._poser.grip(posed, self._plan.side).astype(np.float32)
            self._scene.set_vertices(self._onion, ball.vertices + at, ball.normals)
        return self._poser.landmarks(posed, self._plan.side)

    def _stage(self, renderer: GlRenderer) -> Array:
        """A pose, and a camera both of whose imagers see the hand: X_WC (4, 4).

        The camera is 0.5-1.2 m from the hand, to the person's left, 0-40 degrees up. Where the
        body hides the hand, another camera is drawn, then another pose.
        """
        best, best_seen = np.eye(4), -1.0
        for attempt in range(_POSES * _VIEWS):
            if best_seen >= _LEAST_SEEN:
                break
            if attempt % _VIEWS == 0:
                self._motion, best_seen = _Motion(self._plan, self._poser, self._rng), -1.0
                marks = self._set(0)
            X_WC = self._viewpoint(marks.mean(axis=0))
            seen = self._seen(renderer, X_WC, marks)
            if seen > best_seen:
                best, best_seen = X_WC, seen
        return best

    def _viewpoint(self, target: Array) -> Array:
        rng = self._rng
        distance = rng.uniform(0.5, 1.2)
        elevation, azimuth = np.deg2rad(rng.uniform(0, 40)), np.deg2rad(rng.uniform(-35, 35))
        flat = np.array([np.sin(azimuth), -np.cos(azimuth)]) * np.cos(elevation)
        away = distance * np.array([*flat, np.sin(elevation)])
        return look_at(target + away, target + rng.normal(0, 0.05, 3))

    def _seen(self, renderer: GlRenderer, X_WC: Array, marks: Array) -> float:
        """Least of three: share of the landmarks and of the thumb's that the camera sees, and
        share of the landmarks with depth, plus 0.3; 0 if the person is too near to be measured."""
        p_C = (marks - X_WC[:3, 3]) @ X_WC[:3, :3]
        uv = np.rint(self._pinhole.project(p_C)).astype(int)
        limits = self._pinhole.width - 1, self._pinhole.height - 1
        inside = ((uv >= 0) & (uv <= limits)).all(axis=1)
        u, v = np.clip(uv, 0, limits).T
        image = renderer.render(X_WC, self._pinhole, 0.05, 8.0)
        measured = sense_depth(image.depth, self._config, np.random.default_rng(0))[v, u] > 0.0
        if (image.labels == _PERSON)[image.depth < self._config.min_depth].any():
            return 0.0
        depth = image.depth[v, u]
        seen = inside & (depth > p_C[:, 2] - _HIDDEN)
        thumb = inside & (depth > p_C[:, 2] - _HIDDEN_THUMB)
        thumb_seen = thumb[2:5].mean() if self._plan.kind in SIGNS else 1.0
        return float(min(seen.mean(), thumb_seen, measured.mean() + 0.3))

    def _furnish(self, anchor: int) -> None:
        """Belt, floor, wall of any colour, onions on the belt and, for a grip, one in the hand."""
        rng, scene = self._rng, self._scene

        def box(lo: tuple[float, ...], hi: tuple[float, ...]) -> None:
            lo_, hi_ = np.array(lo), np.array(hi)
            skin = _noise(rng, rng.uniform(40, 215) + rng.normal(0, 30, 3))
            at = pose(p=(lo_ + hi_) / 2)
            scene.add(Visual(anchor, -1, at, box_mesh(hi_ - lo_), (1, 1, 1, 1), skin, _OTHER))

        front = 0.25
        box((-front - 0.5, -1.2, _BELT - 0.05), (-front, 1.2, _BELT))
        box((-4, -4, _FLOOR - 0.02), (4, 4, _FLOOR))
        box((-4, 3.0, _FLOOR), (4, 3.02, 2.0))
        for _ in range(rng.integers(2, 6)):
            at = pose(p=(-front - rng.uniform(0.05, 0.4), rng.uniform(-0.4, 0.4), _BELT + 0.035))
            scene.add(Visual(anchor, -1, at, sphere_mesh(0.035), _onion(rng), None, _OTHER))
        if self._plan.kind == "grip":
            self._onion = scene.add(
                Visual(anchor, -1, np.eye(4), sphere_mesh(0.035), _onion(rng), None, _OTHER)
            )


class _Motion:
    """How the body moves in a sequence; the person stands at the origin and looks along -x."""

    def __init__(self, plan: Plan, poser: Poser, rng: np.random.Generator) -> None:
        self._plan = plan
        n, out = plan.frames, 1.0 if plan.side == "L" else -1.0
        self._sway = np.column_stack([_wander(rng, n, _WOBBLE / np.sqrt(3)) for _ in range(3)])
        self._turn = np.column_stack([_wander(rng, n, _WOBBLE_TURN / np.sqrt(3)) for _ in range(3)])
        sloppy = np.deg2rad(5.0)
        sign = plan.kind in SIGNS
        name = "thumb" if sign else "relaxed" if plan.kind == "reach" else plan.kind
        first = shape(name, rng, sloppy)
        self._fingers = first, shape("grip", rng, sloppy) if plan.kind == "reach" else first
        lean, twist = np.deg2rad(rng.uniform(8, 25)), float(rng.normal(0, 0.08))
        hanging = {side: poser.hanging(side) for side in "LR"}
        stance = Stance(
            0.0, 0.0, np.pi, hanging["L"], hanging["R"], lean, twist, float(rng.uniform(0.1, 0.4))
        )
        for _ in range(_ATTEMPTS):
            # The thumb points down well only with the elbow out and the hand no lower than the belly.
            z = _BELT - _FLOOR + (rng.uniform(0.24, 0.50) if plan.kind == "down" else rng.uniform(0.14, 0.45))
            p = np.array([rng.uniform(0.34, 0.50), out * rng.uniform(0.08, 0.36), z])
            step = (
                rng.uniform([0.08, -0.1, -0.05], [0.16, 0.1, 0.05]) if plan.kind == "reach" else np.zeros(3)
            )
            self._ends = p - step, p + step
            self._R = _orientation(plan.kind, out, rng)
            self._stance = poser.best_swivel(stance.with_arm(plan.side, self._arm(0)), plan.side)
            self._swivel = self._stance.arm(plan.side).swivel
            if plan.kind == "down":
                self._swivel = float(np.deg2rad(rng.uniform(70, 130)))
            if not sign or self._is_sign(poser):
                break

    def _is_sign(self, poser: Poser) -> bool:
        marks = poser.landmarks(poser.pose(self.stance(0)), self._plan.side)
        up = 1.0 if self._plan.kind == "up" else -1.0
        thumb = marks[4] - marks[2]
        rest = np.delete(up * marks[:, 2], [2, 3, 4]).max()
        upright = up * thumb[2] >= np.cos(_TILT) * np.linalg.norm(thumb)
        return bool(upright and up * marks[4, 2] - rest >= _EXTREME)

    def stance(self, i: int) -> Stance:
        arm = replace(self._arm(i), swivel=self._swivel)
        return self._stance.with_arm(self._plan.side, arm)

    def _arm(self, i: int) -> Arm:
        w = 0.5 - 0.5 * np.cos(2 * np.pi * i / max(self._plan.frames - 1, 1))
        (p0, p1), (f0, f1) = self._ends, self._fingers
        a, b, c = self._turn[i]
        R = rot_z(a) @ rot_y(b) @ rot_x(c) @ self._R
        return Arm((1 - w) * p0 + w * p1 + self._sway[i], R, 0.0, (1 - w) * f0 + w * f1)


def _orientation(kind: str, out: float, rng: np.random.Generator) -> Array:
    """Of the hand in P (3, 3): a sign has the thumb vertical, other hands have their back up."""
    yaw, pitch, roll = np.deg2rad(rng.normal(0, [25, 8, 8]))
    if kind in SIGNS:
        thumb = 1.0 if kind == "up" else -1.0
        palm = np.array([0.0, -thumb * out, 0.0])
    else:
        palm = np.array([0.0, 0.0, -1.0])
        spread = {"fist": rng.uniform(-60, 60), "open": rng.uniform(-90, 90)}
        roll = np.deg2rad(spread.get(kind, rng.normal(0, 27)))
        pitch = np.deg2rad(rng.normal(15, 15))  # fingers downwards
    # The forearm comes from the shoulder: yaw leans to the other side of the body.
    return rot_z(0.5 * yaw - out * 0.15) @ rot_y(pitch) @ rot_x(roll) @ hand_frame((1.0, 0.0, 0.0), palm)


def _wander(rng: np.random.Generator, n: int, sd: float) -> Array:
    """Slow smooth motion (n,) with this standard deviation: three sines of 0.2 to 0.9 Hz."""
    t = np.arange(n)[:, None] / RATE
    waves = np.sin(2 * np.pi * rng.uniform(0.2, 0.9, 3) * t + rng.uniform(0, 2 * np.pi, 3))
    out: Array = sd * np.sqrt(2 / 3) * waves.sum(axis=1)
    return out


def _onion(rng: np.random.Generator) -> tuple[float, float, float, float]:
    r, g, b = np.clip(np.array([205, 135, 60]) + rng.normal(0, 12, 3), 0, 255) / 255
    return float(r), float(g), float(b), 1.0


def _noise(rng: np.random.Generator, base: Any, size: int = 256) -> NDArray[np.uint8]:
    """A blotchy texture (size, size, 4) round a colour."""
    out = np.zeros((size, size, 3)) + base
    for cells in (8, 32, 128):
        out += cv2.resize(rng.normal(0, 10, (cells, cells, 3)), (size, size), interpolation=cv2.INTER_CUBIC)
    return np.dstack([np.clip(out, 0, 255), np.zeros((size, size))]).astype(np.uint8)


__all__ = ["NEUTRAL", "RATE", "SIGNS", "Plan", "View", "camera", "film", "plans"]
