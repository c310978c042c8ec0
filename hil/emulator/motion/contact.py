"""What the arm remembers of the last seconds, and `tool_contact` on top of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from hil.emulator.interfaces import Measured
from hil.emulator.poses import norm

KEPT = 1000
"""Cycles of joint positions and forces that are remembered."""
_CONTACT = 8.0
"""Force against the direction that is a contact [N]; the real controller's threshold is not published."""
_ONSET = 2.0
"""Force at which the contact is taken to have begun [N]."""


class Memory:
    """Measured joint angles (6,) [rad] and tool forces (3,) [N], newest last."""

    def __init__(self) -> None:
        self._seen: deque[Measured] = deque(maxlen=KEPT)
        self._zero: Sequence[float] = (0.0,) * 6

    def add(self, measured: Measured) -> None:
        """Once per cycle."""
        self._seen.append(measured)

    def zero(self) -> None:
        """What is felt now counts as nothing."""
        if self._seen:
            self._zero = self._seen[-1].wrench.tolist()

    def wrench(self) -> list[float]:
        """Measured last, shape (6,), without what was zeroed."""
        if not self._seen:
            return [0.0] * 6
        return [a - b for a, b in zip(self._seen[-1].wrench.tolist(), self._zero, strict=True)]

    def joints(self, steps: int) -> list[float]:
        """Joint angles so many cycles ago [rad], or the oldest known."""
        if not self._seen:
            return [0.0] * 6
        back = min(max(steps, 0), len(self._seen) - 1)
        q: list[float] = self._seen[-1 - back].q.tolist()
        return q

    def contact(self, direction: Sequence[float]) -> int:
        """Cycles since a contact against `direction` began; 0 if there is none.

        Args:
            direction: in B; the first three numbers count. All 0: any direction.
        """
        size = norm(direction)
        axis = [v / size for v in direction[:3]] if size > 1e-9 else None
        if not self._seen or self._force(self._seen[-1], axis) < _CONTACT:
            return 0
        back = 0
        for measured in reversed(self._seen):
            if self._force(measured, axis) < _ONSET:
                break
            back += 1
        return max(back, 1)

    def _force(self, measured: Measured, axis: Sequence[float] | None) -> float:
        w, z = measured.wrench, self._zero
        f = (w[0] - z[0], w[1] - z[1], w[2] - z[2])
        if axis is None:
            return norm(f)
        return float(-(f[0] * axis[0] + f[1] * axis[1] + f[2] * axis[2]))
