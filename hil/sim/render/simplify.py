"""Quadric decimation that keeps colour regions apart and shading smooth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.sim.render.mesh import Mesh

_SAME_POINT = 1e-6
"""Vertices nearer than this are one [m]."""
_CREASE = 0.6
"""A corner takes an original normal only if its cosine to the face's own is above this."""
_NEIGHBOURS = 12


def simplify(mesh: Mesh, target_faces: int) -> Mesh:
    """See `Mesh.simplified`."""
    import fast_simplification

    point_ids, points = _welded(mesh.vertices)
    faces = point_ids[mesh.faces]
    region = _regions(mesh)
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    share = target_faces / max(1, int(keep.sum()))
    corners, normals, colors = [], [], []
    for value in np.unique(region):
        chosen = faces[keep & (region == value)]
        used, local = np.unique(chosen, return_inverse=True)
        out_v, out_f = fast_simplification.simplify(
            points[used],
            local.reshape(-1, 3).astype(np.int32),
            target_count=max(4, round(share * len(chosen))),
            agg=3.0,
            preserve_border=True,
        )[:2]
        if not len(out_f):
            continue
        source = mesh.faces[keep & (region == value)].ravel()
        triangles = np.asarray(out_v)[np.asarray(out_f)]
        corners.append(triangles.reshape(-1, 3))
        normals.append(_corner_normals(triangles, mesh.vertices[source], mesh.normals[source]))
        if mesh.colors is not None:
            colors.append(np.repeat(mesh.colors[source[:1]], 3 * len(out_f), axis=0))
    return _indexed(np.vstack(corners), np.vstack(normals), np.vstack(colors) if colors else None)


def _welded(vertices: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Ids (V,) of distinct points and the points (P, 3): files repeat a vertex per normal."""
    grid = np.round(vertices.astype(np.float64) / _SAME_POINT).astype(np.int64)
    _, first, ids = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    return ids.reshape(-1), vertices[first].astype(np.float64)


def _regions(mesh: Mesh) -> NDArray[np.int64]:
    """A number per face, equal where the colour is."""
    if mesh.colors is None:
        return np.zeros(len(mesh.faces), dtype=np.int64)
    rgb = mesh.colors[mesh.faces[:, 0]].astype(np.int64)
    return rgb[:, 0] << 16 | rgb[:, 1] << 8 | rgb[:, 2]


def _corner_normals(
    triangles: NDArray[np.float64], points: NDArray[np.float32], normals: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Normals (3 F, 3): the nearest original one on the same side of a crease, else the face's."""
    from scipy.spatial import cKDTree

    face_n = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    face_n /= np.maximum(np.linalg.norm(face_n, axis=1, keepdims=True), 1e-20)
    own = np.repeat(face_n, 3, axis=0)
    count = min(_NEIGHBOURS, len(points))
    _, near = cKDTree(points).query(triangles.reshape(-1, 3), k=count)
    candidates = normals[near.reshape(-1, count)].astype(np.float64)
    fits = np.einsum("nkc,nc->nk", candidates, own) > _CREASE
    first = np.argmax(fits, axis=1)
    chosen = candidates[np.arange(len(own)), first]
    return np.where(fits.any(axis=1)[:, None], chosen, own)


def _indexed(
    corners: NDArray[np.float64], normals: NDArray[np.float64], colors: NDArray[np.uint8] | None
) -> Mesh:
    """Share equal corners between triangles."""
    key = np.column_stack(
        [
            np.round(corners / _SAME_POINT),
            np.round(normals * 200.0),
            np.zeros((len(corners), 3)) if colors is None else colors,
        ]
    ).astype(np.int64)
    _, first, ids = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return Mesh.of(
        corners[first], ids.reshape(-1, 3), normals[first], None, None if colors is None else colors[first]
    )
