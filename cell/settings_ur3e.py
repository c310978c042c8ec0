"""The section of the configuration for a real arm, its driver, gripper and cameras; see `cell.settings`."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from cell.settings import Positive, Section, Vec3


class Ur3eConfig(Section, frozen=True):
    """The real arm: how its controller is reached and what hangs on its flange."""

    robot_ip: str
    """Address of the controller; empty: to be given with --robot-ip."""
    lookahead: Annotated[float, Meta(ge=0.03, le=0.2)]
    """servoj: how far ahead the controller smooths [s]."""
    gain: Annotated[float, Meta(ge=100, le=2000)]
    """servoj: how stiffly set-points are followed."""
    patience: Annotated[float, Meta(ge=0.008, le=0.5)]
    """The driver brakes when set-points have not come for this long [s]."""
    stop_deceleration: Annotated[float, Meta(gt=0, le=50)]
    """How the controller brakes the tool then [m/s^2]."""
    payload: Annotated[float, Meta(ge=0, le=3)]
    """Mass of gripper and onion [kg]."""
    payload_cog: Vec3
    """Its centre of gravity in the flange [m]."""
    first_motion_speed: Positive
    """The first motion after a start or a stop is slowed down to this speed of the tool [m/s]."""
    gripper_port: Annotated[int, Meta(ge=1, le=65535)]
    """Port of the gripper's URCap on the controller."""
    gripper_counts: tuple[Annotated[int, Meta(ge=0, le=255)], Annotated[int, Meta(ge=0, le=255)]]
    """What the gripper reports fully open and fully closed."""
    devices: dict[str, str]
    """Real cameras: name -> "realsense" or "oakd", a colon and the serial number where there are several."""
