"""The hardware abstraction: what every backend, simulated or real, must do.

A backend is driven by `hil.node` alone, from one thread. It never decides: it follows the
set-points it is given, reports what it measures, and stops by itself when set-points stop
coming. `read_*` return the newest measurement with its own time; the node checks the age.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from cell.config import CellConfig
from cell.wire.types import (
    ArmStatus,
    Array,
    BeltState,
    CameraInfo,
    Frame,
    GripperState,
    JointState,
    Truth,
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
        """Robot mode, safety mode and speed scaling; the node fills in the executor's part.

        `stop_reason` names what of the robot's own keeps it from moving, where modes do not say it.
        """
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


@runtime_checkable
class NeedsArming(Protocol):
    """A backend whose device, after a stop of its own, follows set-points only once it is told to.

    Attributes:
        first_motion_speed: cap of the tool's speed in the first motion after a start or a stop [m/s].
    """

    first_motion_speed: float

    def prepare(self) -> None:
        """Get the device ready to follow again; never waits.

        Raises:
            RefusedError: it is not ready (yet); `busy` says that asking again helps.
        """
        ...

    def enable(self) -> None:
        """Follow from now on; the set-points start at the measured joints."""
        ...


@runtime_checkable
class TellsNews(Protocol):
    """A backend to whose devices things happen."""

    def news(self) -> list[tuple[int, str]]:
        """(level, text) of what happened since the last call; never waits."""
        ...


@runtime_checkable
class WorksAhead(Protocol):
    """A steppable backend that can do work of later steps, such as drawing pictures, ahead of time."""

    def work_ahead(self) -> bool:
        """Do a part of it, some ten milliseconds long; False when there is none."""
        ...


@runtime_checkable
class KnowsTruth(Protocol):
    """A backend that is, or has, a simulated world; `truth` is None where it has none."""

    truth: Callable[[], Truth] | None


def make_backend(
    name: str,
    config: CellConfig,
    *,
    seed: int = 0,
    onions: int = 15,
    person: str = "",
    robot_ip: str = "",
    cameras: str = "",
    apart: bool = False,
) -> Backend:
    """Build the backend called `name`; raises `ConfigError` listing the names there are.

    Args:
        seed, onions: the first batch, for simulated surroundings.
        person: name of the simulated person's persona; empty: nobody.
        robot_ip: address of the real arm's controller; empty: as configured.
        cameras: of the real arm: "real", "sim", or a recording. apart: let them publish for themselves
            where they can, on the wire of `config`, which must be open before `connect`.
    """
    from cell.errors import ConfigError, one_of

    if name == "sim":
        from hil.sim.backend import SimBackend

        return SimBackend(config, seed, onions, person)
    if name == "ur3e":
        from hil.ur3e.backend import Ur3eBackend

        return Ur3eBackend(
            config, robot_ip, cameras or "real", seed=seed, onions=onions, person=person, apart=apart
        )
    raise ConfigError(f"backend: {one_of(name, ['sim', 'ur3e'])}")
