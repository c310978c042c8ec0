"""The arm with its gripper in the scene: the URDF's meshes, light enough for a browser without a GPU."""

from __future__ import annotations

import logging
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np

from cell.errors import ConfigError
from cell.frames import Array
from urdf import FINGER_JOINT_NAMES, JOINT_NAMES, robot_description

if TYPE_CHECKING:
    from viser import ViserServer

_FACES = 2500
"""Most triangles of one mesh."""


class Arm:
    """Follows joints and fingers.

    Raises:
        ConfigError: the meshes are not installed.
    """

    def __init__(self, server: ViserServer) -> None:
        import yourdfpy
        from viser.extras import ViserUrdf

        logging.getLogger("yourdfpy").setLevel(logging.ERROR)
        try:
            urdf = yourdfpy.URDF.load(StringIO(robot_description()))
        except FileNotFoundError as error:
            raise ConfigError(f"the arm cannot be drawn: {error}") from None
        geometry = urdf.scene.geometry
        for name in list(geometry):
            geometry[name] = _lighter(geometry[name])
        self._order = list(urdf.actuated_joint_names)
        self._urdf = ViserUrdf(server, urdf, root_node_name="/arm")

    def show(self, q: Array, width: float) -> None:
        """Joint angles (6,) [rad], fingers `width` apart [m]."""
        values = dict(zip(JOINT_NAMES, q, strict=True)) | dict.fromkeys(FINGER_JOINT_NAMES, width / 2)
        self._urdf.update_cfg(np.array([values.get(name, 0.0) for name in self._order]))


def _lighter(mesh: Any) -> Any:
    """The mesh (a trimesh.Trimesh) with at most _FACES triangles or so, in its colour."""
    import meshoptimizer
    import trimesh

    faces = np.ascontiguousarray(mesh.faces, np.uint32).ravel()
    if len(faces) <= 3 * _FACES:
        return mesh
    merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    merged.merge_vertices(merge_tex=True, merge_norm=True)
    faces = np.ascontiguousarray(merged.faces, np.uint32).ravel()
    vertices = np.ascontiguousarray(merged.vertices, np.float32)
    kept = np.zeros_like(faces)
    count = meshoptimizer.simplify(kept, faces, vertices, target_index_count=3 * _FACES, target_error=0.02)
    out: Any = trimesh.Trimesh(vertices, kept[:count].reshape(-1, 3), process=False)
    out.remove_unreferenced_vertices()
    colour = getattr(mesh.visual, "main_color", None)
    if colour is None:
        colour = mesh.visual.to_color().main_color
    out.visual.face_colors = colour
    return out
