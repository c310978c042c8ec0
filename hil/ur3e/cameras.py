"""Which cameras a real arm's backend gets: real ones, an emulated cell's, or a recording's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import ConfigError, one_of
from hil.cameras import CameraSource

if TYPE_CHECKING:
    from hil.emulator.world_client import SimSurroundings


def make_cameras(choice: str, config: CellConfig, robot_ip: str, clock: WallClock) -> dict[str, CameraSource]:
    """Cameras by name, not connected yet; raises `ConfigError` for a choice that names none.

    Args:
        choice: "real", "sim", or the path of a recording. clock: of the node.
    """
    if choice == "sim":
        from hil.emulator.world_client import SimCamera

        return {name: SimCamera(name, config, robot_ip) for name in config.cameras}
    if choice == "real":
        return {name: _real(name, config, clock) for name in config.cameras}
    if not Path(choice).exists():
        raise ConfigError(
            f"--cameras: {one_of(choice, ['sim', 'real', 'a recording or folder that exists'])}"
        )
    from hil.ur3e.file_camera import file_cameras

    return dict(file_cameras(Path(choice), config, clock))


def _real(name: str, config: CellConfig, clock: WallClock) -> CameraSource:
    if name not in config.ur3e.devices:
        raise ConfigError(f"ur3e.devices: says nothing of the camera '{name}'")
    kind, _, serial = config.ur3e.devices[name].partition(":")
    if kind == "realsense":
        from hil.ur3e.realsense import RealSense

        return RealSense(name, config.cameras[name], serial, clock)
    from hil.ur3e.oakd import OakD

    return OakD(name, config.cameras[name], serial, clock)


def make_surroundings(config: CellConfig, robot_ip: str) -> SimSurroundings:
    """Truth and batches of an emulated controller's cell; raises `WireError` when there is none."""
    from hil.emulator.world_client import SimSurroundings

    return SimSurroundings(config, robot_ip)
