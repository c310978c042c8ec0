"""What follows from the measurements of successive cycles, and the ramps of the speed ratio."""

from __future__ import annotations

import numpy as np

from hil.emulator.interfaces import PERIOD, ZERO6, Measured

_STILL, _STEADY_TIME = 5e-3, 0.5
"""Slower joints count as resting [rad/s]; steady after this long [s]."""
_SLIDER_RATE = 2.0
"""How fast the actual ratio follows the slider [1/s]."""
_HOLD_RATE = 5.0
"""How fast motion is brought to rest in a pause, and taken up again [1/s]."""


class Observed:
    """Of the joints.

    Attributes:
        qdd: shape (6,) [rad/s^2].
        power: what the joints draw, negative while they brake [W].
        used, braked: its sums since boot [J].
    """

    def __init__(self, measured: Measured) -> None:
        self._qd = measured.qd
        self._still_since = 0.0
        self.qdd = ZERO6
        self.power = self.used = self.braked = 0.0

    def take(self, measured: Measured, moving: bool, now: float) -> None:
        """After each cycle. moving: a motion is commanded."""
        self.qdd = (measured.qd - self._qd) / PERIOD
        self._qd = measured.qd
        self.power = float(measured.effort @ measured.qd)
        self.used += max(0.0, self.power) * PERIOD
        self.braked += max(0.0, -self.power) * PERIOD
        if moving or float(np.abs(measured.qd).max()) > _STILL:
            self._still_since = now

    def steady(self, now: float) -> bool:
        return now - self._still_since >= _STEADY_TIME


class Ratio:
    """The speed ratio of motions.

    Attributes:
        slider: follows the slider.
        held: 1 while motion is held on its path, 0 while it runs free.
    """

    def __init__(self) -> None:
        self.slider, self.held = 1.0, 0.0

    @property
    def motion(self) -> float:
        """Of the two together."""
        return self.slider * (1.0 - self.held)

    def tick(self, slider: float, hold: bool) -> None:
        """Move towards what is wanted."""
        step = _SLIDER_RATE * PERIOD
        self.slider += max(-step, min(step, slider - self.slider))
        step = _HOLD_RATE * PERIOD
        self.held = min(1.0, self.held + step) if hold else max(0.0, self.held - step)
