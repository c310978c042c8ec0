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
from cell.settings import (
    ArmConfig,
    BeltConfig,
    BoardConfig,
    CameraConfig,
    GestureConfig,
    GripperConfig,
    MotionConfig,
    OnionConfig,
    PersonConfig,
    RobotBinConfig,
    Section,
    SeparationConfig,
    SupervisorConfig,
)
from cell.settings_ur3e import Ur3eConfig


class CellConfig(Section, frozen=True):
    """The whole cell."""

    name: str
    """Prefix of all wire keys."""
    port: Annotated[int, Meta(ge=1024, le=65535)]
    """TCP port of the node's Zenoh endpoint on the loopback interface."""
    arm: ArmConfig
    gripper: GripperConfig
    belt: BeltConfig
    bin: RobotBinConfig
    floor_z: Annotated[float, Meta(lt=0)]
    """Height of the shop floor below the robot's base plane [m]."""
    cameras: dict[str, CameraConfig]
    person: PersonConfig
    separation: SeparationConfig
    gestures: GestureConfig
    onions: OnionConfig
    motion: MotionConfig
    supervisor: SupervisorConfig
    ur3e: Ur3eConfig
    board: BoardConfig = BoardConfig()
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
    data = read_yaml(reference_cell())
    if path is not None:
        data = _overlay(data, read_yaml(Path(path)), where="", source=Path(path))
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


def read_yaml(path: Path) -> dict[str, Any]:
    """What a file says, not checked yet; raises `ConfigError` when it is no YAML mapping."""
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


DICTIONARIES = tuple(f"{bits}X{bits}_{count}" for bits in (4, 5, 6) for count in (50, 100, 250))
"""Marker dictionaries of OpenCV that a board may use."""
_OPTIONAL = {"": {"renderer", "detector", "board"}}
"""Keys that the reference cell does without, by section."""


def _overlay(base: dict[str, Any], top: dict[str, Any], where: str, source: Path) -> dict[str, Any]:
    """Recursive merge in which a key that the base lacks is an error naming the legal ones."""
    out = dict(base)
    optional = _OPTIONAL.get(where, set())
    if where.startswith("cameras.") and where.count(".") == 2:
        optional = {"calibration", "simulated"}
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
        (
            config.ur3e.gripper_counts[0] < config.ur3e.gripper_counts[1],
            "ur3e.gripper_counts: open < closed",
        ),
        (
            all(device.partition(":")[0] in ("realsense", "oakd") for device in config.ur3e.devices.values()),
            "ur3e.devices: realsense or oakd, and where needed a colon and the serial number",
        ),
        (config.board.dictionary in DICTIONARIES, f"board.dictionary: one of {', '.join(DICTIONARIES)}"),
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
            (
                camera.calibration is None
                or math.dist(camera.calibration.measured_at, (camera.width, camera.height, camera.hfov))
                < 1e-9,
                f"{where}.calibration: measured with the present width, height and hfov; calibrate again",
            ),
            (
                camera.calibration is None or abs(math.hypot(*camera.calibration.quaternion) - 1) < 1e-3,
                f"{where}.calibration.quaternion: of length 1",
            ),
        ]
    for fine, rule in rules:
        if not fine:
            raise ConfigError(f"configuration violates: {rule}")
