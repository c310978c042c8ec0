"""Wavefront OBJ with material colours; other mesh formats are left to trimesh.

Importing trimesh takes more than a second, reading the arm's meshes here 0.3 s; and its
per-material splitting would have to be undone for a mesh that is drawn in one call.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.errors import RenderError
from hil.sim.render.mesh import Mesh

_WHITE = (255, 255, 255)


def load_mesh(path: Path) -> Mesh:
    """Read a mesh file; vertex colours come from the materials' diffuse colours.

    Raises:
        RenderError: the file is missing or cannot be understood.
    """
    if not path.is_file():
        raise RenderError(f"mesh file not found: {path}")
    try:
        return _read_obj(path) if path.suffix.lower() == ".obj" else _read_by_trimesh(path)
    except (ValueError, IndexError, KeyError, ImportError) as error:
        raise RenderError(f"cannot read mesh {path}: {error}") from None


def _read_obj(path: Path) -> Mesh:
    points: list[str] = []
    normals: list[str] = []
    uvs: list[str] = []
    corners: list[list[str]] = []  # one triangle each
    materials: list[int] = []  # per triangle, index into `palette`
    palette: list[tuple[int, int, int]] = [_WHITE]
    colors: dict[str, tuple[int, int, int]] = {}
    current = 0
    for line in path.read_text(errors="replace").splitlines():
        key, _, rest = line.partition(" ")
        if key == "v":
            points.append(rest)
        elif key == "vn":
            normals.append(rest)
        elif key == "vt":
            uvs.append(rest)
        elif key == "f":
            polygon = rest.split()
            for i in range(1, len(polygon) - 1):
                corners.append([polygon[0], polygon[i], polygon[i + 1]])
                materials.append(current)
        elif key == "mtllib":
            colors.update(_read_mtl(path.with_name(rest.strip())))
        elif key == "usemtl":
            palette.append(colors.get(rest.strip(), _WHITE))
            current = len(palette) - 1
    if not corners:
        raise ValueError("it has no faces")
    v, vt, vn = _table(points, 3), _table(uvs, 2), _table(normals, 3)
    index = _references([c for triangle in corners for c in triangle])
    if index is None:
        return _read_by_trimesh(path)
    color = np.repeat(np.array(materials, dtype=np.int64), 3)
    mixed = ((color * (len(vn) + 1) + index[:, 2]) * (len(vt) + 1) + index[:, 1]) * (len(v) + 1) + index[:, 0]
    _, first, inverse = np.unique(mixed, return_index=True, return_inverse=True)
    unique, color = index[first], color[first]
    has_uv, has_normals = unique[:, 1].min() > 0, unique[:, 2].min() > 0
    return Mesh.of(
        v[unique[:, 0] - 1],
        inverse.reshape(-1, 3),
        vn[unique[:, 2] - 1] if has_normals else None,
        vt[unique[:, 1] - 1] if has_uv else None,
        np.array(palette, dtype=np.uint8)[color] if colors else None,
    )


def _references(corners: list[str]) -> NDArray[np.int64] | None:
    """Words "v/vt/vn" -> indices (N, 3) from 1, 0 where absent; None for rare forms.

    Rare are words of different forms in one file, and indices that count from the end.
    """
    form = [bool(part) for part in corners[0].split("/")]
    if any([bool(part) for part in corner.split("/")] != form for corner in corners):
        return None
    flat = np.array(" ".join(corners).replace("/", " ").split(), dtype=np.int64)
    index = np.zeros((len(corners), 3), dtype=np.int64)
    index[:, [i for i, given in enumerate(form) if given]] = flat.reshape(len(corners), -1)
    return None if flat.min() < 1 else index


def _table(rows: list[str], columns: int) -> NDArray[np.float64]:
    if not rows:
        return np.zeros((0, columns))
    flat = np.array(" ".join(rows).split(), dtype=np.float64)
    return flat.reshape(len(rows), -1)[:, :columns]


def _read_mtl(path: Path) -> dict[str, tuple[int, int, int]]:
    """Diffuse colours by material name; a missing library leaves everything white."""
    colors: dict[str, tuple[int, int, int]] = {}
    if not path.is_file():
        return colors
    name = ""
    for line in path.read_text(errors="replace").splitlines():
        word = line.split()
        if len(word) >= 2 and word[0] == "newmtl":
            name = line.split(maxsplit=1)[1].strip()
        elif len(word) >= 4 and word[0] == "Kd":
            r, g, b = (round(255 * min(1.0, max(0.0, float(value)))) for value in word[1:4])
            colors[name] = (r, g, b)
    return colors


def _read_by_trimesh(path: Path) -> Mesh:
    import trimesh

    mesh = trimesh.load(path, force="mesh")
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise ValueError("it has no faces")
    return Mesh.of(mesh.vertices, mesh.faces, mesh.vertex_normals)
