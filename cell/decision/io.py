"""What goes into a supervisor tick and what comes out: plain data, no I/O."""

from __future__ import annotations

from dataclasses import dataclass

from cell.wire.types import (
    ArmStatus,
    BeltState,
    Capture,
    Detections,
    Event,
    Frame,
    GripperCommand,
    GripperState,
    Hands,
    JointState,
    LightCommand,
    OperatorCommand,
    Reply,
    Resume,
    SupervisorState,
    Trajectory,
)

Order = Trajectory | GripperCommand | Capture | Resume | LightCommand
"""A message that the supervisor may send to the node."""


@dataclass(frozen=True)
class Command:
    """An order with the ticket under which its reply comes back.

    `camera` names the camera of a `Capture`.
    """

    ticket: int
    order: Order
    camera: str = ""


@dataclass(frozen=True)
class Inputs:
    """Everything the supervisor knows at one tick; all of it was checked for age.

    Attributes:
        t: node time [s].
        frames: camera frames that arrived since the last tick.
        replies: (ticket, reply) of commands sent at earlier ticks.
        operator: what an operator ordered since the last tick.
    """

    t: float
    joints: JointState
    arm: ArmStatus
    gripper: GripperState
    belt: BeltState
    frames: tuple[Frame, ...] = ()
    replies: tuple[tuple[int, Reply], ...] = ()
    operator: tuple[OperatorCommand, ...] = ()


@dataclass(frozen=True)
class Outputs:
    """What to send, in this order, and what to tell watchers.

    `done`: the round is over; `failure` says why when it did not complete.
    """

    commands: tuple[Command, ...]
    state: SupervisorState
    detections: tuple[Detections, ...] = ()
    events: tuple[Event, ...] = ()
    hands: tuple[Hands, ...] = ()
    done: bool = False
    failure: str = ""
