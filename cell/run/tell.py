"""What the supervisor tells watchers, recorders and viewers after every tick."""

from __future__ import annotations

import numpy as np

from cell.decision.io import Outputs
from cell.limits import tcp_positions
from cell.wire.session import Session
from cell.wire.types import PlannedPath, Trajectory

_PLACES = 40
"""Most places on a published path."""


def publish(session: Session, outputs: Outputs, gripper_length: float) -> None:
    """Put the state, what was perceived and said, and the paths of new trajectories on the wire."""
    keys = session.keys
    session.publish(keys.supervisor_state, outputs.state)
    for detections in outputs.detections:
        session.publish(keys.detections, detections)
    for hands in outputs.hands:
        session.publish(keys.hands, hands)
    for event in outputs.events:
        session.publish(keys.events, event)
    for command in outputs.commands:
        if isinstance(command.order, Trajectory):
            session.publish(keys.planned_path, planned_path(command.order, outputs.state.t, gripper_length))


def planned_path(trajectory: Trajectory, t: float, gripper_length: float) -> PlannedPath:
    """Where the tool is to go, at most `_PLACES` places of it."""
    which = np.linspace(0, len(trajectory.q) - 1, min(_PLACES, len(trajectory.q))).round().astype(int)
    return PlannedPath(t, tcp_positions(trajectory.q[which], gripper_length))
