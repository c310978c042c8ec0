"""The fast renderer: OpenGL without a window (EGL), on a GPU or on Mesa's llvmpipe.

One pass writes colour with marks, linear depth and labels; with shadows, a depth-only pass
from the light comes before it. On one machine the same scene gives the same bits in every
process.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import RenderError
from cell.frames import Array, Pinhole, inverse
from hil.sim.render.bodies import LinkPoses
from hil.sim.render.gl_batch import Batch, make_batches
from hil.sim.render.renderer import Image, Lighting
from hil.sim.render.scene import Scene
from hil.sim.render.shaders import FRAGMENT, SHADOW_FRAGMENT, SHADOW_VERTEX, VERTEX
from hil.sim.render.shadow import SHADOW_SIZE, shadow_from_world

_SHADOW_UNIT = 1
_SHADOW_OFFSET = 0.004
"""Shadow look-ups start this far off the surface, against self-shadowing [m]."""


def open_context() -> Any:
    """A window-less OpenGL 3.3 context. Raises `RenderError` saying what to install."""
    try:
        import moderngl
    except ImportError:
        raise RenderError("The gl renderer needs the Python package moderngl: pip install moderngl.") from None
    try:
        return moderngl.create_context(require=330, standalone=True, backend="egl")
    except Exception as error:  # glcontext raises bare Exception
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RenderError(
            f"The gl renderer cannot open an EGL context ({reason}); on Debian or Ubuntu: "
            "apt-get install libegl1 libgl1 libgl1-mesa-dri."
        ) from None


class GlRenderer:
    """`Renderer` on OpenGL; see there for arguments. One thread at a time."""

    name = "gl"

    def __init__(self, client: int, scene: Scene, lighting: Lighting | None = None) -> None:
        self.lighting = lighting or Lighting()
        self._scene = scene
        self._poses = LinkPoses(client)
        self._ctx: Any = open_context()
        self._programs = {
            "plain": self._program(VERTEX, FRAGMENT, ""),
            "textured": self._program(VERTEX, FRAGMENT, "#define TEXTURED\n"),
            "shadow": self._program(SHADOW_VERTEX, SHADOW_FRAGMENT, ""),
        }
        self._batches: list[Batch] = []
        self._version = -1
        self._targets: dict[tuple[int, int], Any] = {}
        self._shadow_depth = self._ctx.depth_texture((SHADOW_SIZE, SHADOW_SIZE))
        self._shadow_depth.compare_func = "<="
        self._shadow_depth.filter = (self._ctx.LINEAR, self._ctx.LINEAR)
        self._shadow_target = self._ctx.framebuffer(depth_attachment=self._shadow_depth)

    def render(self, X_WC: Array, pinhole: Pinhole, near: float, far: float) -> Image:
        if self._ctx is None:
            raise RenderError("the renderer is closed")
        with self._ctx:
            self._follow_scene(inverse(X_WC))
            self._set_uniforms(X_WC, pinhole, near, far)
            return self._draw(pinhole)

    def close(self) -> None:
        if self._ctx is not None:
            self._ctx.release()
            self._ctx = None

    # -- scene ----------------------------------------------------------------------------------

    def _follow_scene(self, X_CW: Array) -> None:
        if self._version != self._scene.version:
            for batch in self._batches:
                batch.release()
            self._batches = make_batches(self._ctx, self._programs, self._scene)
            self._version = self._scene.version
            self._poses.forget()
        poses = self._poses.read({key for batch in self._batches for key in batch.keys})
        centers, radii = [np.zeros((0, 3))], [np.zeros(0)]
        for batch in self._batches:
            batch.follow(self._scene)
            X_WV = np.array([poses[key] for key in batch.keys]) @ batch.X_LV
            batch.place(X_CW, X_WV)
            n = batch.casters
            centers.append(np.einsum("nij,nj->ni", X_WV[:n, :3, :3], batch.centers_V[:n]) + X_WV[:n, :3, 3])
            radii.append(batch.radii[:n])
        self._spheres = np.vstack(centers), np.concatenate(radii)

    # -- drawing --------------------------------------------------------------------------------

    def _set_uniforms(self, X_WC: Array, pinhole: Pinhole, near: float, far: float) -> None:
        light = self.lighting
        R_CW = X_WC[:3, :3].T
        to_light = np.asarray(light.direction, dtype=float)
        to_light = to_light / np.linalg.norm(to_light)
        shadow_from_C = shadow_from_world(to_light, *self._spheres) @ X_WC
        color, ambient = np.asarray(light.color), light.ambient
        values: dict[str, Any] = {
            "projection": _matrix(_projection(pinhole, near, far)),
            "to_light": tuple(R_CW @ to_light),
            "up": tuple(R_CW[:, 2]),
            "light": tuple(light.diffuse * color),
            "sky": tuple(ambient * np.asarray(light.sky)),
            "ground": tuple(ambient * np.asarray(light.ground)),
            "specular": light.specular,
            "shadow_from_C": _matrix(shadow_from_C),
            "shadow_strength": 1.0 if light.shadows else 0.0,
            "shadow_offset": _SHADOW_OFFSET,
            "skins": 0,
            "shadow_map": _SHADOW_UNIT,
        }
        for program in self._programs.values():
            for key, value in values.items():
                if key in program:
                    if isinstance(value, bytes):
                        program[key].write(value)
                    else:
                        program[key].value = value

    def _draw(self, pinhole: Pinhole) -> Image:
        ctx = self._ctx
        ctx.enable_only(ctx.DEPTH_TEST)
        if self.lighting.shadows:
            self._shadow_target.use()
            self._shadow_target.clear(depth=1.0)
            for batch in self._batches:
                batch.draw_shadow()
        target = self._target(pinhole.width, pinhole.height)
        target.use()
        target.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        self._shadow_depth.use(_SHADOW_UNIT)
        for batch in self._batches:
            batch.draw()
        shape = (pinhole.height, pinhole.width)
        rgba = np.empty((*shape, 4), dtype=np.uint8)
        target.read_into(rgba, components=4, attachment=0)
        geometry = np.empty((*shape, 2), dtype=np.float32)
        target.read_into(geometry, components=2, attachment=1, dtype="f4")
        return self._image(rgba, geometry)

    def _image(self, rgba: NDArray[np.uint8], geometry: NDArray[np.float32]) -> Image:
        depth = np.ascontiguousarray(geometry[..., 0])
        labels = geometry[..., 1].astype(np.int32) - 1
        rgb = np.ascontiguousarray(rgba[..., :3])
        rgb[labels < 0] = np.round(255 * np.asarray(self.lighting.background)).astype(np.uint8)
        return Image(rgb, depth, labels, rgba[..., 3] > 127)

    def _target(self, width: int, height: int) -> Any:
        if (width, height) not in self._targets:
            size = (width, height)
            self._targets[size] = self._ctx.framebuffer(
                [self._ctx.renderbuffer(size, 4), self._ctx.renderbuffer(size, 2, dtype="f4")],
                self._ctx.depth_renderbuffer(size),
            )
        return self._targets[width, height]

    def _program(self, vertex: str, fragment: str, defines: str) -> Any:
        insert = "#version 330\n" + defines
        return self._ctx.program(
            vertex_shader=vertex.strip().replace("#version 330\n", insert),
            fragment_shader=fragment.strip().replace("#version 330\n", insert),
        )


def _projection(p: Pinhole, near: float, far: float) -> Array:
    """Optical frame -> clip space, with the image's top row first in memory."""
    return np.array(
        [
            [2 * p.fx / p.width, 0.0, 2 * (p.cx + 0.5) / p.width - 1.0, 0.0],
            [0.0, 2 * p.fy / p.height, 2 * (p.cy + 0.5) / p.height - 1.0, 0.0],
            [0.0, 0.0, (far + near) / (far - near), -2 * far * near / (far - near)],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )


def _matrix(m: Array) -> bytes:
    """Column-major float32, as OpenGL stores matrices."""
    return np.ascontiguousarray(m.T, dtype="<f4").tobytes()
