"""Decimation with a bounded error that keeps colour regions apart and shading smooth."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hil.sim.render.mesh import Ints, Mesh

_GRID = 1 << 20
"""Points are equal if they fall into the same of this many cells along the mesh's longest side."""
_CREASE = 0.87
"""An original normal counts at a corner if its cosine to the face's own is above this."""


def simplify(mesh: Mesh, max_error: float) -> Mesh:
    """See `Mesh.simplified`."""
    import meshoptimizer as mo

    point_ids, points = _welded(mesh.vertices)
    faces = point_ids[mesh.faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    region = _regions(mesh)
    corners, normals, colors = [], [], []
    for value in np.unique(region):
        chosen = proper & (region == value)
        out = np.zeros(3 * int(chosen.sum()), dtype=np.uint32)
        count = mo.simplify(
            out,
            np.ascontiguousarray(faces[chosen], dtype=np.uint32).ravel(),
            points,
            target_index_count=3,
            target_error=max_error,
            options=mo.SIMPLIFY_ERROR_ABSOLUTE | mo.SIMPLIFY_LOCK_BORDER,
        )
        if not count:
            continue
        kept = out[:count].astype(np.int64)
        source = np.unique(mesh.faces[chosen])
        corners.append(points[kept])
        normals.append(
            _corner_normals(points[kept].reshape(-1, 3, 3), kept, point_ids[source], mesh.normals[source])
        )
        if mesh.colors is not None:
            colors.append(np.repeat(mesh.colors[source[:1]], count, axis=0))
    return _indexed(np.vstack(corners), np.vstack(normals), np.vstack(colors) if colors else None)


@lru_cache(maxsize=128)
def proxy_faces(mesh: Mesh, max_error: float) -> Ints:
    """Fewer triangles over the mesh's own vertices, for what need not be exact; shape (F', 3)."""
    import meshoptimizer as mo

    ids, points = _welded(mesh.vertices)
    _, representative = np.unique(ids, return_index=True)
    out = np.zeros(mesh.faces.size, dtype=np.uint32)
    count = mo.simplify(
        out,
        ids[mesh.faces].ravel().astype(np.uint32),
        points,
        target_index_count=3,
        target_error=max_error,
        options=mo.SIMPLIFY_ERROR_ABSOLUTE,
    )
    return representative[out[:count].astype(np.int64)].reshape(-1, 3).astype(np.int32)


def _welded(vertices: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Ids (V,) of distinct points and the points (P, 3): files repeat a vertex per normal."""
    low = vertices.min(axis=0)
    cell = max(float((vertices.max(axis=0) - low).max()), 1e-9) / _GRID
    key = np.round((vertices - low).astype(np.float64) / cell).astype(np.int64)
    _, first, ids = np.unique(
        key[:, 0] << 42 | key[:, 1] << 21 | key[:, 2], return_index=True, return_inverse=True
    )
    return ids, np.ascontiguousarray(vertices[first])


def _regions(mesh: Mesh) -> NDArray[np.int64]:
    """A number per face, equal where the colour is."""
    if mesh.colors is None:
        return np.zeros(len(mesh.faces), dtype=np.int64)
    rgb = mesh.colors[mesh.faces[:, 0]].astype(np.int64)
    return rgb[:, 0] << 16 | rgb[:, 1] << 8 | rgb[:, 2]


def _corner_normals(
    triangles: NDArray[np.float32],
    corners: NDArray[np.int64],
    point_ids: NDArray[np.int64],
    normals: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Normals (3 F, 3) for corners at original points: the mean of the point's original normals.

    A normal far off the face's own belongs to the other side of a crease and does not count.
    Files often have one normal per facet; the mean makes such surfaces smooth.
    """
    face_n = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    face_n /= np.maximum(np.linalg.norm(face_n, axis=1, keepdims=True), 1e-20)
    own = np.repeat(face_n, 3, axis=0)
    order = np.argsort(point_ids, kind="stable")
    ids = point_ids[order]
    first = np.searchsorted(ids, corners)
    count = np.searchsorted(ids, corners, side="right") - first
    total = np.zeros_like(own)
    for k in range(int(count.max(initial=0))):
        candidate = normals[order[np.minimum(first + k, len(ids) - 1)]]
        same_side = (k < count) & (np.einsum("nc,nc->n", candidate, own) > _CREASE)
        total += np.where(same_side[:, None], candidate, 0.0)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-6, total / np.maximum(length, 1e-6), own).astype(np.float32)


def _indexed(
    corners: NDArray[np.float32], normals: NDArray[np.float32], colors: NDArray[np.uint8] | None
) -> Mesh:
    """Share equal corners between triangles."""
    ids, _ = _welded(corners)
    n = np.round(normals * 200.0).astype(np.int64) + 200
    key = ids << 27 | n[:, 0] << 18 | n[:, 1] << 9 | n[:, 2]
    if colors is not None:
        rgb = colors.astype(np.int64)
        _, palette = np.unique(rgb[:, 0] << 16 | rgb[:, 1] << 8 | rgb[:, 2], return_inverse=True)
        key = key * (int(palette.max()) + 1) + palette
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    kept = None if colors is None else colors[first]
    return Mesh.of(corners[first], inverse.reshape(-1, 3), normals[first], None, kept)
