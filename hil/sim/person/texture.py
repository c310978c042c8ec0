"""Skin, hair and clothes, painted into a body's texture by where each texel lies on the body.

Edges of clothes follow positions, not triangles, so that a sleeve ends in a clean line.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.frames import Array
from hil.sim.person.body import Body

Rgb = tuple[int, int, int]
SIZE = 1024
_GRID = 14
"""Texels are found by so many steps along each side of a triangle."""

SKINS: tuple[Rgb, ...] = (
    (255, 224, 196), (241, 194, 160), (224, 172, 132), (198, 134, 96), (150, 98, 68), (110, 70, 50),
)  # fmt: skip
"""Skin tones, light to dark."""


@dataclass(frozen=True)
class Look:
    """Colours 0..255 and the sleeve's length as a share of the arm, 0 none to 1 to the wrist."""

    skin: Rgb = SKINS[1]
    hair: Rgb = (60, 42, 30)
    shirt: Rgb = (70, 110, 150)
    trousers: Rgb = (52, 56, 66)
    shoes: Rgb = (40, 36, 34)
    sleeve: float = 0.45
    seed: int = 0


def paint(body: Body, look: Look) -> NDArray[np.uint8]:
    """Texture (SIZE, SIZE, 4); alpha is 0 everywhere: nothing on a person is a mark."""
    p, arm = _texels(body.name)
    rig, tall = body.rig, body.height
    out = np.empty((SIZE, SIZE, 3), np.float32)
    out[:] = look.skin
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    head = rig.p[rig.index("head")]
    neck = float(rig.p[rig.index("neck01")][2])
    out[(z > head[2] + 0.062 * tall) | ((z > head[2]) & (x < head[0] - 0.006 * tall))] = look.hair
    waist = float(rig.p[rig.index("spine05")][2]) + 0.02 * tall
    trunk = (z < neck + 0.012 * tall) & (arm <= 0.0)
    out[(trunk & (z > waist - 0.02 * tall)) | ((arm > 0.0) & (arm < look.sleeve))] = look.shirt
    out[trunk & (z <= waist - 0.02 * tall)] = look.trousers
    out[(z < 0.055 * tall) & (arm <= 0.0)] = look.shoes
    collar = trunk & (z > neck - 0.012 * tall) & (np.hypot(x - head[0] + 0.03, y) < 0.045 * tall)
    out[collar & (x > head[0] - 0.01)] = look.skin
    rng = np.random.default_rng([look.seed, 0x5C1])
    coarse = cv2.resize(rng.normal(0.0, 1.0, (96, 96)).astype(np.float32), (SIZE, SIZE))
    fine = rng.normal(0.0, 1.0, (SIZE, SIZE)).astype(np.float32)
    out *= (1.0 + 0.025 * coarse + 0.015 * fine)[..., None]
    rgba = np.zeros((SIZE, SIZE, 4), np.uint8)
    rgba[..., :3] = np.clip(out, 0, 255)
    return rgba


@lru_cache(maxsize=8)
def _texels(name: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """For each texel where it rests in P (SIZE, SIZE, 3) [m], and how far along an arm it is, 0 elsewhere."""
    body = Body(name)
    mesh = body.mesh
    assert mesh.uv is not None
    values = np.concatenate([mesh.vertices, _along_arms(body)[:, None]], axis=1).astype(np.float32)
    i, j = np.meshgrid(np.arange(_GRID + 1), np.arange(_GRID + 1), indexing="ij")
    inside = i + j <= _GRID
    bary = np.stack([i[inside], j[inside]], axis=1) / _GRID
    bary = np.concatenate([1.0 - bary.sum(axis=1, keepdims=True), bary], axis=1).astype(np.float32)
    out = np.zeros((SIZE, SIZE, 4), np.float32)
    filled = np.zeros((SIZE, SIZE), np.uint8)
    uv, v = mesh.uv[mesh.faces], values[mesh.faces]
    for first in range(0, len(mesh.faces), 4000):
        at = np.einsum("kb,fbd->fkd", bary, uv[first : first + 4000]).reshape(-1, 2)
        what = np.einsum("kb,fbd->fkd", bary, v[first : first + 4000]).reshape(-1, 4)
        column = np.clip(at[:, 0] * SIZE, 0, SIZE - 1).astype(np.intp)
        row = np.clip((1.0 - at[:, 1]) * SIZE, 0, SIZE - 1).astype(np.intp)  # v = 0 is the bottom row
        out[row, column] = what
        filled[row, column] = 1
    for _ in range(6):  # seams: texels beside an island take their neighbours' values
        grown = cv2.dilate(filled, np.ones((3, 3), np.uint8))
        weight = cv2.boxFilter(filled.astype(np.float32), -1, (3, 3), normalize=False)
        mean = cv2.boxFilter(out * filled[..., None], -1, (3, 3), normalize=False)
        edge = (grown > 0) & (filled == 0)
        out[edge] = mean[edge] / weight[edge][:, None]
        filled = np.asarray(grown, np.uint8)
    return out[..., :3], out[..., 3]


def _along_arms(body: Body) -> Array:
    """How far along its arm each mesh vertex lies: 0 at the shoulder, 1 at the wrist, more on the hand."""
    bone, rest = body.region()
    rig = body.rig
    out = np.zeros(len(rest))
    for side in "LR":
        names = ("upperarm01", "upperarm02", "lowerarm01", "lowerarm02", "wrist")
        on_arm = [
            n.endswith(f".{side}") and n.startswith((*names, "finger", "metacarpal")) for n in rig.bones
        ]
        S, E, W = (rig.p[rig.index(f"{n}.{side}")] for n in ("upperarm01", "lowerarm01", "wrist"))
        a, b = float(np.linalg.norm(E - S)), float(np.linalg.norm(W - E))
        here = np.array(on_arm)[bone]
        p = rest[here].astype(float)
        upper, fore = (p - S) @ (E - S) / a, (p - E) @ (W - E) / b
        out[here] = np.maximum(np.where(fore > 0.0, a + fore, np.clip(upper, 0.0, a)) / (a + b), 1e-3)
    return out
