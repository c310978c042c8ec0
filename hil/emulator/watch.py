"""What makes the controller stop by itself: set-points no joint may follow, joints that do not follow."""

from __future__ import annotations

import numpy as np

from cell.frames import Array
from hil.emulator.interfaces import Measured, MoverLike
from hil.emulator.models import Model

_SPEED_TOLERANCE = 0.02
"""A set-point may exceed the joint speed by 1.15 degrees per second [rad/s]."""
_ANGLE_TOLERANCE = 1e-3
MAX_DEVIATION = 0.35
"""Measured joints further off the set-point: something is in the way [rad]."""


def deviation(mover: MoverLike, measured: Measured) -> float:
    """Largest distance of a joint from its set-point [rad]."""
    return float(np.abs(mover.q - measured.q).max())


def objection(mover: MoverLike, measured: Measured, model: Model) -> str:
    """Why this set-point calls for a protective stop; empty if it does not."""
    if mover.trouble:
        return mover.trouble
    if not bool((np.abs(mover.q) <= model.q_max + _ANGLE_TOLERANCE).all()):
        return _of_joint("position", mover.q, model.q_max, "rad")
    if not bool((np.abs(mover.qd) <= model.qd_max + _SPEED_TOLERANCE).all()):
        return _of_joint("speed", mover.qd, model.qd_max, "rad/s")
    if not deviation(mover, measured) <= MAX_DEVIATION:
        return "Position deviates from path: something is in the way"
    return ""


def _of_joint(what: str, values: Array, limits: Array, unit: str) -> str:
    joint = int(np.argmax(np.nan_to_num(np.abs(values) / limits, nan=np.inf)))
    return f"Joint {joint} {what} limit: {values[joint]:.3f} {unit} asked, {limits[joint]:.3f} allowed"
