"""The first motion after a start or a stop is slow, so that what is wrong shows before it hurts."""

from __future__ import annotations

import numpy as np

from cell.config import CellConfig
from cell.limits import hermite, tcp_positions
from cell.wire.types import Trajectory
from hil.executor import Executor

_STEP = 0.008


class FirstMotion:
    """Slows the path clock down until one motion has been completed.

    Args:
        cap: of the tool's speed in that motion [m/s]; infinity: motions are never slowed down.

    Attributes:
        pace: ratio 0..1 at which the path clock may run.
    """

    def __init__(self, cap: float, config: CellConfig) -> None:
        self._cap, self._length = cap, config.gripper.length
        self._due = bool(np.isfinite(cap))
        self._number = 0
        self.pace = 1.0

    def again(self) -> None:
        """After a stop: the next motion is a first one."""
        self._due, self._number, self.pace = bool(np.isfinite(self._cap)), 0, 1.0

    def begin(self, trajectory: Trajectory) -> str:
        """A trajectory was accepted; what people should know of it, if anything."""
        if not self._due or trajectory.start != 0.0:
            return ""
        peak = self._peak(trajectory)
        self._number = trajectory.id
        self.pace = min(1.0, self._cap / max(peak, 1e-9))
        if self.pace == 1.0:
            return ""
        return (
            f"first motion: slowed down to {self.pace * 100:.0f} %, the tool to {self._cap:g} m/s; "
            "it cannot be changed on its way, only stopped"
        )

    def follow(self, executor: Executor) -> None:
        """After every period: when that motion is complete, the next ones run at their own speed."""
        if self._number and not executor.moving and not executor.stop_reason:
            self._due, self._number, self.pace = False, 0, 1.0

    def _peak(self, trajectory: Trajectory) -> float:
        """Greatest speed of the tool along it [m/s]."""
        times = trajectory.times
        fine = np.linspace(0.0, times[-1], max(2, int(np.ceil(times[-1] / _STEP)) + 1))
        q, _, _ = hermite(times, trajectory.q, trajectory.qd, fine)
        p_WT = tcp_positions(q, self._length)
        return float((np.linalg.norm(np.diff(p_WT, axis=0), axis=1) / np.diff(fine)).max())
