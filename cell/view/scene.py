"""The cell in three dimensions: what stands, what moves, what is seen, and what is planned."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cell.cameras import camera_pose
from cell.config import CellConfig
from cell.frames import Array, quaternion
from cell.view.arm import Arm
from cell.view.drawing import LABELS, OTHER
from cell.view.furniture import parts
from cell.view.moment import Moment
from cell.view.onions import Onion
from cell.view.person import Figure

if TYPE_CHECKING:
    from viser import ViserServer

_EYE, _TARGET, _FIELD = (-0.35, -2.0, 1.15), (0.70, 0.05, -0.02), 0.85
"""Where one looks from, at what [m], and the vertical field of view [rad]."""
_PATH = (40, 130, 255)
_NEAR, _FAR = (225, 60, 50), (60, 160, 80)
_POST = 0.25
"""Opacity of the cameras' posts, which stand before what one wants to see."""


class Scene:
    """Everything drawn in the canvas; `show` and its kin take what changed."""

    def __init__(self, server: ViserServer, config: CellConfig) -> None:
        self._scene, self._config = server.scene, config
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map(hdri=None)  # its pictures come from the network
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.add_light_hemisphere("/sky", ground_color=(150, 150, 160), intensity=2.2)
        server.scene.world_axes.visible = False
        server.initial_camera.position = _EYE
        server.initial_camera.look_at = _TARGET
        server.initial_camera.fov = _FIELD
        for part in parts(config):
            server.scene.add_box(
                f"/cell/{part.name}",
                color=part.colour,
                dimensions=part.size,
                position=tuple(part.centre),
                opacity=_POST if part.name.startswith("post") else None,
            )
        self._cameras()
        self._arm = Arm(server)
        self._balls: dict[str, list[Any]] = {"perceived": [], "true": []}
        self._named: dict[str, Any] = {}
        self._drawn_path: Array | None = None

    def show(self, moment: Moment) -> None:
        """Arm, gripper and planned path."""
        if moment.joints is not None:
            width = self._config.gripper.stroke if moment.gripper is None else moment.gripper.width
            self._arm.show(moment.joints.q, width)
        busy = moment.arm is not None and moment.arm.moving and moment.path is not None
        path = moment.path.p_WT if busy and moment.path is not None and len(moment.path.p_WT) > 1 else None
        if path is not self._drawn_path:
            self._drawn_path = path
            self._line("path", None if path is None else np.stack([path[:-1], path[1:]], axis=1), _PATH, 3.0)

    def onions(self, onions: list[Onion]) -> None:
        """Onions as they are perceived."""
        spots = [(o.p_WO, o.radius, LABELS.get(o.label, OTHER)) for o in onions]
        self._spheres("perceived", spots, opacity=None)

    def truth(self, moment: Moment) -> None:
        """Onions as they are, as shells around the perceived ones; none without the truth."""
        spots = []
        if moment.truth is not None:
            rows = zip(moment.truth.p_WO, moment.truth.radius, moment.truth.blemished, strict=True)
            for p, radius, blemished in rows:
                colour = LABELS["blemished" if blemished else "unblemished"]
                spots.append((p, float(radius) * 1.12, colour))
        self._spheres("true", spots, opacity=0.35)

    def person(self, figure: Figure | None, separation: float) -> None:
        """The person's points and the line from the arm; None: nobody is seen."""
        points = np.zeros((0, 3)) if figure is None else figure.points
        colours = np.zeros((0, 3), np.uint8) if figure is None else figure.colours
        if len(points):
            self._named["person"] = self._scene.add_point_cloud(
                "/person", points.astype(np.float32), colours, point_size=0.012, point_shading="flat"
            )
        else:
            self._remove("person")
        line = None if figure is None or not np.isfinite(separation) else figure.line
        near = separation < self._config.separation.permit
        self._line("separation", None if line is None else line[None], _NEAR if near else _FAR, 3.0)
        if line is None:
            self._remove("distance")
        else:
            self._named["distance"] = self._scene.add_label(
                "/distance", f"{separation:.2f} m", position=tuple(line.mean(axis=0)), anchor="bottom-center"
            )

    # -- parts ----------------------------------------------------------------------------------------

    def _cameras(self) -> None:
        for name, camera in self._config.cameras.items():
            X_WC = camera_pose(camera)
            x, y, z, w = (float(v) for v in quaternion(X_WC[:3, :3]))
            aspect = camera.width / camera.height
            self._scene.add_camera_frustum(
                f"/cell/camera_{name}",
                fov=2 * float(np.arctan(np.tan(camera.hfov / 2) / aspect)),
                aspect=aspect,
                scale=0.05,
                thickness=0.006,
                color=(70, 74, 80),
                wxyz=(w, x, y, z),
                position=tuple(X_WC[:3, 3]),
            )
            self._scene.add_label(
                f"/cell/name_{name}", f"{name} camera", position=tuple(X_WC[:3, 3] + (0, 0, 0.05)),
                anchor="bottom-center", font_screen_scale=0.8,
            )  # fmt: skip

    def _spheres(self, kind: str, spots: list[tuple[Array, float, Any]], opacity: float | None) -> None:
        balls = self._balls[kind]
        while len(balls) > len(spots):
            balls.pop().remove()
        for i, (p, radius, colour) in enumerate(spots):
            if i == len(balls):
                balls.append(
                    self._scene.add_icosphere(
                        f"/onions/{kind}/{i}", radius=1.0, color=colour, subdivisions=2, opacity=opacity,
                        scale=radius, position=tuple(p), cast_shadow=False,
                    )
                )  # fmt: skip
                continue
            ball = balls[i]
            if np.abs(ball.position - p).max() > 1e-4:
                ball.position = tuple(p)
            if ball.color != colour:
                ball.color = colour
            if abs(ball.scale - radius) > 1e-4:
                ball.scale = radius

    def _line(self, name: str, segments: Array | None, colour: Any, thickness: float) -> None:
        if segments is None:
            self._remove(name)
            return
        self._named[name] = self._scene.add_line_segments(
            f"/{name}", segments.astype(np.float32), colour, thickness=thickness, thickness_units="screen"
        )

    def _remove(self, name: str) -> None:
        handle = self._named.pop(name, None)
        if handle is not None:
            handle.remove()
