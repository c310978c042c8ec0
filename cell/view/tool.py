"""How fast the tool moves."""

from __future__ import annotations

import numpy as np

from cell.limits import tcp_jacobian
from cell.wire.types import JointState


def tool_speed(joints: JointState, gripper_length: float) -> float:
    """Speed of the tool centre point [m/s]."""
    J = tcp_jacobian(joints.q[None], gripper_length)[0]
    return float(np.linalg.norm(J @ joints.qd))
