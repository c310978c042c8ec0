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

_FACES, _ERROR = 1500, 0.02
"""Most triangles of one mesh, unless its shape would suffer by more than this share of its size."""


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
    """The mesh (a trimesh.Trimesh) with at most _FACES triangles or so, in its plain colour."""
    import meshoptimizer
    import trimesh

    material = getattr(mesh.visual, "material", None)
    colour = mesh.visual.main_color if material is None else material.main_color
    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    plain.merge_vertices(merge_tex=True, merge_norm=True)
    faces = np.ascontiguousarray(plain.faces, np.uint32).ravel()
    vertices = np.ascontiguousarray(plain.vertices, np.float32)
    if len(faces) > 3 * _FACES:
        kept = np.zeros_like(faces)
        most = 3 * _FACES
        count = meshoptimizer.simplify(kept, faces, vertices, target_index_count=most, target_error=_ERROR)
        faces = kept[:count]
    out: Any = trimesh.Trimesh(vertices, faces.reshape(-1, 3), process=False)
    out.remove_unreferenced_vertices()
    out.visual.face_colors = colour
    return out
