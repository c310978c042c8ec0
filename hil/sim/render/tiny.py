"""The reference and fallback: PyBullet's own software renderer, TinyRenderer.

It draws PyBullet's visual shapes, not the scene's meshes, so bodies must have been created
with visuals; the scene tells it only which label belongs to which body and link. Shapes of
one link cannot be told apart: the link takes the label of its first visual.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell.frames import Array, Pinhole, inverse
from hil.sim.physics import bullet
from hil.sim.render.renderer import Image, Lighting, Moment, Pending
from hil.sim.render.scene import Scene

_LINK_SHIFT = 24
"""PyBullet's segmentation value is body + (link + 1) << 24."""


class TinyRenderer:
    """`Renderer` on PyBullet's `getCameraImage`; see there for arguments."""

    name = "tiny"

    def __init__(self, client: int, scene: Scene, lighting: Lighting | None = None) -> None:
        self.lighting = lighting or Lighting()
        self._client = client
        self._scene = scene
        self._version = -1

    def render(self, X_WC: Array, pinhole: Pinhole, near: float, far: float) -> Image:
        if self._version != self._scene.version:
            self._version = self._scene.version
            self._tint()
        light = self.lighting
        # The gl renderer adds light linearly and shows its square root; TinyRenderer adds what
        # it shows. These two strengths agree in full shade and in full light.
        shade = light.ambient**0.5
        glow = (light.ambient + light.diffuse) ** 0.5 - shade
        width, height, rgba, d, segments = bullet.getCameraImage(
            pinhole.width,
            pinhole.height,
            viewMatrix=_view(X_WC).T.ravel().tolist(),
            projectionMatrix=_projection(pinhole, near, far).T.ravel().tolist(),
            lightDirection=light.direction,
            lightColor=light.color,
            lightDistance=5.0,
            shadow=int(light.shadows),
            lightAmbientCoeff=shade,
            lightDiffuseCoeff=glow,
            lightSpecularCoeff=light.specular,
            renderer=bullet.ER_TINY_RENDERER,
            flags=bullet.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
            physicsClientId=self._client,
        )
        shape = (height, width)
        segments = np.asarray(segments, dtype=np.int64).reshape(shape)
        buffer = np.asarray(d, dtype=np.float64).reshape(shape)
        seen = segments >= 0
        depth = np.where(seen, far * near / (far - (far - near) * buffer), 0.0).astype(np.float32)
        rgb = np.ascontiguousarray(np.asarray(rgba, dtype=np.uint8).reshape(*shape, 4)[..., :3])
        rgb[~seen] = np.round(255 * np.asarray(light.background)).astype(np.uint8)
        return Image(rgb, depth, self._labels(segments, seen), None)

    def submit(
        self, X_WC: Array, pinhole: Pinhole, near: float, far: float, moment: Moment | None = None
    ) -> Pending:
        del moment
        return self.render(X_WC, pinhole, near, far)

    def moment(self) -> None:
        """PyBullet draws its bodies where they are."""

    def close(self) -> None:
        """Nothing is held."""

    def _tint(self) -> None:
        """Give links whose meshes carry material colours, which PyBullet ignores, their mean."""
        for visual in self._scene.visuals:
            mesh = visual.mesh
            if mesh.colors is not None:
                tri = mesh.vertices[mesh.faces]
                area = np.linalg.norm(np.cross(tri[:, 1] - tri[:, 0], tri[:, 2] - tri[:, 0]), axis=1)
                mean = np.average(mesh.colors[mesh.faces[:, 0]], axis=0, weights=area) / 255.0
                color = mean * visual.rgba[:3]
                bullet.changeVisualShape(
                    visual.body, visual.link, rgbaColor=[*color, 1.0], physicsClientId=self._client
                )

    def _labels(self, segments: NDArray[np.int64], seen: NDArray[np.bool_]) -> NDArray[np.int32]:
        label_of: dict[tuple[int, int], int] = {}
        for visual in self._scene.visuals:
            label_of.setdefault((visual.body, visual.link), visual.label)
        labels = np.full(segments.shape, -1, dtype=np.int32)
        values, inverse_index = np.unique(segments[seen], return_inverse=True)
        mask = (1 << _LINK_SHIFT) - 1
        lookup = [label_of.get((int(v & mask), int(v >> _LINK_SHIFT) - 1), -1) for v in values]
        labels[seen] = np.array(lookup, dtype=np.int32)[inverse_index]
        return labels


def _view(X_WC: Array) -> Array:
    """OpenGL view matrix: x right, y up, looking along -z."""
    return np.diag([1.0, -1.0, -1.0, 1.0]) @ inverse(X_WC)


def _projection(p: Pinhole, near: float, far: float) -> Array:
    """OpenGL projection matrix of the intrinsics, pixel (0, 0) being a pixel's centre.

    TinyRenderer evaluates a pixel at its lower left corner instead of its centre, hence cx and
    cy + 1 where OpenGL proper has cx + 1/2 and cy + 1/2.
    """
    return np.array(
        [
            [2 * p.fx / p.width, 0.0, 1.0 - 2 * p.cx / p.width, 0.0],
            [0.0, 2 * p.fy / p.height, 2 * (p.cy + 1.0) / p.height - 1.0, 0.0],
            [0.0, 0.0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )
