"""One interface for all renderers, and the choice between them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cell.errors import RenderError, one_of
from cell.frames import Array, Pinhole
from hil.sim.render.scene import Scene

Rgb = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Image:
    """What an ideal camera sees.

    Attributes:
        rgb: shape (H, W, 3) uint8.
        depth: shape (H, W) float32 [m] along the optical axis; 0 where nothing lies within `far`.
        labels: shape (H, W) int32, the seen visual's label; -1 where nothing is.
        marks: shape (H, W) bool, pixels showing marked texels (blemishes); None if the renderer
            cannot tell.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    labels: NDArray[np.int32]
    marks: NDArray[np.bool_] | None

    def image(self) -> Image:
        """Itself: a picture that is done already is `Pending`, too."""
        return self


@dataclass(frozen=True)
class Lighting:
    """One distant light, light from everywhere, and what lies behind everything.

    Attributes:
        direction: from the scene TO the light, in the world frame; any length.
        color: of the light, 1 = full.
        ambient: share of light that comes from everywhere, 0..1.
        diffuse: strength of the distant light.
        specular: strength of highlights, 0 = matt.
        sky, ground: tint of the ambient light from above and from below.
        background: colour where nothing is, 0..1.
        shadows: whether the distant light casts them.
        shadow_size: side of the gl renderer's shadow map [px]; 1024 is one pixel per 3 mm or so.
    """

    direction: tuple[float, float, float] = (-0.35, -0.55, 1.0)
    color: Rgb = (1.0, 0.98, 0.94)
    ambient: float = 0.60
    diffuse: float = 0.68
    specular: float = 0.12
    sky: Rgb = (1.0, 1.02, 1.06)
    ground: Rgb = (0.72, 0.69, 0.66)
    background: Rgb = (0.80, 0.82, 0.84)
    shadows: bool = True
    shadow_size: int = 1024


class Pending(Protocol):
    """A picture that is being drawn."""

    def image(self) -> Image:
        """The picture; waits until it is done. To be called once."""
        ...


Moment = dict[tuple[int, int], Array]
"""Poses X_WL (4, 4) of PyBullet's (body, link) at one time."""


class Renderer(Protocol):
    """Draws the scene as an ideal pinhole camera sees it, following PyBullet's bodies.

    Pixel (0, 0) is the centre of the top-left pixel; fx, fy, cx and cy are honoured exactly.
    """

    name: str
    lighting: Lighting

    def render(self, X_WC: Array, pinhole: Pinhole, near: float, far: float) -> Image:
        """Draw one image with the bodies where they are now.

        Args:
            X_WC: camera pose, shape (4, 4), optical convention.
            pinhole: intrinsics.
            near, far: nearest and farthest distance drawn [m].
        """
        ...

    def submit(
        self, X_WC: Array, pinhole: Pinhole, near: float, far: float, moment: Moment | None = None
    ) -> Pending:
        """As `render`, but without waiting for the picture; of the bodies where they were at `moment`."""
        ...

    def moment(self) -> Moment | None:
        """Where all bodies are now, for a picture drawn later; None when it can only be drawn now."""
        ...

    def close(self) -> None:
        """Free everything; harmless when repeated."""
        ...


def make_renderer(choice: str, client: int, scene: Scene, lighting: Lighting | None = None) -> Renderer:
    """Build a renderer.

    Args:
        choice: "gl", "tiny", or "auto": gl where it works, else tiny with one warning.
        client: PyBullet client whose bodies the scene's visuals are attached to.
        scene: may change later; the renderer follows.
        lighting: defaults to `Lighting()`; the attribute may be replaced between images.

    Raises:
        RenderError: "gl" does not work here (the message says what to install), or `choice`
            is unknown.
    """
    if choice not in ("auto", "gl", "tiny"):
        raise RenderError(f"renderer: {one_of(choice, ['auto', 'gl', 'tiny'])}")
    light = lighting or Lighting()
    if choice in ("auto", "gl"):
        from hil.sim.render.gl import GlRenderer

        try:
            return GlRenderer(client, scene, light)
        except RenderError as error:
            if choice == "gl":
                raise
            warnings.warn(f"{error} Falling back to PyBullet's TinyRenderer (slower).", stacklevel=2)
    from hil.sim.render.tiny import TinyRenderer

    return TinyRenderer(client, scene, light)


def gl_problem() -> str:
    """Why the "gl" renderer cannot work here, in one sentence; empty when it can."""
    from hil.sim.render.gl import open_context

    try:
        open_context().release()
    except RenderError as error:
        return str(error)
    return ""
