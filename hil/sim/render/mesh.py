"""Triangle meshes: PyBullet's primitive shapes, files, and cheap stand-ins for fine meshes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Ints = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in one frame; never written to after construction.

    Attributes:
        vertices: shape (V, 3) float32 [m].
        faces: shape (F, 3) int32, counter-clockwise seen from outside.
        normals: shape (V, 3) float32, unit length.
        uv: shape (V, 2) float32, or None. v = 0 is the BOTTOM row of the texture image.
        colors: shape (V, 3) uint8 RGB that multiplies the visual's colour, or None for white.
    """

    vertices: Floats
    faces: Ints
    normals: Floats
    uv: Floats | None = None
    colors: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        count = len(self.vertices)
        shapes = (
            (self.vertices.shape == (count, 3), f"vertices (V, 3), got {self.vertices.shape}"),
            (self.faces.ndim == 2 and self.faces.shape[1] == 3, f"faces (F, 3), got {self.faces.shape}"),
            (self.normals.shape == (count, 3), f"normals ({count}, 3), got {self.normals.shape}"),
            (self.uv is None or self.uv.shape == (count, 2), f"uv ({count}, 2)"),
            (self.colors is None or self.colors.shape == (count, 3), f"colors ({count}, 3)"),
        )
        for fine, wanted in shapes:
            if not fine:
                raise ValueError(f"mesh: expected {wanted}")
        _check_faces(self.faces, count)

    @classmethod
    def of(
        cls, vertices: object, faces: object, normals: object = None, uv: object = None, colors: object = None
    ) -> Mesh:
        """Convert array-likes to the right types; missing normals are averaged from the faces."""
        v = np.ascontiguousarray(vertices, dtype=np.float32)
        f = np.ascontiguousarray(faces, dtype=np.int32)
        _check_faces(f, len(v))
        return cls(
            v,
            f,
            smooth_normals(v, f) if normals is None else np.ascontiguousarray(normals, dtype=np.float32),
            None if uv is None else np.ascontiguousarray(uv, dtype=np.float32),
            None if colors is None else np.ascontiguousarray(colors, dtype=np.uint8),
        )

    @classmethod
    def from_file(cls, path: Path | str, scale: object = 1.0) -> Mesh:
        """Read a mesh file; Wavefront OBJ with its materials directly, other formats by trimesh.

        Args:
            path: the file.
            scale: one factor or three (a URDF mesh's `scale`).
        """
        from hil.sim.render.obj import load_mesh

        mesh = load_mesh(Path(path))
        factor = np.broadcast_to(np.asarray(scale, dtype=np.float32), (3,))
        if np.all(factor == 1.0):
            return mesh
        n = mesh.normals / factor
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
        faces = mesh.faces if np.prod(factor) > 0 else mesh.faces[:, ::-1]
        return cls.of(mesh.vertices * factor, faces, n, mesh.uv, mesh.colors)

    def simplified(self, max_error: float) -> Mesh:
        """A mesh of fewer triangles that stays within about `max_error` [m] of this one.

        Edge collapse bounded by its error, one colour region at a time with its border kept,
        so that regions stay sharp and gapless; normals and colours come from the original.
        Texture coordinates are not carried over: a mesh that has them is returned unchanged.
        """
        if self.uv is not None:
            return self
        from hil.sim.render.simplify import simplify

        return simplify(self, max_error)


def _check_faces(faces: Ints, count: int) -> None:
    if faces.size and not 0 <= int(faces.min()) <= int(faces.max()) < count:
        raise ValueError(f"mesh: face indices must be within 0..{count - 1}")


def smooth_normals(vertices: Floats, faces: Ints) -> Floats:
    """Area-weighted vertex normals, shape (V, 3) float32."""
    tri = vertices[faces].astype(np.float64)
    cross = np.cross(tri[:, 1] - tri[:, 0], tri[:, 2] - tri[:, 0])
    total = np.zeros((len(vertices), 3))
    for axis in range(3):
        total[:, axis] = np.bincount(
            faces.ravel(), weights=np.repeat(cross[:, axis], 3), minlength=len(vertices)
        )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total = np.where(length > 1e-20, total / np.maximum(length, 1e-20), [0.0, 0.0, 1.0])
    return total.astype(np.float32)


def box_mesh(size: object) -> Mesh:
    """Box of full lengths `size` (3,) [m], centred; every face has its own texture square."""
    half = np.asarray(size, dtype=float) / 2
    v: list[Array] = []
    n: list[Array] = []
    f: list[list[int]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            a, b = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            normal = sign * np.eye(3)[axis]
            base = len(v)
            for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                v.append((normal + sign * s * a + t * b) * half)
                n.append(normal)
            f += [[base, base + 1, base + 2], [base, base + 2, base + 3]]
    uv = np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (6, 1))
    return Mesh.of(v, f, n, uv)


@lru_cache(maxsize=64)
def cylinder_mesh(radius: float, length: float, segments: int = 48) -> Mesh:
    """Cylinder along z, centred; radius and length [m]."""
    a = np.linspace(0.0, 2 * np.pi, segments + 1)
    ring = np.column_stack([np.cos(a), np.sin(a)])
    ends = (-length / 2, length / 2)
    side = np.vstack([np.column_stack([radius * ring, np.full(len(a), z)]) for z in ends])
    side_n = np.tile(np.column_stack([ring, np.zeros(len(a))]), (2, 1))
    i = np.arange(segments)
    m = segments + 1
    faces = [np.column_stack([i, i + 1, i + 1 + m]), np.column_stack([i, i + 1 + m, i + m])]
    v, n = [side], [side_n]
    count = 2 * m
    for z, sign in zip(ends, (-1.0, 1.0), strict=True):
        v.append(np.vstack([np.column_stack([radius * ring, np.full(m, z)]), [[0.0, 0.0, z]]]))
        n.append(np.tile([0.0, 0.0, sign], (m + 1, 1)))
        first, second = (i + 1, i) if sign < 0 else (i, i + 1)
        faces.append(np.column_stack([count + first, count + second, np.full(segments, count + m)]))
        count += m + 1
    return Mesh.of(np.vstack(v), np.vstack(faces), np.vstack(n))


@lru_cache(maxsize=64)
def sphere_mesh(radius: float, around: int = 32, down: int = 20) -> Mesh:
    """Sphere, centred; u runs with longitude from 0 to 1, v from the south pole (0) to the north (1)."""
    return _revolved(radius, 0.0, around, down)


@lru_cache(maxsize=64)
def capsule_mesh(radius: float, length: float, around: int = 32, down: int = 24) -> Mesh:
    """Capsule along z, centred; `length` [m] is that of the cylindrical part, as in PyBullet."""
    return _revolved(radius, length, around, down)


def _revolved(radius: float, length: float, around: int, down: int) -> Mesh:
    """Two half spheres `length` apart, joined by a cylinder (`length` 0: a sphere)."""
    theta = np.linspace(0.0, np.pi, down + 1)
    split = theta <= np.pi / 2 + 1e-9
    if length > 0.0:
        theta = np.concatenate([theta[split], [np.pi / 2], theta[~split]])
        lift = np.where(np.arange(len(theta)) < split.sum(), length / 2, -length / 2)
    else:
        lift = np.zeros(len(theta))
    phi = np.linspace(0.0, 2 * np.pi, around + 1)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    n = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    v = radius * n
    v[..., 2] += lift[:, None]
    uv = np.stack([p / (2 * np.pi), 1.0 - t / np.pi], axis=-1)
    row, col = np.meshgrid(np.arange(len(theta) - 1), np.arange(around), indexing="ij")
    a = (row * (around + 1) + col).ravel()
    b = a + around + 1
    faces = np.vstack([np.column_stack([a, b, b + 1]), np.column_stack([a, b + 1, a + 1])])
    corners = v.reshape(-1, 3)[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return Mesh.of(v.reshape(-1, 3), faces[area > 1e-14], n.reshape(-1, 3), uv.reshape(-1, 2))
