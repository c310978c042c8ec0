"""The mode light: one lamp on the belt camera's post, in the colour of what the robot does."""

from __future__ import annotations

from cell.cameras import true_pose
from cell.config import CellConfig
from cell.errors import BackendError, one_of
from cell.frames import Array, inverse, pose
from cell.wire.vocabulary import SIGNALS
from hil.sim.render.mesh import cylinder_mesh
from hil.sim.render.scene import Rgba, Scene, Visual

LABEL = 8
COLORS: dict[str, Rgba] = {
    "off": (0.10, 0.10, 0.11, 1.0),
    "collaborative": (0.05, 0.85, 0.20, 1.0),
    "requested": (1.00, 0.62, 0.05, 1.0),
    "industrial": (0.10, 0.30, 1.00, 1.0),
    "hold": (0.98, 0.98, 0.98, 1.0),
    "stopped": (0.95, 0.06, 0.05, 1.0),
}
_RADIUS, _LENGTH = 0.030, 0.09
_ABOVE = 0.075
"""Height of its middle above the belt camera [m]: on top of the post."""


class ModeLight:
    """The lamp.

    Args:
        anchor: a fixed PyBullet body to which it is attached, at X_WA.

    Attributes:
        signal: what it shows.
    """

    def __init__(self, scene: Scene, config: CellConfig, anchor: int, X_WA: Array) -> None:
        camera = config.cameras["belt"]
        X_WC = true_pose(camera)
        x, y, z = X_WC[:3, 3] - 0.065 * X_WC[:3, 2]
        X_WL = pose(p=(x, y, z + _ABOVE))
        self.signal = "off"
        self._scene = scene
        mesh = cylinder_mesh(_RADIUS, _LENGTH)
        X_AL = inverse(X_WA) @ X_WL
        self._handle = scene.add(Visual(anchor, -1, X_AL, mesh, COLORS["off"], None, LABEL))

    def show(self, signal: str) -> None:
        """Show one of `SIGNALS`; raises `BackendError` listing them."""
        if signal not in COLORS:
            raise BackendError(f"light: {one_of(signal, SIGNALS)}")
        if signal != self.signal:
            self.signal = signal
            self._scene.set_color(self._handle, COLORS[signal])
