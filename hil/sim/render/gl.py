"""The fast renderer: OpenGL without a window (EGL), on a GPU or on Mesa's llvmpipe.

One pass writes colour with marks, linear depth and labels; with shadows, a depth-only pass
from the light comes before it. On one machine the same scene gives the same bits in every
process.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.errors import RenderError
from cell.frames import Array, Pinhole, inverse
from hil.sim.render.bodies import LinkPoses
from hil.sim.render.gl_batch import Batch, make_batches
from hil.sim.render.renderer import Image, Lighting, Moment, Pending
from hil.sim.render.scene import Scene
from hil.sim.render.shaders import build_programs
from hil.sim.render.shadow import shadow_from_world

_SHADOW_UNIT = 1
_SHADOW_OFFSET = 0.004
"""Shadow look-ups start this far off the surface, against self-shadowing [m]."""


def open_context() -> Any:
    """A window-less OpenGL 3.3 context. Raises `RenderError` saying what to install."""
    try:
        import moderngl
    except ImportError:
        raise RenderError("The gl renderer needs Python package moderngl: pip install moderngl.") from None
    options: dict[str, Any] = {"require": 330, "standalone": True, "backend": "egl"}
    try:
        return moderngl.create_context(**options)
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
        self._programs = build_programs(self._ctx)
        self._backdrop = self._ctx.vertex_array(self._programs["backdrop"], [])
        self._batches: list[Batch] = []
        self._seen: list[NDArray[np.bool_]] = []
        self._version = -1
        self._elsewhere = self._ctx.simple_framebuffer((1, 1))
        self._targets: list[Any] = [self._elsewhere]
        self._free: dict[tuple[int, int], list[Any]] = {}
        self._shadow_targets: dict[int, Any] = {}

    def render(self, X_WC: Array, pinhole: Pinhole, near: float, far: float) -> Image:
        return self.submit(X_WC, pinhole, near, far).image()

    def moment(self) -> Moment:
        return self._poses.read(dict.fromkeys((v.body, v.link) for v in self._scene.visuals))

    def submit(
        self, X_WC: Array, pinhole: Pinhole, near: float, far: float, moment: Moment | None = None
    ) -> Pending:
        if self._ctx is None:
            raise RenderError("the renderer is closed")
        with self._ctx:
            self._follow_scene(inverse(X_WC), pinhole, moment)
            self._set_uniforms(X_WC, pinhole, near, far)
            target = self._free_target(pinhole.width, pinhole.height)
            self._draw(target)
            # Going on with another target makes the driver start on this one.
            self._elsewhere.use()
            self._elsewhere.clear()
        return _Drawn(self, target)

    def collect(self, target: Any) -> Image:
        """Read a finished target back and let others use it."""
        if self._ctx is None:
            raise RenderError("the renderer is closed")
        with self._ctx:
            image = _read(target)
        self._free[target.size].append(target)
        return image

    def close(self) -> None:
        if self._ctx is None:
            return
        with self._ctx:
            for resource in (*self._batches, *self._targets):
                resource.release()
        self._ctx.release()
        self._ctx = None

    # -- scene ----------------------------------------------------------------------------------

    def _follow_scene(self, X_CW: Array, pinhole: Pinhole, moment: Moment | None) -> None:
        if self._version != self._scene.version:
            for batch in self._batches:
                batch.release()
            self._batches = make_batches(self._ctx, self._programs, self._scene)
            self._version = self._scene.version
            self._poses.forget()
        poses = self.moment() if moment is None else moment
        centers, radii = [np.zeros((0, 3))], [np.zeros(0)]
        self._seen = []
        for batch in self._batches:
            batch.follow(self._scene)
            X_WV = np.array([poses[key] for key in batch.keys]) @ batch.X_LV
            batch.place(X_CW, X_WV)
            n = batch.casters
            middle = np.einsum("nij,nj->ni", X_WV[:, :3, :3], batch.centers_V) + X_WV[:, :3, 3]
            self._seen.append(_in_view(middle @ X_CW[:3, :3].T + X_CW[:3, 3], batch.radii, pinhole))
            centers.append(middle[:n])
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
            "shadow_offset": _SHADOW_OFFSET,
            "background": light.background,
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

    def _draw(self, target: Any) -> None:
        ctx = self._ctx
        ctx.enable_only(ctx.DEPTH_TEST)
        ctx.depth_func = "<="
        shadows = self.lighting.shadows
        if shadows:
            depth, shadow_target = self._shadow_target(self.lighting.shadow_size)
            shadow_target.use()
            shadow_target.clear(depth=1.0)
            ctx.front_face = "ccw"
            for batch in self._batches:
                batch.draw_shadow()
            depth.use(_SHADOW_UNIT)
        target.use()
        target.clear(depth=1.0)
        ctx.front_face = "cw"  # counter-clockwise triangles, seen in rows stored top first
        for batch, seen in zip(self._batches, self._seen, strict=True):
            batch.draw(shadows, seen)
        ctx.disable(ctx.CULL_FACE)
        self._backdrop.render(vertices=3)

    def _free_target(self, width: int, height: int) -> Any:
        """A frame buffer that no unread picture is in."""
        size = (width, height)
        free = self._free.setdefault(size, [])
        if free:
            return free.pop()
        target = self._ctx.framebuffer(
            [
                self._ctx.renderbuffer(size, 4),
                self._ctx.renderbuffer(size, 1, dtype="f4"),
                self._ctx.renderbuffer(size, 1, dtype="i4"),
            ],
            self._ctx.depth_renderbuffer(size),
        )
        self._targets.append(target)
        return target

    def _shadow_target(self, size: int) -> tuple[Any, Any]:
        """The shadow map of this size and the frame buffer that fills it."""
        if size not in self._shadow_targets:
            depth = self._ctx.depth_texture((size, size))
            depth.compare_func = "<="
            depth.filter = (self._ctx.LINEAR, self._ctx.LINEAR)
            depth.repeat_x = depth.repeat_y = False
            self._shadow_targets[size] = depth, self._ctx.framebuffer(depth_attachment=depth)
        depth, target = self._shadow_targets[size]
        return depth, target


class _Drawn:
    """A picture that the driver draws, in threads of its own or on a GPU."""

    def __init__(self, renderer: GlRenderer, target: Any) -> None:
        self._renderer, self._target = renderer, target

    def image(self) -> Image:
        return self._renderer.collect(self._target)


def _read(target: Any) -> Image:
    """The picture in a frame buffer; waits until it is drawn."""
    width, height = target.size
    rgba = np.empty((height, width, 4), dtype=np.uint8)
    depth = np.empty((height, width), dtype=np.float32)
    labels = np.empty((height, width), dtype=np.int32)
    target.read_into(rgba, components=4, attachment=0)
    target.read_into(depth, components=1, attachment=1, dtype="f4")
    target.read_into(labels, components=1, attachment=2, dtype="i4")
    rgb = np.asarray(cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB), dtype=np.uint8)
    return Image(rgb, depth, labels, rgba[..., 3] > 127)


def _in_view(p_C: Array, radii: Array, p: Pinhole) -> NDArray[np.bool_]:
    """Which spheres (N,) reach into the picture: centres (N, 3) in the camera's frame, radii (N,) [m]."""
    sides = np.array(
        [
            [p.fx, 0.0, p.cx + 1.0],
            [-p.fx, 0.0, p.width - p.cx],
            [0.0, p.fy, p.cy + 1.0],
            [0.0, -p.fy, p.height - p.cy],
            [0.0, 0.0, 1.0],
        ]
    )
    inwards = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    return np.asarray((p_C @ inwards.T > -radii[:, None]).all(axis=1))


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
