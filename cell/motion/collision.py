"""Distances between the arm and the fixed cell, and between its own parts.

The arm, the gripper and a held onion are rows of spheres that enclose capsules with the
published link radii; the cell is made of boxes and posts. Everything is vectorised over
configurations: a path of 60 of them takes about two milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cell.cameras import camera_pose
from cell.config import CellConfig
from cell.frames import Array
from cell.limits import DH_A, DH_D, link_frames

_SHOULDER_OFFSET, _ELBOW_OFFSET = 0.120, 0.027
"""Distances of the upper arm and the forearm from the plane of joints 2 and 3 [m]."""
_FINGER_TIP, _FINGER_ROOT, _FINGER_OUT, _FINGER_RADIUS = 0.011, -0.047, 0.007, 0.012
"""Fingers along z of the TCP frame, and their middle outside the pads [m]."""
_PALM_BACK, _PALM_FRONT, _BAR_HALF = -0.163, -0.074, 0.058
_WALL = 0.006
POST_RADIUS, CAMERA_RADIUS = 0.02, 0.06
_POST_BEHIND = 0.0645
"""A camera's post stands this far behind its optical centre [m]."""
TOUCH = 0.002
"""Least distance of the fingertips from the belt where they may come near it [m]."""
_FAR = 10.0
_PEDESTAL = 0.10

_PRODUCE, _ROLLED = "onions", 0.05
"""The layer in which onions may lie, this far beyond the pick window too [m]."""

_BOLTED = ("base", "shoulder")
"""What never meets furniture; it turns on the spot. These come first among the spheres."""
_TOOL = ("hand", "finger", "onion", "board")
_SELF = (
    (("base", "shoulder", "upper arm"), ("wrist", *_TOOL), "tool and upper arm or base"),
    (("elbow", "forearm"), _TOOL, "tool and forearm"),
)
"""Parts of the arm that can meet each other, and what to call such a pair."""


@dataclass(frozen=True)
class _Capsule:
    """A row of spheres rigid in frame `frame` (0 world, 1..6 links, 7 TCP), from a to b [m]."""

    name: str
    frame: int
    a: tuple[float, float, float]
    b: tuple[float, float, float]
    radius: float
    count: int


_ARM = (
    _Capsule("base", 0, (0, 0, 0), (0, 0, 0.038), 0.075, 3),
    _Capsule("shoulder", 0, (0, 0, 0.038), (0, 0, DH_D[0]), 0.063, 5),
    _Capsule("shoulder", 1, (0, 0, 0), (0, 0, _SHOULDER_OFFSET), 0.060, 4),
    _Capsule("upper arm", 2, (-DH_A[1], 0, _SHOULDER_OFFSET), (0, 0, _SHOULDER_OFFSET), 0.054, 8),
    _Capsule("elbow", 2, (0, 0, _SHOULDER_OFFSET), (0, 0, _ELBOW_OFFSET), 0.058, 4),
    _Capsule("forearm", 3, (-DH_A[2], 0, _ELBOW_OFFSET), (0, 0, _ELBOW_OFFSET), 0.040, 9),
    _Capsule("wrist", 3, (0, 0, _ELBOW_OFFSET), (0, 0, DH_D[3]), 0.045, 5),
    _Capsule("wrist", 4, (0, 0, 0), (0, 0, DH_D[4]), 0.045, 4),
    _Capsule("hand", 5, (0, 0, 0), (0, 0, DH_D[5]), 0.042, 4),
    _Capsule("hand", 7, (0, 0, _PALM_BACK), (0, 0, _PALM_FRONT - 0.03), 0.040, 4),
    _Capsule("hand", 7, (-_BAR_HALF, 0, _PALM_FRONT), (_BAR_HALF, 0, _PALM_FRONT), 0.017, 9),
)
"""Everything but the fingers, which move, and the held onion."""


class CollisionModel:
    """Clearances of the arm in one cell.

    Args:
        carried: spheres (S, 4) (centre, radius) [m] in the TCP frame, of something rigid in the gripper.
    """

    def __init__(self, config: CellConfig, carried: Array | None = None) -> None:
        rows = [] if carried is None else carried.tolist()
        self._carried = tuple((x, y, z, r) for x, y, z, r in rows)
        self._length = config.gripper.length
        self._stroke = config.gripper.stroke
        self._credit = config.motion.clearance - TOUCH
        boxes, self._low, self._high = _boxes(config)
        self._belt = np.array([name == "belt" for name in boxes])
        self._layer = boxes.index(_PRODUCE)
        eyes = [camera_pose(c) for c in config.cameras.values()]
        self._cameras = np.array([X[:3, 3] for X in eyes])
        self._posts = np.array([X[:3, 3] - _POST_BEHIND * X[:3, 2] for X in eyes])
        count = len(eyes)
        self._things = [*boxes, *["camera"] * count, *["camera post"] * count]
        self._padding = np.array([0.0] * len(boxes) + [CAMERA_RADIUS] * count + [POST_RADIUS] * count)

    def clearance(
        self,
        q: Array,
        *,
        width: float | None = None,
        held_radius: float = 0.0,
        touching: bool = False,
        flying: bool = False,
    ) -> Array:
        """Least distance of arm, gripper and held onion to anything, shape (N,) [m].

        Args:
            q: joint angles (N, 6) [rad].
            width: distance between the pads [m]; the full stroke if not given.
            held_radius: radius of an onion held at the TCP [m], 0 for none.
            touching: the tool approaches or leaves the belt on purpose. The held onion may then
                lie on the belt, and fingertips count as `motion.clearance` away when they are
                2 mm from it.
            flying: the tool must also stay above the layer in which onions lie.
        """
        gaps, _ = self._gaps(np.atleast_2d(q), width, held_radius, touching, flying)
        out: Array = gaps.min(axis=1)
        return out

    def nearest(
        self,
        q: Array,
        *,
        width: float | None = None,
        held_radius: float = 0.0,
        touching: bool = False,
        flying: bool = False,
    ) -> tuple[float, str]:
        """The least clearance [m] over configurations (N, 6) or (6,), and which two parts it is between."""
        gaps, pairs = self._gaps(np.atleast_2d(q), width, held_radius, touching, flying)
        least = gaps.min(axis=0)
        worst = int(np.argmin(least))
        return float(least[worst]), pairs[worst]

    def hides(
        self, q: Array, p_WC: Array, p_WP: Array, *, radius: float, tool: bool = True
    ) -> NDArray[np.bool_]:
        """Which points the arm hides from a camera, shape (N, M).

        Args:
            q: joint angles (N, 6) [rad]. p_WC: the camera (3,) [m]. p_WP: points (M, 3) [m].
            radius: of the thing at each point that must be seen whole [m].
            tool: the gripper hides things too.
        """
        p, r, names = self.spheres(np.atleast_2d(q))
        if not tool:
            arm = [name not in _TOOL for name in names]
            p, r = p[:, arm], r[arm]
        ray = np.atleast_2d(p_WP) - p_WC
        length = np.linalg.norm(ray, axis=1)
        ray = ray / length[:, None]
        offset = p - p_WC
        along = np.einsum("nsj,mj->nsm", offset, ray)
        across2 = np.einsum("nsj,nsj->ns", offset, offset)[:, :, None] - along**2
        near = np.clip(along / length, 0, 1) * radius  # the cone of sight narrows to the camera
        hit = (along > 0) & (along < length - radius) & (across2 < (r[None, :, None] + near) ** 2)
        out: NDArray[np.bool_] = hit.any(axis=1)
        return out

    def spheres(
        self, q: Array, *, width: float | None = None, held_radius: float = 0.0
    ) -> tuple[Array, Array, tuple[str, ...]]:
        """Sphere centres (N, S, 3) [m], radii (S,) [m] and part names for configurations (N, 6)."""
        body = _body(self._length, self._stroke if width is None else width, held_radius, self._carried)
        X = link_frames(q)
        X = np.concatenate([np.tile(np.eye(4), (len(X), 1, 1, 1)), X], axis=1)[:, body.frames]
        centres: Array = (X[..., :3, :3] @ body.local[:, :, None])[..., 0] + X[..., :3, 3]
        return centres, body.radii, body.names

    def _gaps(
        self, q: Array, width: float | None, held_radius: float, touching: bool, flying: bool
    ) -> tuple[Array, list[str]]:
        """Distances (N, P) [m] of the pairs of things that can touch, and the pairs' names."""
        p, r, names = self.spheres(q, width=width, held_radius=held_radius)
        first, parts, starts = _furnished(names)
        # Axes first, so that each step works on one large block: (things, N, spheres).
        x = np.ascontiguousarray(p[:, first:].transpose(2, 0, 1))
        boxes = np.zeros((len(self._low), *x.shape[1:]))
        for axis in range(3):
            low, high = self._low[:, axis, None, None], self._high[:, axis, None, None]
            outside = np.maximum(low - x[axis], x[axis] - high)
            np.maximum(outside, 0.0, out=outside)
            boxes += outside * outside
        away = x[:, None] - self._cameras.T[:, :, None, None]
        aside = x[:2, None] - self._posts.T[:2, :, None, None]
        apart = np.sqrt(np.concatenate([boxes, (away * away).sum(axis=0), (aside * aside).sum(axis=0)]))
        gap = apart - self._padding[:, None, None] - r[first:]
        gap[-len(self._posts) :][x[2] > self._cameras[:, 2, None, None]] = _FAR  # above the post
        least = np.minimum.reduceat(gap, starts, axis=2)
        for part, bonus in (("finger", self._credit), ("onion", _FAR)):
            if touching and part in parts:
                least[: len(self._belt)][self._belt, :, parts.index(part)] += bonus
        for k, part in enumerate(parts):
            if not flying or part not in _TOOL:
                least[self._layer, :, k] = _FAR
        out = [least.transpose(1, 2, 0).reshape(len(p), -1)]
        pairs = [f"{part} and {thing}" for part in parts for thing in self._things]
        for these, those, pair in _SELF:
            i, j = _where(names, these), _where(names, those)
            between = p[:, i, None] - p[:, None, j]
            distance = np.sqrt(np.einsum("nabj,nabj->nab", between, between))
            out.append((distance - r[i][:, None] - r[j]).min(axis=(1, 2))[:, None])
            pairs.append(pair)
        return np.concatenate(out, axis=1), pairs


@dataclass(frozen=True)
class _Body:
    """Centres (S, 3) in their frames [m], radii (S,) [m], frame indices (S,) and names."""

    local: Array
    radii: Array
    frames: NDArray[np.intp]
    names: tuple[str, ...]


@lru_cache(maxsize=64)
def _body(
    gripper_length: float,
    width: float,
    held_radius: float,
    carried: tuple[tuple[float, float, float, float], ...] = (),
) -> _Body:
    out, tip = width / 2 + _FINGER_OUT, _FINGER_TIP - 1.05 * _FINGER_RADIUS
    capsules = [
        *_ARM,
        *(_Capsule("finger", 7, (x, 0, tip), (x, 0, _FINGER_ROOT), _FINGER_RADIUS, 6) for x in (-out, out)),
    ]
    if held_radius > 0.0:
        capsules.append(_Capsule("onion", 7, (0, 0, 0), (0, 0, 0), held_radius, 1))
    capsules += [_Capsule("board", 7, (x, y, z), (x, y, z), r, 1) for x, y, z, r in carried]
    centres: list[Array] = []
    radii: list[float] = []
    frames: list[int] = []
    names: list[str] = []
    for c in capsules:
        a, b = np.array(c.a, float), np.array(c.b, float)
        if c.frame == 7:
            tool = np.array([0.0, 0.0, gripper_length])
            a, b = a + tool, b + tool
        step = float(np.linalg.norm(b - a)) / max(c.count - 1, 1)
        for w in np.linspace(0.0, 1.0, c.count):
            centres.append((1 - w) * a + w * b)
            radii.append(float(np.hypot(c.radius, step / 2)))  # the row encloses the capsule's side
            frames.append(min(c.frame, 6))
            names.append(c.name)
    return _Body(np.array(centres), np.array(radii), np.array(frames), tuple(names))


@lru_cache(maxsize=64)
def _furnished(names: tuple[str, ...]) -> tuple[int, list[str], NDArray[np.intp]]:
    """What can meet furniture: its first sphere, the parts' names, where each starts from there."""
    first = next(i for i, name in enumerate(names) if name not in _BOLTED)
    parts = list(dict.fromkeys(names[first:]))
    return first, parts, np.array([names[first:].index(part) for part in parts])


@lru_cache(maxsize=64)
def _where(names: tuple[str, ...], wanted: tuple[str, ...]) -> NDArray[np.intp]:
    return np.flatnonzero([name in wanted for name in names])


def _boxes(config: CellConfig) -> tuple[list[str], Array, Array]:
    """Names of the cell's boxes and their corners, low and high, shape (B, 3) [m]."""
    b, c = config.belt, config.bin
    (cx, cy, top), (sx, sy, depth) = c.center, c.size
    x0, x1, y0, y1, z0 = cx - sx / 2, cx + sx / 2, cy - sy / 2, cy + sy / 2, top - depth
    boxes = [
        ("belt", (b.x[0] - 0.018, b.y[0], b.top_z - 0.13), (b.x[1] + 0.018, b.y[1], b.top_z)),
        ("bin", (x0 - _WALL, y0 - _WALL, z0), (x0, y1 + _WALL, top)),
        ("bin", (x1, y0 - _WALL, z0), (x1 + _WALL, y1 + _WALL, top)),
        ("bin", (x0, y0 - _WALL, z0), (x1, y0, top)),
        ("bin", (x0, y1, z0), (x1, y1 + _WALL, top)),
        ("bin", (x0, y0 - _WALL, z0 - _WALL), (x1, y1 + _WALL, z0)),
        ("pedestal", (-_PEDESTAL, -_PEDESTAL, config.floor_z), (_PEDESTAL, _PEDESTAL, -0.002)),
        ("floor", (-5.0, -5.0, -2.0), (5.0, 5.0, config.floor_z)),
        (
            _PRODUCE,
            (b.pick_x[0] - _ROLLED, b.pick_y[0] - _ROLLED, b.top_z),
            (b.pick_x[1] + _ROLLED, b.pick_y[1] + _ROLLED, b.top_z + config.onions.diameter[1]),
        ),
    ]
    return (
        [n for n, _, _ in boxes],
        np.array([lo for _, lo, _ in boxes]),
        np.array([hi for _, _, hi in boxes]),
    )
