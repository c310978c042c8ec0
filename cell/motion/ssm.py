"""Speed and separation: which tool speed a measured separation allows.

ISO/TS 15066, 5.5.4: S_p = v_h (T_r + T_s) + v_r T_r + S_s + C + Z_d + Z_r. With the tool braking
at a, T_s = v_r / a and S_s = v_r^2 / (2 a); the largest v_r with S_p <= d solves a quadratic.
This is a supervision of speed in software, not a safety function.
"""

from __future__ import annotations

import math

from cell.settings import SeparationConfig


def allowed_speed(d: float, c: SeparationConfig) -> float:
    """Largest tool speed [m/s] whose protective separation is at most `d` [m]; 0 when there is none."""
    if math.isinf(d):
        return math.inf
    left = d - (c.human_speed * c.reaction_time + c.intrusion + c.sensor_error + c.robot_error)
    if left <= 0.0:
        return 0.0
    slope = c.human_speed / c.deceleration + c.reaction_time
    return c.deceleration * (math.sqrt(slope**2 + 2.0 * left / c.deceleration) - slope)


def protective_separation(v: float, c: SeparationConfig) -> float:
    """S_p [m] at tool speed v [m/s]."""
    return (
        c.human_speed * (c.reaction_time + v / c.deceleration)
        + v * c.reaction_time
        + v**2 / (2.0 * c.deceleration)
        + c.intrusion
        + c.sensor_error
        + c.robot_error
    )
