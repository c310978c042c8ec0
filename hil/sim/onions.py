"""Procedural onions: seeded shapes, skins and blemishes, with the truth about each.

The shape is an ellipsoid of revolution with a small neck, a root dent and slight waviness;
the skin a texture with streaks along the meridians. Blemishes are ragged dark blobs placed
uniformly over the surface, so that some can be seen from above and some only from below.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cell.frames import Array
from cell.settings import OnionConfig
from hil.sim.physics import bullet
from hil.sim.render.mesh import Mesh

TEXTURE_SHAPE = (128, 256)
"""Rows (south pole at row 127), columns (longitude) of a skin."""

_DENSITY = 950.0
"""Of onion flesh [kg/m^3]."""
_SLEEP = 0.01
"""Onions slower than this for two seconds sleep until something touches them (Bullet's measure)."""
_AROUND, _DOWN = 40, 26
_SKINS = ((0.45, (198, 146, 82)), (0.30, (168, 112, 62)), (0.15, (126, 48, 66)), (0.10, (222, 206, 168)))
"""(share, RGB) of yellow, brown, red and white onions."""
_BLEMISHES = ((52, 34, 22), (28, 30, 26), (84, 80, 62))
"""RGB of rot, black mould and grey mould."""
_BLEMISH_RADIUS = (0.21, 0.44)
"""Angular radius of a blemish [rad] (12 to 25 degrees)."""


@dataclass(frozen=True, eq=False)
class Onion:
    """One onion in its own frame O: centre at the origin, neck along +z.

    Attributes:
        mesh: the skin's surface, with texture coordinates.
        texture: shape (128, 256, 4) uint8, RGB and mark (255 where blemished).
        blemished: the truth.
        radius, height: largest half-width across and along the axis [m].
        mass: [kg].
        blemishes: (direction (3,) unit vector in O, angular radius [rad]) of each blob.
    """

    mesh: Mesh
    texture: NDArray[np.uint8]
    blemished: bool
    radius: float
    height: float
    mass: float
    blemishes: tuple[tuple[tuple[float, float, float], float], ...]

    @property
    def collision_radius(self) -> float:
        """Radius [m] of the sphere that stands for the onion in the physics.

        A sphere has one exact contact with a flat finger; convex hulls of nearly the same shape
        gave contradictory contacts by which onions clung to opening fingers.
        """
        return (2 * self.radius + self.height) / 3


def make_onion(rng: np.random.Generator, config: OnionConfig, index: int) -> Onion:
    """Draw the next onion from `rng`.

    Args:
        rng: the only source of randomness.
        config: sizes and the share of blemished onions.
        index: of the onion in its batch; every onion uses its own stream of `rng`'s numbers,
            so that changing one does not change the others.
    """
    rng = np.random.default_rng([index, int(rng.integers(2**63))])
    radius = float(rng.uniform(*config.diameter)) / 2
    height = radius * float(rng.uniform(0.93, 1.0))
    mesh = _mesh(rng, radius, height)
    blemished = bool(rng.random() < config.blemished_share)
    blemishes = _place_blemishes(rng) if blemished else ()
    return Onion(
        mesh=mesh,
        texture=_skin(rng, blemishes),
        blemished=blemished,
        radius=radius,
        height=height,
        mass=_DENSITY * 4 / 3 * np.pi * radius**2 * height,
        blemishes=blemishes,
    )


def onion_body(client: int, mass: float, radius: float, visual: int = -1) -> int:
    """A body that rolls, slides and is gripped like an onion; a metre above the base, to be put somewhere.

    Args:
        mass: [kg]. radius: of its sphere [m]. visual: PyBullet visual shape, -1: none.
    """
    shape = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=radius, physicsClientId=client)
    body: int = bullet.createMultiBody(mass, shape, visual, [0, 0, 1], physicsClientId=client)
    bullet.changeDynamics(
        body, -1, lateralFriction=0.8, rollingFriction=0.006, spinningFriction=0.004,
        linearDamping=0.02, angularDamping=0.1,
        activationState=bullet.ACTIVATION_STATE_ENABLE_SLEEPING, sleepThreshold=_SLEEP,
        physicsClientId=client,
    )  # fmt: skip
    return body


def _mesh(rng: np.random.Generator, radius: float, height: float) -> Mesh:
    theta = np.linspace(0, np.pi, _DOWN + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, _AROUND + 1)[None, :]
    neck = rng.uniform(0.05, 0.10) * np.exp(-((theta / 0.30) ** 2))
    root = rng.uniform(0.03, 0.06) * np.exp(-(((np.pi - theta) / 0.22) ** 2))
    lobes, phase = int(rng.integers(2, 5)), rng.uniform(0, 2 * np.pi)
    wave = 0.018 * np.sin(lobes * phi + phase) * np.sin(theta) ** 2
    along, across = 1 + neck - root, 1 + wave
    x = radius * across * np.sin(theta) * np.cos(phi)
    y = radius * across * np.sin(theta) * np.sin(phi)
    z = np.broadcast_to(height * along * np.cos(theta), x.shape)
    u = np.broadcast_to(phi / (2 * np.pi), x.shape)
    v = np.broadcast_to(1 - theta / np.pi, x.shape)
    columns = _AROUND + 1
    i, j = np.meshgrid(np.arange(_DOWN), np.arange(_AROUND), indexing="ij")
    a = (i * columns + j).ravel()
    b, c, d = a + 1, a + columns, a + columns + 1
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    gradient = vertices / np.array([radius, radius, height]) ** 2
    normals = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    return Mesh.of(vertices, faces, normals, np.stack([u, v], axis=-1).reshape(-1, 2))


def _place_blemishes(
    rng: np.random.Generator,
) -> tuple[tuple[tuple[float, float, float], float], ...]:
    blobs = []
    for _ in range(int(rng.integers(1, 4))):
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        blobs.append(((float(d[0]), float(d[1]), float(d[2])), float(rng.uniform(*_BLEMISH_RADIUS))))
    return tuple(blobs)


@lru_cache(maxsize=1)
def _directions() -> Array:
    """Unit vector of every texel, shape (128, 256, 3); row 0 is v = 1, the neck."""
    rows, columns = TEXTURE_SHAPE
    theta = (np.arange(rows) + 0.5)[:, None] / rows * np.pi
    phi = (np.arange(columns) + 0.5)[None, :] / columns * 2 * np.pi
    out: Array = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) * np.ones_like(phi)], axis=-1
    )
    return out


def _noise(rng: np.random.Generator, octaves: int = 4) -> Array:
    """Fractal noise over the texture, wrapping in longitude, standard deviation about 1."""
    import cv2

    rows, columns = TEXTURE_SHAPE
    total = np.zeros(TEXTURE_SHAPE)
    for octave in range(octaves):
        cells = 4 * 2**octave
        coarse = rng.normal(size=(cells // 2 + 1, cells)).astype(np.float32)
        coarse = np.concatenate([coarse, coarse[:, :2]], axis=1)
        wide = columns + round(columns * 2 / cells)
        fine = np.asarray(cv2.resize(coarse, (wide, rows), interpolation=cv2.INTER_CUBIC), float)
        total += fine[:, :columns] / 1.6**octave
    out: Array = total / total.std()
    return out


def _skin(
    rng: np.random.Generator, blemishes: tuple[tuple[tuple[float, float, float], float], ...]
) -> NDArray[np.uint8]:
    rows, columns = TEXTURE_SHAPE
    shares = np.array([share for share, _ in _SKINS])
    base = np.array(_SKINS[int(rng.choice(len(_SKINS), p=shares / shares.sum()))][1], float)
    base = base + rng.normal(0, 10, 3)
    image = np.tile(base, (rows, columns, 1))
    image += 9.0 * _noise(rng)[:, :, None]
    streaks = rng.normal(size=columns)
    streaks = streaks + np.roll(streaks, 1) + np.roll(streaks, 2)
    image += 5.0 * streaks[None, :, None] * np.array([1.0, 0.9, 0.6])
    theta = (np.arange(rows) + 0.5) / rows * np.pi
    poles = 0.22 * (np.exp(-((theta / 0.3) ** 2)) + np.exp(-(((np.pi - theta) / 0.25) ** 2)))
    image *= (1 - poles)[:, None, None]
    if rng.random() < 0.5:
        _flake(rng, image)
    mark = np.zeros(TEXTURE_SHAPE, bool)
    for direction, angle in blemishes:
        mark |= _blemish(rng, image, np.array(direction), angle)
    out = np.empty((rows, columns, 4), np.uint8)
    out[:, :, :3] = np.clip(image, 0, 255)
    out[:, :, 3] = np.where(mark, 255, 0)
    return out


def _flake(rng: np.random.Generator, image: Array) -> None:
    """A loose piece of dry skin: paler, harmless, there to be told apart from a blemish."""
    d = rng.normal(size=3)
    edge = np.arccos(np.clip(_directions() @ (d / np.linalg.norm(d)), -1, 1)) - 0.1 * _noise(rng)
    inside = edge < rng.uniform(0.2, 0.5)
    image[inside] += (np.array([235.0, 215.0, 180.0]) - image[inside]) * 0.35


def _blemish(rng: np.random.Generator, image: Array, direction: Array, angle: float) -> NDArray[np.bool_]:
    """Paint one blob; returns the texels that it clearly covers."""
    edge = np.arccos(np.clip(_directions() @ direction, -1, 1)) - 0.05 * _noise(rng)
    colour = np.array(_BLEMISHES[int(rng.integers(len(_BLEMISHES)))], float) + rng.normal(0, 8, 3)
    opacity = 0.93 * np.clip((angle - edge) / 0.05, 0, 1)[:, :, None]
    image *= 1 - opacity
    image += opacity * (colour + 7.0 * _noise(rng)[:, :, None])
    return np.asarray(edge < angle - 0.02)
