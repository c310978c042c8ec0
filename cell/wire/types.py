"""Messages as the project's code sees them: frozen dataclasses in SI units.

`cell.wire.codec` turns each into a ROS 2 message in CDR and back; nothing else in the
project touches wire formats. Times are seconds of the node's clock (`t`); arrays are
float64 unless said otherwise and must not be written to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.wire.types_person import Hands as Hands
from cell.wire.types_person import PersonTruth as PersonTruth
from cell.wire.types_person import SeenHand as SeenHand
from cell.wire.types_person import ShownGesture as ShownGesture
from cell.wire.types_person import Truth as Truth
from cell.wire.types_person import TruthRequest as TruthRequest
from cell.wire.types_watch import Event as Event
from cell.wire.types_watch import NextRound as NextRound
from cell.wire.types_watch import OperatorCommand as OperatorCommand
from cell.wire.types_watch import PlannedPath as PlannedPath

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointState:
    """Measured arm state. q [rad], qd [rad/s], effort [Nm], each shape (6,)."""

    t: float
    q: Array
    qd: Array
    effort: Array


@dataclass(frozen=True)
class ArmStatus:
    """State of the arm and of the node's trajectory executor.

    Attributes:
        robot_mode, safety_mode: Universal Robots numbering (7 running; 1 normal, 3 protective stop).
        speed_scaling: ratio 0..1 at which the controller follows trajectories.
        trajectory_id: id of the running trajectory, or of the last one; 0 before the first.
        progress: 0..1 along that trajectory, in time.
        moving: a trajectory is being executed or braked.
        stopped: a stop is latched; motion needs a deliberate `Resume`.
        stop_reason: why, empty when not stopped.
        last_refusal: code and reason of the last refused command, empty if none.
        lease: holder of the command lease, empty if none.
    """

    t: float
    robot_mode: int = 7
    safety_mode: int = 1
    speed_scaling: float = 1.0
    trajectory_id: int = 0
    progress: float = 0.0
    moving: bool = False
    stopped: bool = False
    stop_reason: str = ""
    last_refusal: str = ""
    lease: str = ""


@dataclass(frozen=True)
class Trajectory:
    """A timed joint trajectory; the node interpolates it with cubic Hermite segments.

    Attributes:
        id: positive, new for each trajectory.
        holder: who sends it; must hold the lease.
        start: node time [s] of its first point; 0 starts a resting arm at the next tick.
        expires: node time [s] after which the node must not accept it.
        times: shape (N,) [s] from the start, strictly rising, times[0] = 0.
        q, qd: shape (N, 6) [rad], [rad/s].
    """

    id: int
    holder: str
    start: float
    expires: float
    times: Array
    q: Array
    qd: Array


@dataclass(frozen=True)
class Reply:
    """Answer to every command: accepted, or refused with a code and a readable reason."""

    accepted: bool
    code: str = ""
    reason: str = ""


@dataclass(frozen=True)
class Stop:
    """Stop the arm on its path. Anyone may send it."""

    holder: str
    reason: str


@dataclass(frozen=True)
class Resume:
    """Lift a latched stop. Deliberate; only the lease holder; never starts motion by itself."""

    holder: str


@dataclass(frozen=True)
class GripperCommand:
    """Move the fingers. width [m] between the pads, speed [m/s], force [N]; expires [s]."""

    holder: str
    expires: float
    width: float
    speed: float
    force: float


@dataclass(frozen=True)
class GripperState:
    """Measured gripper. width and target [m]; `holding`: stopped on an object before the target."""

    t: float
    width: float
    target: float
    moving: bool
    holding: bool


@dataclass(frozen=True)
class LightCommand:
    """Show `signal` on the cell's mode light, one of `vocabulary.SIGNALS`; expires [s]."""

    holder: str
    expires: float
    signal: str


@dataclass(frozen=True)
class BeltCommand:
    """Bring the next batch of `onions` onions, drawn from `seed`."""

    holder: str
    onions: int
    seed: int


@dataclass(frozen=True)
class BeltState:
    """The belt: batch number, whether it moves, speed [m/s]."""

    t: float
    batch: int
    moving: bool
    speed: float


@dataclass(frozen=True)
class CameraInfo:
    """Pinhole intrinsics of a camera stream; fx, fy, cx, cy [px]."""

    t: float
    frame: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class Frame:
    """One RGB-D capture, both images registered to the colour camera.

    Attributes:
        camera: "belt" or "person". seq: counts this camera's captures from 1.
        t: node time of the exposure [s].
        rgb: shape (H, W, 3) uint8.
        depth: shape (H, W) float32 [m] along the optical axis; 0 where there is no reading.
    """

    camera: str
    seq: int
    t: float
    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]


@dataclass(frozen=True)
class Capture:
    """Ask a camera for one frame now; it arrives after the camera's latency."""

    holder: str


@dataclass(frozen=True)
class Heartbeat:
    """The supervisor lives; the first holder to beat gets the lease."""

    holder: str
    seq: int
    t: float


@dataclass(frozen=True)
class Box:
    """One detection: pixel box (x0, y0, x1, y1), class name, score 0..1."""

    box: tuple[float, float, float, float]
    label: str
    score: float


@dataclass(frozen=True)
class Detections:
    """Detections in the frame of camera `camera` taken at `t` [s]."""

    t: float
    camera: str
    boxes: tuple[Box, ...]


@dataclass(frozen=True)
class SupervisorState:
    """What a watcher needs to understand the robot; enumerations of `vocabulary`.

    Attributes:
        belief: P(the person is fatigued). requested_industrial, permitted_industrial: mode logic.
        separation: [m], infinity when nobody is configured. speed_cap: TCP cap in force [m/s].
        binding_cap: name of the cap that binds. target: world position (3,) [m] of the onion in focus.
        reason: why the last action ended.
        human_action: what the person is believed to do, with confidence 0..1 (an `Action`).
        gesture: "", "up" or "down": the sign that was recognised last and still holds.
        separation_age: of the separation [s]; infinity without a usable person camera.
        yields: how often the robot gave way to the person. light: signal on the mode light.
        by_human: onions that the person was seen to sort.
    """

    t: float
    mode: int
    action: int
    phase: str
    onion_location: int
    eef_location: int
    prediction: int
    own_type: int
    belief: float
    requested_industrial: bool
    permitted_industrial: bool
    separation: float
    speed_cap: float
    binding_cap: str
    sorted: int
    in_bin: int
    on_conveyor: int
    remaining: int
    reason: str
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    human_action: int = 0
    human_confidence: float = 0.0
    gesture: str = ""
    separation_age: float = 0.0
    yields: int = 0
    light: str = ""
    by_human: int = 0


@dataclass(frozen=True)
class StepRequest:
    """Lock-step: advance the simulation by `ticks` control periods."""

    holder: str
    ticks: int


@dataclass(frozen=True)
class StepReply:
    """Everything the node has to say after a step; nothing depends on message order."""

    joint_state: JointState
    arm_status: ArmStatus
    gripper_state: GripperState
    belt_state: BeltState
    frames: tuple[Frame, ...] = ()


@dataclass(frozen=True)
class ResetRequest:
    """Simulation: rebuild the world from `seed` with `onions` onions; time restarts at 0."""

    holder: str
    seed: int
    onions: int


@dataclass(frozen=True)
class ClockTick:
    """The node's present time t [s], simulated or wall clock."""

    t: float


@dataclass(frozen=True)
class Image:
    """One half of a `Frame` as it is published.

    Attributes:
        t: node time of the exposure [s].
        camera: "belt" or "person".
        pixels: shape (H, W, 3) uint8 colour, or (H, W) float32 depth [m].
    """

    t: float
    camera: str
    pixels: NDArray[np.uint8] | NDArray[np.float32]
