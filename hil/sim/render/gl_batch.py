"""Geometry on the GPU: visuals with equally large textures share buffers and one draw call."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.frames import Array
from hil.sim.render.mesh import Mesh
from hil.sim.render.scene import Scene, Visual
from hil.sim.render.shaders import VISUALS_PER_DRAW
from hil.sim.render.simplify import proxy_faces

CASTER_RADIUS = 1.2
"""Larger shapes (floors, walls) receive shadows but cast none [m]."""
SHADOW_ERROR = 1.5e-3
"""Shadows are cast by shapes simplified this far [m]; a pixel of the shadow map is larger."""
_ROW = 20  # floats per visual in the uniform block
_BLOCK_BINDING = 0
_SKINS_UNIT = 0


class Batch:
    """Up to 512 visuals: vertex buffers, textures, and one record per visual.

    Attributes:
        keys: per visual, PyBullet (body, link).
        X_LV: shape (N, 4, 4).
        centers_V, radii: bounding spheres in the visuals' frames, shape (N, 3), (N,) [m].
        casters: number of leading visuals that cast shadows.
    """

    def __init__(self, ctx: Any, programs: dict[str, Any], items: list[tuple[int, Visual]]) -> None:
        self._ctx = ctx
        self._two_sided = items[0][1].two_sided
        spheres = {handle: _bounding_sphere(visual.mesh) for handle, visual in items}
        # Small shapes lie on large ones: drawn first, they spare shading what they hide. It also
        # puts the casters first.
        items = sorted(items, key=lambda item: spheres[item[0]][1])
        self.keys = [(visual.body, visual.link) for _, visual in items]
        self.X_LV = np.array([visual.X_LV for _, visual in items], dtype=np.float64)
        self.centers_V = np.array([spheres[handle][0] for handle, _ in items])
        self.radii = np.array([spheres[handle][1] for handle, _ in items])
        self.casters = int((self.radii <= CASTER_RADIUS).sum())
        self._handles = [handle for handle, _ in items]
        self._seen = dict.fromkeys(self._handles, 0)
        self._painted = dict.fromkeys(self._handles, 0)
        self._build_buffers(ctx, programs, [visual for _, visual in items])

    def _build_buffers(self, ctx: Any, programs: dict[str, Any], visuals: list[Visual]) -> None:
        textured = visuals[0].texture is not None
        counts = [len(visual.mesh.vertices) for visual in visuals]
        starts = np.concatenate([[0], np.cumsum(counts)])
        self._starts = dict(zip(self._handles, starts[:-1].tolist(), strict=True))
        fixed = np.zeros(int(starts[-1]), dtype=[("uv", "<f4", 2), ("color", "u1", 4), ("visual", "<i4")])
        for number, visual in enumerate(visuals):
            part = fixed[starts[number] : starts[number + 1]]
            part["visual"] = number
            part["color"][:, :3] = 255 if visual.mesh.colors is None else visual.mesh.colors
            if visual.mesh.uv is not None:
                part["uv"] = visual.mesh.uv
        moving = np.vstack([_position_normal(visual.mesh) for visual in visuals])
        faces = [v.mesh.faces + first for v, first in zip(visuals, starts[:-1], strict=True)]
        self._first_index = np.concatenate([[0], np.cumsum([part.size for part in faces])])
        self._moving = ctx.buffer(moving.tobytes(), dynamic=True)
        self._fixed = ctx.buffer(fixed.tobytes())
        index = ctx.buffer(np.vstack(faces).astype("<i4").tobytes())
        shadow_faces = [
            proxy_faces(v.mesh, SHADOW_ERROR) + first
            for v, first in zip(visuals[: self.casters], starts[:-1], strict=False)
        ]
        shadow_index = ctx.buffer(np.vstack([np.zeros((1, 3)), *shadow_faces]).astype("<i4").tobytes())
        self._records = np.zeros((len(visuals), _ROW), dtype="<f4")
        self._records[:, 12:15] = [visual.rgba[:3] for visual in visuals]
        self._records[:, 15] = [visual.label for visual in visuals]
        self._records[:, 16] = np.arange(len(visuals)) if textured else -1
        self._block = ctx.buffer(reserve=VISUALS_PER_DRAW * _ROW * 4, dynamic=True)
        self._skins = _texture_array(ctx, visuals) if textured else None
        kind = "textured" if textured else "plain"
        layout = [
            (self._moving, "3f 3f", "in_position", "in_normal"),
            (self._fixed, "2f 4f1 1i", "in_uv", "in_color", "in_visual")
            if textured
            else (self._fixed, "8x 4f1 1i", "in_color", "in_visual"),
        ]
        self._color_vaos = [
            ctx.vertex_array(programs[kind + suffix], layout, index) for suffix in ("", " shadows")
        ]
        self._shadow_vao = ctx.vertex_array(
            programs["shadow"],
            [(self._moving, "3f 12x", "in_position"), (self._fixed, "12x 1i", "in_visual")],
            shadow_index,
        )
        self._resources = [
            *self._color_vaos, self._shadow_vao, self._moving, self._fixed, index, shadow_index, self._block,
            *([self._skins] if self._skins else []),
        ]  # fmt: skip

    def follow(self, scene: Scene) -> None:
        """Take over the vertices and colours of visuals that changed since the last call."""
        for number, handle in enumerate(self._handles):
            painted = scene.recolored.get(handle, 0)
            if painted != self._painted[handle]:
                self._painted[handle] = painted
                self._records[number, 12:15] = scene[handle].rgba[:3]
            count = scene.deformed.get(handle, 0)
            if count == self._seen[handle]:
                continue
            self._seen[handle] = count
            mesh = scene[handle].mesh
            self.centers_V[number], self.radii[number] = _bounding_sphere(mesh)
            self._moving.write(_position_normal(mesh).tobytes(), offset=24 * self._starts[handle])

    def place(self, X_CW: Array, X_WV: Array) -> None:
        """Set where the visuals are: X_WV shape (N, 4, 4)."""
        self._records[:, :12] = (X_CW @ X_WV)[:, :3].reshape(-1, 12)
        self._block.write(self._records.tobytes())

    def draw_shadow(self) -> None:
        """Draw the casters into the current depth target."""
        if self.casters:
            self._cull()
            self._block.bind_to_uniform_block(_BLOCK_BINDING)
            self._shadow_vao.render()

    def draw(self, shadows: bool, seen: NDArray[np.bool_]) -> None:
        """Draw the visuals that are `seen` (N,) into the current target."""
        if not seen.any():
            return
        self._cull()
        self._block.bind_to_uniform_block(_BLOCK_BINDING)
        if self._skins is not None:
            self._skins.use(_SKINS_UNIT)
        edges = np.flatnonzero(np.diff(seen, prepend=False, append=False))
        for first, last in edges.reshape(-1, 2):  # neighbours that are seen share a draw call
            start, end = self._first_index[first], self._first_index[last]
            self._color_vaos[shadows].render(vertices=int(end - start), first=int(start))

    def _cull(self) -> None:
        if self._two_sided:
            self._ctx.disable(self._ctx.CULL_FACE)
        else:
            self._ctx.enable(self._ctx.CULL_FACE)

    def release(self) -> None:
        for resource in self._resources:
            resource.release()
        self._resources = []


def make_batches(ctx: Any, programs: dict[str, Any], scene: Scene) -> list[Batch]:
    """Group the scene's visuals by texture size and sidedness."""
    groups: dict[tuple[Any, ...], list[tuple[int, Visual]]] = {}
    for handle, visual in scene.items():
        shape = () if visual.texture is None else visual.texture.shape
        groups.setdefault((shape, visual.two_sided), []).append((handle, visual))
    size = VISUALS_PER_DRAW
    return [
        Batch(ctx, programs, group[i : i + size])
        for group in sorted(groups.values(), key=lambda g: g[0][1].texture is None)
        for i in range(0, len(group), size)
    ]


def _texture_array(ctx: Any, visuals: list[Visual]) -> Any:
    """One layer per visual; OpenGL's first row is v = 0, which is the image's bottom row."""
    layers = [visual.texture[::-1] for visual in visuals if visual.texture is not None]
    height, width = layers[0].shape[:2]
    array = ctx.texture_array((width, height, len(layers)), 4, np.stack(layers).tobytes())
    array.build_mipmaps()
    array.filter = (ctx.LINEAR_MIPMAP_NEAREST, ctx.LINEAR)
    array.repeat_y = False
    return array


def _position_normal(mesh: Mesh) -> NDArray[np.float32]:
    return np.hstack([mesh.vertices, mesh.normals]).astype("<f4")


def _bounding_sphere(mesh: Mesh) -> tuple[Array, float]:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
