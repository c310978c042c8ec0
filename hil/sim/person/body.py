"""A human body: one mesh with hands, moved by its bones (linear blend skinning, in numpy).

Frame P of a person: origin on the floor between the feet, x forward, y to the person's left, z up.
Bodies come from the parametric model `anny` (see data/NOTICE and tools/export_person).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import ConfigError, one_of
from cell.frames import Array
from hil.sim.render.mesh import Mesh

Floats = NDArray[np.float32]


@cache
def _data() -> dict[str, Any]:
    path = files("hil.sim.person") / "data" / "bodies.npz"
    with path.open("rb") as file:
        return dict(np.load(file, allow_pickle=False))


def body_names() -> tuple[str, ...]:
    """The bodies there are."""
    return tuple(str(name) for name in _data()["names"])


@dataclass(frozen=True)
class Rig:
    """The skeleton of one body at rest.

    Attributes:
        bones: names; `.L` is the person's left. parents: index of each bone's parent, -1 for the root.
        p: heads of the bones in P (B, 3) [m]. R: axes of the bones (B, 3, 3): y along the bone,
            x the axis of flexion.
    """

    bones: tuple[str, ...]
    parents: tuple[int, ...]
    p: Array
    R: Array

    def index(self, bone: str) -> int:
        return self.bones.index(bone)


class Body:
    """One body.

    Args:
        name: one of `body_names()`; raises `ConfigError` listing them.

    Attributes:
        rig: the skeleton. mesh: at rest in P, with texture coordinates. height: [m].
    """

    def __init__(self, name: str) -> None:
        data = _data()
        if name not in body_names():
            raise ConfigError(f"body: {one_of(name, body_names())}")
        self.name = name
        X = data[f"{name}.X"].astype(float)
        self.rig = Rig(
            tuple(str(b) for b in data["bones"]),
            tuple(int(p) for p in data["parents"]),
            X[:, :, 3],
            X[:, :, :3],
        )
        self._rest: Floats = (data[f"{name}.vertices"] / 1e4).astype(np.float32)
        self.height = float(self._rest[:, 2].max())
        self._source = data["source"].astype(np.intp)
        faces = data["faces"].astype(np.int32)
        corners = self._source[faces]
        self._corner = [np.ascontiguousarray(corners[:, k]) for k in range(3)]
        weight = (data["weight"] / 65535.0).astype(np.float32)
        self._blend = _blend_matrix(data["follow"].astype(np.intp), weight, len(self.rig.bones))
        self._homogeneous = np.concatenate([self._rest, np.ones((len(self._rest), 1), np.float32)], axis=1)
        self._sum_faces = _face_sum(corners, len(self._rest))
        uv = (data["uv"] / 65535.0).astype(np.float32)
        vertices = self._rest[self._source]
        self.mesh = Mesh(
            vertices=vertices, faces=faces, normals=self._normals(self._rest)[self._source], uv=uv
        )
        self._weight, self._follow = weight, data["follow"].astype(np.intp)

    def skin(self, G: Array, p: Array) -> tuple[Floats, Floats]:
        """Vertices and normals (V, 3) of the posed mesh, in the frame of the bones.

        Args:
            G: rotation of each bone relative to rest (B, 3, 3). p: heads of the bones (B, 3) [m].
        """
        move = np.concatenate([G, (p - np.einsum("bij,bj->bi", G, self.rig.p))[..., None]], axis=2)
        per_vertex = (self._blend @ move.reshape(len(G), 12).astype(np.float32)).reshape(-1, 3, 4)
        v = np.einsum("vij,vj->vi", per_vertex, self._homogeneous)
        return v[self._source], self._normals(v)[self._source]

    def points(self, G: Array, p: Array, every: int = 1) -> Floats:
        """Vertices without copies along texture seams, every so many of them, (M, 3) [m]."""
        move = np.concatenate([G, (p - np.einsum("bij,bj->bi", G, self.rig.p))[..., None]], axis=2)
        blend = self._blend[::every] if every > 1 else self._blend
        per_vertex = (blend @ move.reshape(len(G), 12).astype(np.float32)).reshape(-1, 3, 4)
        out: Floats = np.einsum("vij,vj->vi", per_vertex, self._homogeneous[::every])
        return out

    def region(self) -> tuple[NDArray[np.intp], Floats]:
        """The bone that each mesh vertex follows most (V,), and where the vertex rests (V, 3) [m]."""
        return self._follow[self._source, 0], self._rest[self._source]

    def _normals(self, v: Floats) -> Floats:
        a, b, c = (v.take(corner, axis=0) for corner in self._corner)
        n = self._sum_faces @ _cross(b - a, c - a)
        out: Floats = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
        return out.astype(np.float32)


def _cross(u: Floats, w: Floats) -> Floats:
    """As `numpy.cross` of (N, 3), which takes six times as long."""
    out = np.empty_like(u)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(u[:, j] * w[:, k], u[:, k] * w[:, j], out=out[:, i])
    return out


def _blend_matrix(follow: NDArray[np.intp], weight: Floats, bones: int) -> Any:
    """Sparse (vertices, bones) matrix of skinning weights."""
    from scipy.sparse import csr_matrix

    rows = np.repeat(np.arange(len(follow)), follow.shape[1])
    weight = weight / weight.sum(axis=1, keepdims=True)
    matrix = csr_matrix(
        (weight.ravel(), (rows, follow.ravel())), shape=(len(follow), bones), dtype=np.float32
    )
    matrix.eliminate_zeros()
    return matrix


def _face_sum(corners: NDArray[np.intp], vertices: int) -> Any:
    """Sparse (vertices, faces) matrix that adds to each vertex what its faces have."""
    from scipy.sparse import csr_matrix

    rows, columns = corners.T.ravel(), np.tile(np.arange(len(corners)), 3)
    ones = np.ones(len(rows), np.float32)
    return csr_matrix((ones, (rows, columns)), shape=(vertices, len(corners)), dtype=np.float32)
