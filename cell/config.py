"""Configuration: one YAML file, strictly typed; unknown keys are errors that name the key.

`CellConfig` describes the cell (geometry, devices, limits, timing). The defaults live in
`urdf/cell.yaml`, the description of the reference cell; a user's file is laid over it.
Units are SI, angles are radians, positions are in the world frame W (= ROS `base_link`).
"""

from __future__ import annotations

import math
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import msgspec
import yaml
from msgspec import Meta

from cell.errors import ConfigError

Vec3 = tuple[float, float, float]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1, le=1000)]
Pixels = Annotated[int, Meta(ge=16, le=4096)]


class _Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all sections: immutable, and closed to unknown keys."""


class ArmConfig(_Strict, frozen=True):
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


class GripperConfig(_Strict, frozen=True):
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


class BeltConfig(_Strict, frozen=True):
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


class BinConfig(_Strict, frozen=True):
    """The open bin for blemished onions."""

    center: Vec3
    """Centre of the bin's opening [m]."""
    size: tuple[Positive, Positive, Positive]
    """Inner width (x), inner length (y), depth (z) [m]."""
    drop_height: NotNegative
    """Height of the held onion's centre above the opening when it is let go [m]."""


class CameraConfig(_Strict, frozen=True):
    """An RGB-D camera; X_WC follows from position and target."""

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


class PersonConfig(_Strict, frozen=True):
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


class SeparationConfig(_Strict, frozen=True):
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


class GestureConfig(_Strict, frozen=True):
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


class OnionConfig(_Strict, frozen=True):
    """The produce."""

    diameter: tuple[Positive, Positive]
    """Smallest and largest diameter [m]."""
    blemished_share: Share
    """Probability that an onion carries blemishes."""
    spacing: Positive
    """Least distance between the centres of neighbours on the belt [m]."""


class MotionConfig(_Strict, frozen=True):
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


class SupervisorConfig(_Strict, frozen=True):
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


class CellConfig(_Strict, frozen=True):
    """The whole cell."""

    name: str
    """Prefix of all wire keys."""
    port: Annotated[int, Meta(ge=1024, le=65535)]
    """TCP port of the node's Zenoh endpoint on the loopback interface."""
    arm: ArmConfig
    gripper: GripperConfig
    belt: BeltConfig
    bin: BinConfig
    floor_z: Annotated[float, Meta(lt=0)]
    """Height of the shop floor below the robot's base plane [m]."""
    cameras: dict[str, CameraConfig]
    person: PersonConfig
    separation: SeparationConfig
    gestures: GestureConfig
    onions: OnionConfig
    motion: MotionConfig
    supervisor: SupervisorConfig
    renderer: str = "auto"
    """Simulation: "gl", "tiny", or "auto" (gl where EGL works, else tiny with a warning)."""
    detector: str = ""
    """Path of other detector weights (.safetensors); empty: the shipped ones."""


def reference_cell() -> Path:
    """Path of the reference cell's description, `urdf/cell.yaml`."""
    return Path(str(files("urdf") / "cell.yaml"))


def load(path: Path | str | None = None) -> CellConfig:
    """Read the reference cell, lay the file at `path` over it, and check the result.

    Raises:
        ConfigError: the file is missing, not YAML, or has unknown, ill-typed or impossible
            values; the message names the key.
    """
    data = _read_yaml(reference_cell())
    if path is not None:
        data = _overlay(data, _read_yaml(Path(path)), where="", source=Path(path))
    config = from_dict(data, source=path or reference_cell())
    _check(config)
    return config


def from_dict(data: Any, source: object = "configuration") -> CellConfig:
    """Typed configuration from plain data; raises `ConfigError` naming the offending key."""
    if unusable := _not_finite(data):
        raise ConfigError(f"{source}: '{unusable}' must be a finite number")
    try:
        return msgspec.convert(data, CellConfig, strict=False)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{source}: {error}") from None


def _not_finite(data: Any, where: str = "") -> str:
    """Dotted key of the first number that is infinite or not a number; empty if all are fine."""
    if isinstance(data, dict):
        entries = [(f"{where}.{key}" if where else str(key), value) for key, value in data.items()]
    elif isinstance(data, list):
        entries = [(where, value) for value in data]
    else:
        return where if isinstance(data, float) and not math.isfinite(data) else ""
    return next((found for key, value in entries if (found := _not_finite(value, key))), "")


def to_dict(config: CellConfig) -> dict[str, Any]:
    """Plain data of a configuration (the inverse of `from_dict`)."""
    return msgspec.to_builtins(config)  # type: ignore[no-any-return]


class _Loader(yaml.SafeLoader):
    """YAML in which a key given twice is an error; plain YAML would silently take the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for name in names:
            if names.count(name) > 1:
                raise yaml.constructor.ConstructorError(problem=f"key '{name}' is given twice")
        return super().construct_mapping(node, deep)


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        data = yaml.load(path.read_text(), _Loader)
    except OSError as error:
        raise ConfigError(f"cannot read configuration {path}: {error.strerror}") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise ConfigError(f"{path} is not valid YAML: nested too deeply") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path} is not a text file") from None
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: expected a mapping of sections at the top level")
    return data


def _overlay(base: dict[str, Any], top: dict[str, Any], where: str, source: Path) -> dict[str, Any]:
    """Recursive merge in which a key that the base lacks is an error naming the legal ones."""
    out = dict(base)
    optional = {"renderer", "detector"} if not where else set()
    for key, value in top.items():
        name = f"{where}{key}"
        if key not in base and key not in optional and where != "cameras.":
            legal = ", ".join(sorted({*base, *optional}))
            raise ConfigError(f"{source}: unknown key '{name}'; legal keys here: {legal}")
        if isinstance(base.get(key), dict):
            if not isinstance(value, dict):
                raise ConfigError(f"{source}: '{name}' must be a section, got {value!r}")
            out[key] = _overlay(base[key], value, f"{name}.", source)
        else:
            out[key] = value
    return out


def _check(config: CellConfig) -> None:
    """Values that types cannot rule out."""
    belt, gripper = config.belt, config.gripper
    rules = [
        (belt.x[0] < belt.x[1] and belt.y[0] < belt.y[1], "belt.x, belt.y: lower < upper"),
        (
            belt.x[0] <= belt.pick_x[0] < belt.pick_x[1] <= belt.x[1]
            and belt.y[0] <= belt.pick_y[0] < belt.pick_y[1] <= belt.y[1],
            "belt.pick_x, belt.pick_y: a window inside belt.x, belt.y",
        ),
        (
            config.motion.collaborative_speed <= config.motion.industrial_speed,
            "motion: collaborative_speed <= industrial_speed",
        ),
        (
            gripper.min_speed <= gripper.grip_speed <= gripper.max_speed,
            "gripper.min_speed <= gripper.grip_speed <= gripper.max_speed",
        ),
        (
            gripper.min_force <= gripper.grip_force <= gripper.max_force,
            "gripper.min_force <= gripper.grip_force <= gripper.max_force",
        ),
        (config.floor_z < belt.top_z - 0.2, "floor_z: at least 0.2 m below belt.top_z"),
        (
            belt.x[0] <= config.person.reach_x[0] < config.person.reach_x[1] <= belt.x[1],
            "person.reach_x: a range inside belt.x",
        ),
        (
            belt.pick_x[1] < config.person.sorted_x[0] < config.person.sorted_x[1] <= belt.x[1],
            "person.sorted_x: a range between the robot's window belt.pick_x and the far edge of the belt",
        ),
        (
            config.separation.hold < config.separation.release,
            "separation: hold < release",
        ),
        (config.gestures.votes <= config.gestures.window, "gestures: votes <= window"),
        ("belt" in config.cameras, "cameras: needs one called 'belt'"),
        (
            config.onions.diameter[0] <= config.onions.diameter[1] < gripper.stroke,
            "onions.diameter: smallest <= largest < gripper.stroke",
        ),
        (config.onions.spacing >= config.onions.diameter[1], "onions.spacing: at least the largest diameter"),
        (config.renderer in ("auto", "gl", "tiny"), "renderer: auto, gl or tiny"),
        (config.name.replace("_", "").isalnum(), "name: letters, digits and _"),
    ]
    for name, camera in config.cameras.items():
        where = f"cameras.{name}"
        sideways = math.dist(camera.position[:2], camera.target[:2])
        rules += [
            (name.replace("_", "").isalnum(), f"{where}: letters, digits and _"),
            (sideways > 1e-3, f"{where}.target: not straight above or below {where}.position"),
            (camera.min_depth < camera.max_depth, f"{where}.min_depth < {where}.max_depth"),
        ]
    for fine, rule in rules:
        if not fine:
            raise ConfigError(f"configuration violates: {rule}")
