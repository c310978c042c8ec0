"""What the cameras see: shapes attached to PyBullet bodies, independent of any renderer."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import RenderError
from cell.frames import Array, pose, rot_x, rot_y, rot_z
from hil.sim.render.mesh import (
    Floats,
    Mesh,
    box_mesh,
    capsule_mesh,
    cylinder_mesh,
    smooth_normals,
    sphere_mesh,
)

Rgba = tuple[float, float, float, float]

MESH_ERROR = 0.2e-3
"""Bound of the error with which a URDF's fine meshes are simplified [m]."""
_GREY: Rgba = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True, eq=False)
class Visual:
    """One drawn shape.

    Attributes:
        body, link: of PyBullet; link -1 is the base.
        X_LV: pose of the shape in the link's URDF frame (not its inertial frame), shape (4, 4).
        mesh: the shape.
        rgba: colour 0..1; alpha is ignored, everything is opaque.
        texture: shape (H, W, 4) uint8, or None. RGB, and a mark: alpha 255 labels the texel as
            marked (a blemish). Alpha is NOT transparency and does not change the picture.
        label: what `Image.labels` shows where this shape is seen; >= 0.
        two_sided: also draw faces seen from behind, for meshes that are not closed (slower).
    """

    body: int
    link: int
    X_LV: Array
    mesh: Mesh
    rgba: Rgba = _GREY
    texture: NDArray[np.uint8] | None = None
    label: int = 0
    two_sided: bool = False


class Scene:
    """The set of visuals.

    `version` counts additions and removals, `deformed` and `recolored` changes of a mesh or a colour.
    """

    def __init__(self) -> None:
        self._visuals: dict[int, Visual] = {}
        self._next = 0
        self.version = 0
        self.deformed: dict[int, int] = {}
        self.recolored: dict[int, int] = {}

    def add(self, visual: Visual) -> int:
        """Add a shape; returns its handle. Raises `RenderError` for an unusable texture."""
        texture = visual.texture
        if texture is not None:
            if texture.ndim != 3 or texture.shape[2] != 4 or texture.dtype != np.uint8:
                raise RenderError(f"texture: expected (H, W, 4) uint8, got {texture.shape} {texture.dtype}")
            if visual.mesh.uv is None:
                raise RenderError("texture: the mesh has no texture coordinates (uv)")
        if visual.label < 0:
            raise RenderError(f"label: must be >= 0 (-1 is the background), got {visual.label}")
        handle = self._next
        self._next += 1
        self._visuals[handle] = visual
        self.version += 1
        return handle

    def remove(self, handle: int) -> None:
        """Remove one shape; harmless if it is gone."""
        if self._visuals.pop(handle, None) is not None:
            self.deformed.pop(handle, None)
            self.recolored.pop(handle, None)
            self.version += 1

    def remove_body(self, body: int) -> None:
        """Remove all shapes of a body."""
        for handle in [h for h, v in self._visuals.items() if v.body == body]:
            self.remove(handle)

    def set_vertices(self, handle: int, vertices: Floats, normals: Floats | None = None) -> None:
        """Deform a shape: new vertices (V, 3) [m] in its own frame, faces unchanged.

        Args:
            handle: from `add`.
            vertices: shape (V, 3), as many as before.
            normals: shape (V, 3); averaged from the faces when missing.
        """
        visual = self[handle]
        mesh = visual.mesh
        v = np.ascontiguousarray(vertices, dtype=np.float32)
        if v.shape != mesh.vertices.shape:
            raise RenderError(f"set_vertices: expected shape {mesh.vertices.shape}, got {v.shape}")
        n = smooth_normals(v, mesh.faces) if normals is None else np.ascontiguousarray(normals, np.float32)
        self._visuals[handle] = replace(visual, mesh=replace(mesh, vertices=v, normals=n))
        self.deformed[handle] = self.deformed.get(handle, 0) + 1

    def set_color(self, handle: int, rgba: Rgba) -> None:
        """Give a shape another colour 0..1; cheap, unlike removing and adding it."""
        self._visuals[handle] = replace(self[handle], rgba=rgba)
        self.recolored[handle] = self.recolored.get(handle, 0) + 1

    def __getitem__(self, handle: int) -> Visual:
        if handle not in self._visuals:
            raise RenderError(f"scene: no visual with handle {handle}")
        return self._visuals[handle]

    def items(self) -> list[tuple[int, Visual]]:
        """(handle, visual), oldest first."""
        return list(self._visuals.items())

    @property
    def visuals(self) -> list[Visual]:
        """All shapes, oldest first."""
        return list(self._visuals.values())


def add_urdf_visuals(
    scene: Scene,
    urdf: str | Path,
    body: int,
    client: int,
    label: int,
    resolve_mesh: Callable[[str], Path],
    mesh_error: float = MESH_ERROR,
) -> list[int]:
    """Add every `<visual>` of a URDF, attached to the links of a loaded PyBullet body by name.

    Args:
        scene: to add to.
        urdf: the URDF's text, or the path of the file.
        body, client: of PyBullet; the body has the URDF's links.
        label: for all of them.
        resolve_mesh: mesh file name as written -> path, e.g. `urdf.resolve`.
        mesh_error: how far fine meshes may be simplified [m].

    Returns:
        The handles.

    Raises:
        RenderError: the text is no URDF, a link is missing in the body, or a mesh in its place.
    """
    try:
        root = ET.fromstring(urdf if isinstance(urdf, str) and "<" in urdf else Path(urdf).read_text())
    except (ET.ParseError, OSError) as error:
        raise RenderError(f"URDF: {error}") from None
    links = link_indices(body, client)
    palette = {m.get("name", ""): m for m in root.findall("material")}
    handles = []
    for link in root.findall("link"):
        name = link.get("name", "")
        for element in link.findall("visual"):
            if name not in links:
                raise RenderError(f"URDF link '{name}' is not in the body; it has: {', '.join(links)}")
            color = _color(element.find("material"), palette)
            mesh = _geometry(element.find("geometry"), resolve_mesh, mesh_error)
            if color is not None and mesh.colors is not None:
                mesh = replace(mesh, colors=None)  # a URDF's own colour replaces the file's
            rgba = color if color is not None else (_GREY if mesh.colors is None else (1.0, 1.0, 1.0, 1.0))
            X_LV = origin(element.find("origin"))
            handles.append(scene.add(Visual(body, links[name], X_LV, mesh, rgba, None, label)))
    return handles


def link_indices(body: int, client: int) -> dict[str, int]:
    """PyBullet link indices by link name; the base is -1."""
    from hil.sim.physics import bullet

    links = {bullet.getBodyInfo(body, physicsClientId=client)[0].decode(): -1}
    for index in range(bullet.getNumJoints(body, physicsClientId=client)):
        links[bullet.getJointInfo(body, index, physicsClientId=client)[12].decode()] = index
    return links


def origin(element: ET.Element | None) -> Array:
    """Pose (4, 4) of a URDF's `<origin>`; no element means none."""
    if element is None:
        return np.eye(4)
    roll, pitch, yaw = _numbers(element.get("rpy", "0 0 0"), 3)
    return pose(rot_z(yaw) @ rot_y(pitch) @ rot_x(roll), _numbers(element.get("xyz", "0 0 0"), 3))


def _color(element: ET.Element | None, palette: dict[str, ET.Element]) -> Rgba | None:
    if element is None:
        return None
    if element.find("color") is None:
        element = palette.get(element.get("name", ""), element)
    color = element.find("color")
    if color is None:
        return None
    r, g, b, a = _numbers(color.get("rgba", "1 1 1 1"), 4)
    return r, g, b, a


def _geometry(element: ET.Element | None, resolve_mesh: Callable[[str], Path], mesh_error: float) -> Mesh:
    shape: Any = element[0] if element is not None and len(element) else None
    if shape is None:
        raise RenderError("URDF: a <visual> without <geometry>")
    if shape.tag == "box":
        return box_mesh(_numbers(shape.get("size", ""), 3))
    if shape.tag == "sphere":
        return sphere_mesh(_numbers(shape.get("radius", ""), 1)[0])
    if shape.tag in ("cylinder", "capsule"):
        radius, length = (_numbers(shape.get(key, ""), 1)[0] for key in ("radius", "length"))
        return cylinder_mesh(radius, length) if shape.tag == "cylinder" else capsule_mesh(radius, length)
    if shape.tag == "mesh":
        scale = _numbers(shape.get("scale", "1 1 1"), 3)
        try:
            file = resolve_mesh(shape.get("filename", ""))
        except FileNotFoundError as error:
            raise RenderError(str(error)) from None
        return _cheap_mesh(file, tuple(scale), mesh_error)
    raise RenderError(f"URDF: <{shape.tag}> is not drawn; legal: box, sphere, cylinder, capsule, mesh")


@lru_cache(maxsize=64)
def _cheap_mesh(path: Path, scale: tuple[float, ...], max_error: float) -> Mesh:
    return Mesh.from_file(path, scale).simplified(max_error)


def _numbers(text: str, count: int) -> list[float]:
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count:
        raise RenderError(f"URDF: expected {count} numbers, got '{text}'")
    return values


__all__ = [
    "MESH_ERROR",
    "Mesh",
    "Scene",
    "Visual",
    "add_urdf_visuals",
    "box_mesh",
    "capsule_mesh",
    "cylinder_mesh",
    "link_indices",
    "origin",
    "sphere_mesh",
]
