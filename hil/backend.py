"""The hardware abstraction: what every backend, simulated or real, must do.

A backend is driven by `hil.node` alone, from one thread. It never decides: it follows the
set-points it is given, reports what it measures, and stops by itself when set-points stop
coming. `read_*` return the newest measurement with its own time; the node checks the age.
"""

from __future__ import annotations

from typing import Protocol

from cell.config import CellConfig
from cell.wire.types import (
    ArmStatus,
    Array,
    BeltState,
    CameraInfo,
    Frame,
    GripperState,
    JointState,
)


class Backend(Protocol):
    """One robot cell: an arm, a gripper, a belt and cameras.

    Life cycle: `connect` -> (`command_*`, `advance`, `read_*`)* -> `close`. `close` may be
    called at any time, more than once, and leaves the arm at rest.
    """

    name: str
    #: True when time moves only by `advance` (simulation); the node can then run lock-step.
    steppable: bool

    def connect(self) -> None:
        """Open devices. Raises `CellError` with what to do when something is absent."""
        ...

    def now(self) -> float:
        """The backend's time [s]: simulated, or wall clock."""
        ...

    def command_joints(self, q: Array, qd: Array) -> None:
        """Next set-point of the arm: q [rad], qd [rad/s], shape (6,), for the coming period."""
        ...

    def command_gripper(self, width: float, speed: float, force: float) -> tuple[float, float, float]:
        """Move the fingers; returns (width, speed, force) really sent, clipped to the device."""
        ...

    def command_light(self, signal: str) -> None:
        """Show one of `vocabulary.SIGNALS` on the mode light."""
        ...

    def command_belt(self, onions: int, seed: int) -> None:
        """Bring the next batch."""
        ...

    def advance(self) -> None:
        """Let one control period pass: step the simulation, or wait for the real cycle."""
        ...

    def read_joints(self) -> JointState: ...

    def read_status(self) -> ArmStatus:
        """Robot mode, safety mode and speed scaling; the node fills in the executor's part."""
        ...

    def read_gripper(self) -> GripperState: ...

    def read_belt(self) -> BeltState: ...

    def camera_info(self, camera: str) -> CameraInfo: ...

    def request_frame(self, camera: str) -> None:
        """Expose one frame now. Raises `CellError` listing the cameras for an unknown name."""
        ...

    def take_frames(self) -> list[Frame]:
        """Frames whose latency has passed since the last call, oldest first."""
        ...

    def close(self) -> None: ...


def make_backend(
    name: str, config: CellConfig, *, seed: int = 0, onions: int = 15, person: str = ""
) -> Backend:
    """Build the backend called `name`; raises `ConfigError` listing the names there are.

    Args:
        seed, onions: the first batch, for simulated backends.
        person: name of the simulated person's persona; empty: nobody.
    """
    from cell.errors import ConfigError, one_of

    if name == "sim":
        from hil.sim.backend import SimBackend

        return SimBackend(config, seed, onions, person)
    raise ConfigError(f"backend: {one_of(name, ['sim'])}")
