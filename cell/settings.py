"""The sections of the configuration, strictly typed. Units are SI, angles are radians.

`cell.config` puts them together, reads files and checks what types cannot say.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
from msgspec import Meta

Vec3 = tuple[float, float, float]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1, le=1000)]
Pixels = Annotated[int, Meta(ge=16, le=4096)]


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all sections: immutable, and closed to unknown keys."""


class ArmConfig(Section, frozen=True):
    """The arm and how it is driven."""

    control_period: Annotated[float, Meta(gt=0, le=0.1)]
    """Period of the node's trajectory executor [s]."""
    physics_substeps: Count
    """Simulation: physics steps per control period."""
    lag: Annotated[float, Meta(ge=0, lt=0.5)]
    """Simulation: delay between a set-point and the joints following it [s] (servoj lookahead)."""
    home: tuple[float, float, float, float, float, float]
    """Joint angles [rad] at which the arm is clear of the belt camera's view."""
    max_acceleration: Positive
    """Joint acceleration limit [rad/s^2] (Universal Robots publishes none)."""
    velocity_scale: Annotated[float, Meta(gt=0, le=1)]
    """Fraction of the URDF's joint speed limits that plans may use."""


class GripperConfig(Section, frozen=True):
    """Parallel gripper; defaults are those of the Robotiq 2F-85."""

    stroke: Positive
    """Largest distance between the pads [m]."""
    length: Positive
    """Flange to tool centre point [m]."""
    min_speed: Positive
    max_speed: Positive
    """Finger speed range, each pad relative to the other [m/s]."""
    min_force: Positive
    max_force: Positive
    """Grip force range [N]."""
    grip_speed: Positive
    grip_force: Positive
    """What the supervisor asks for when it takes an onion [m/s], [N]."""


class BeltConfig(Section, frozen=True):
    """The conveyor: a box along y whose top is where onions lie."""

    top_z: float
    """Height of the belt's surface [m]."""
    x: tuple[float, float]
    """Extent across the belt [m]."""
    y: tuple[float, float]
    """Extent along the belt [m]."""
    pick_x: tuple[float, float]
    pick_y: tuple[float, float]
    """The robot's working window on the belt [m]; every pose in it must be reachable."""


class BinConfig(Section, frozen=True):
    """The open bin for blemished onions."""

    center: Vec3
    """Centre of the bin's opening [m]."""
    size: tuple[Positive, Positive, Positive]
    """Inner width (x), inner length (y), depth (z) [m]."""
    drop_height: NotNegative
    """Height of the held onion's centre above the opening when it is let go [m]."""


class RobotBinConfig(BinConfig, frozen=True):
    """The open bin into which the robot drops blemished onions."""

    drop_spread: NotNegative = 0.0  # what recordings without this key did
    """Onions are let go up to this far from the centre in x and y, so that none stands on another [m]."""


class CalibrationConfig(Section, frozen=True):
    """What `cell calibrate` measured of one camera; written by it, not by hand."""

    position: Vec3
    """Optical centre in W [m]."""
    quaternion: tuple[float, float, float, float]
    """R_WC as (x, y, z, w)."""
    focal: tuple[Positive, Positive]
    """fx, fy [px]."""
    centre: tuple[float, float]
    """cx, cy [px]; (0, 0) is the middle of the top-left pixel."""
    measured_at: tuple[Pixels, Pixels, Positive]
    """Width [px], height [px] and hfov [rad] that were configured then; others need a new calibration."""
    views: Count
    """Poses of the board that it rests on."""
    residual: NotNegative
    """Root mean square distance of the seen corners from where they should be [px]."""
    uncertainty: tuple[NotNegative, NotNegative]
    """Standard deviations of the pose [m], [rad], by the residuals."""
    date: str
    """When, as 2026-01-31T12:00:00Z."""
    made_by: str
    """The command's version and the robot: "sim", or the controller's address."""


class MisplacedConfig(Section, frozen=True):
    """Simulation: how a camera differs from its position, target and hfov."""

    shift: Vec3 = (0.0, 0.0, 0.0)
    """Of the optical centre, in W [m]."""
    turn: Vec3 = (0.0, 0.0, 0.0)
    """About the camera's own axes, a rotation vector [rad]."""
    focal: tuple[Positive, Positive] = (1.0, 1.0)
    """Factors on fx and fy."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Added to cx and cy [px]."""


class CameraConfig(Section, frozen=True):
    """An RGB-D camera; X_WC follows from position and target, or from its calibration."""

    position: Vec3
    target: Vec3
    """The optical axis passes from `position` through `target` [m]."""
    width: Pixels
    height: Pixels
    hfov: Annotated[float, Meta(gt=0, lt=math.pi)]
    """Horizontal field of view of the colour image [rad]."""
    rate: NotNegative
    """Frames per second in free-running mode [Hz]; 0: on demand only."""
    latency: NotNegative
    """Exposure to delivery [s]."""
    min_depth: Positive
    max_depth: Positive
    """Depth outside is reported as missing [m]."""
    depth_baseline: Positive
    """Stereo baseline [m]."""
    depth_focal: Positive
    """Focal length of the depth imagers [px]."""
    disparity_noise: NotNegative
    """Standard deviation of the disparity [px]."""
    depth_unit: Positive
    """Quantum of a depth reading [m]."""
    calibration: CalibrationConfig | None = None
    """Measured pose and intrinsics, which then hold instead of position, target and hfov."""
    simulated: MisplacedConfig | None = None
    """Simulation only: where the camera really is. The supervisor never reads it."""


class BoardConfig(Section, frozen=True):
    """The calibration board: a plate with a ChArUco pattern, held upright between the finger pads.

    Its pattern faces along x of the TCP frame, its upper edge along z.
    """

    columns: Annotated[int, Meta(ge=3, le=20)] = 6
    rows: Annotated[int, Meta(ge=3, le=20)] = 4
    """Squares of the pattern."""
    square: Positive = 0.045
    """Side of a square [m]; measure what the printer made of it."""
    marker: Annotated[float, Meta(gt=0.3, lt=1)] = 0.75
    """Side of a marker as a share of the square's."""
    dictionary: str = "4X4_50"
    """OpenCV's dictionary of markers, without DICT_."""
    margin: Positive = 0.25
    """White round the pattern as a share of a square."""
    height: float = 0.12
    """Height of the pattern's middle above the TCP, along z of the TCP frame [m]; roughly."""
    mounted: bool = False
    """Simulation: the board is between the finger pads."""
    shift: Vec3 = (0.0, 0.0, 0.0)
    turn: Vec3 = (0.0, 0.0, 0.0)
    """Simulation: how the board really sits, in its own frame [m], rotation vector [rad]."""


class PersonConfig(Section, frozen=True):
    """Where the person works and rests, and what is the person's own part of the cell."""

    station: tuple[float, float]
    """Where the person stands at the belt, facing it: the pelvis in x, y [m]."""
    rest: tuple[float, float]
    """Where the person goes to rest: the pelvis in x, y [m]."""
    reach_x: tuple[float, float]
    """Across the belt, from where the person takes onions [m]."""
    sorted_x: tuple[float, float]
    """The strip along the belt on which the person puts sound onions [m]: beyond the robot's window."""
    bin: BinConfig
    """The person's own bin."""


class SeparationConfig(Section, frozen=True):
    """Speed and separation: S_p = v_h (T_r + T_s) + v_r T_r + S_s + C + Z_d + Z_r (ISO/TS 15066, 5.5.4)."""

    human_speed: Positive
    """v_h: of an approaching person [m/s]."""
    reaction_time: Positive
    """T_r: exposure to the first braking set-point [s]."""
    deceleration: Positive
    """Braking of the tool that T_s and S_s are computed from [m/s^2]."""
    intrusion: NotNegative
    """C: how far a part of the body may reach in before it is seen [m]."""
    sensor_error: NotNegative
    """Z_d: of the measured separation [m]."""
    robot_error: NotNegative
    """Z_r: of the robot's position [m]."""
    max_age: Positive
    """A separation older than this counts as a present person [s]."""
    least_seen: Share
    """Share of the person camera's pixels that must have depth; below it the camera counts as blocked."""
    permit: Positive
    """Industrial mode is permitted from this separation on [m] ..."""
    permit_hold: NotNegative
    """... once it has lasted this long [s]."""
    patience: Positive
    """How long the arm waits for a person in its way before it gives the motion up [s]."""
    give_way: Positive
    """The robot leaves an onion that the person's hand is this near to [m]."""
    hold: Positive
    """The arm waits when its path comes nearer than this to the person [m], ..."""
    release: Positive
    """... and goes on when the path is this far away [m]."""


class GestureConfig(Section, frozen=True):
    """When a sign counts."""

    models: str
    """Folder with the hand networks; empty: the cache that `tools/run` fills."""
    votes: Count
    """How many of the last `window` frames must show the sign."""
    window: Count
    height: NotNegative
    """A sign counts only with the hand at least this high above the belt [m]."""
    crop: Positive
    """Side of the square around a hand that the networks get [m]."""


class OnionConfig(Section, frozen=True):
    """The produce."""

    diameter: tuple[Positive, Positive]
    """Smallest and largest diameter [m]."""
    blemished_share: Share
    """Probability that an onion carries blemishes."""
    spacing: Positive
    """Least distance between the centres of neighbours on the belt [m]."""


class MotionConfig(Section, frozen=True):
    """Speed and shape of motions."""

    collaborative_speed: Positive
    """TCP speed cap beside a person [m/s]."""
    industrial_speed: Positive
    """TCP speed cap when the person is away [m/s]."""
    speed_margin: Annotated[float, Meta(gt=0, le=1)]
    """Plans use this fraction of the TCP cap."""
    acceleration_margin: Annotated[float, Meta(gt=0, le=1)]
    """Plans use this fraction of the joint acceleration limit."""
    hover: Positive
    """Height of the TCP above an onion's centre before and after grasping [m]."""
    clearance: NotNegative
    """Least distance kept between the arm and the cell's fixed parts when planning [m]."""
    longest_braking: Positive = 0.35
    """Under the collaborative cap every joint can be braked to rest within this time [s]."""
    late_braking: Positive = 0.15
    """Under higher caps, within this time from when a person walking up has ended industrial mode [s]."""


class SupervisorConfig(Section, frozen=True):
    """The decision loop."""

    ticks_per_cycle: Count
    """Control periods per supervisor tick."""
    heartbeat_deadline: Positive
    """The node stops the arm when the supervisor has been silent for this long [s]."""
    command_lifetime: Positive
    """Commands older than this are refused [s]."""
    max_frame_age: Positive
    """Camera frames older than this are not used [s]."""
    max_state_age: Positive
    """Joint states older than this stop the supervisor [s]."""
    belief: str
    """The belief about the person: gru, last-gesture, none, or a file of weights (.safetensors)."""
    seam_lead: Positive
    """How far ahead of now a change of a running motion is planned at first [s]."""
    grasp_attempts: Count
    """Tries per onion before it is set aside as not graspable."""
    look_attempts: Count
    """Looks before a lost or uncertain detection is acted upon."""
    score_threshold: Share
    """Least detection score that counts."""
    round_timeout: Positive
    """Longest round [s]."""
    stop_patience: NotNegative = 0.0
    """How long a stopped round waits for an operator to resume it [s]; 0: it ends at once."""
