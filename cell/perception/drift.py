"""Whether a camera still stands where it is configured to stand, from the depth of the empty cell.

A frame's depth is compared with what the fixed parts of the cell would give from the configured pose
and from twelve poses near it, one per direction of shift and turn. Where one of those explains the
frame clearly better, again and again, the camera has moved or was never calibrated. Produce, arm and
person are no part of the comparison: what is far from every pose's scene counts the same for all.

It only says so: nothing is decided by it, and no pose is corrected by it.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from cell.cameras import camera_pose
from cell.config import CellConfig
from cell.frames import Array, pose, rotation
from cell.perception.scene import EmptyScene
from cell.wire.types import Frame

_STRIDE = 8
SHIFT, TURN = 0.007, 0.011
"""How far the compared poses are from the configured one [m], [rad]."""
_TOLERANCE = 0.004
"""Depth differences count up to three standard deviations of the camera's noise and this [m]."""
_BETTER = 0.04
"""Share by which another pose's misfit must be smaller."""
_LEAST = 0.2
"""Share of the pixels that must have a depth reading, and show the scene."""
VOTES, WINDOW = 4, 6
"""So many of the last frames must agree."""
_WAYS = (("right", "left"), ("down", "up"), ("ahead", "back"))
"""Where a camera moved along its own axes."""


class DriftWatch:
    """Frames of one camera; the arm should be out of its view.

    Args:
        camera: name of the camera.

    Attributes:
        warned: it has said so already.
    """

    def __init__(self, config: CellConfig, camera: str) -> None:
        c = config.cameras[camera]
        self._camera = camera
        X_WC = camera_pose(c)
        depths = [EmptyScene(config, camera, _STRIDE, X_WC @ X).depth for _, X in _alternatives()]
        self._names = [name for name, _ in _alternatives()]
        self._depths = np.stack(depths)
        self._sigma = c.disparity_noise / (c.depth_focal * c.depth_baseline)
        self._votes: deque[str] = deque(maxlen=WINDOW)
        self.warned = False

    def look(self, frame: Frame) -> str:
        """Take a frame in; the warning once it is certain, else empty."""
        name, _ = self.better(frame)
        self._votes.append(name)
        count = sum(1 for vote in self._votes if vote)
        if self.warned or not name or count < VOTES:
            return ""
        self.warned = True
        return (
            f"camera {self._camera}: the belt and what surrounds it do not lie where its configured pose "
            f"puts them, rather as if it were {name}; run 'cell calibrate', or look whether it was moved"
        )

    def better(self, frame: Frame) -> tuple[str, float]:
        """Which pose explains the frame clearly better than the configured one, and by what share.

        The name is empty when none does.
        """
        z = frame.depth[::_STRIDE, ::_STRIDE]
        seen = z > 0.0
        if seen.mean() < _LEAST:
            return "", 0.0
        measured = z[seen]
        limit = _TOLERANCE + 3.0 * self._sigma * measured**2
        off = np.minimum(np.abs(self._depths[:, seen] - measured) / limit, 1.0)
        shown = (off < 1.0).any(axis=0)  # what no pose explains is no part of the cell
        if shown.sum() < _LEAST * z.size:
            return "", 0.0
        misfit = off[:, shown].mean(axis=1)
        best = int(np.argmin(misfit))
        gain = float(1.0 - misfit[best] / misfit[0])
        return (self._names[best] if gain > _BETTER else ""), gain


def _alternatives() -> list[tuple[str, Array]]:
    """Name and change (4, 4), in the camera's frame, of the compared poses; the configured one first."""
    out: list[tuple[str, Array]] = [("", np.eye(4))]
    for axis, name, ways in zip(np.eye(3), "xyz", _WAYS, strict=True):
        for sign, way in zip((1.0, -1.0), ways, strict=True):
            out.append((f"some {SHIFT * 1e3:.0f} mm farther {way}", pose(p=sign * SHIFT * axis)))
            turn = sign * TURN * axis
            out.append(
                (f"turned by some {sign * TURN * 1e3:+.0f} mrad about its {name} axis", pose(rotation(turn)))
            )
    return out
