"""The names of all channels, in one place."""

from __future__ import annotations

from dataclasses import dataclass

from cell.errors import WireError, one_of

#: What a camera offers under its name; `capture` is a query, the others are published.
CAMERA_CHANNELS = ("color", "depth", "camera_info", "capture")


@dataclass(frozen=True)
class Keys:
    """Zenoh keys of one cell.

    Attributes:
        name: the cell's name, prefix of every key (`CellConfig.name`).
    """

    name: str = "cell"

    @property
    def clock(self) -> str:
        """`ClockTick`, node -> all: the node's time."""
        return f"{self.name}/clock"

    @property
    def joint_states(self) -> str:
        """`JointState`, node -> all, every control period."""
        return f"{self.name}/arm/joint_states"

    @property
    def arm_status(self) -> str:
        """`ArmStatus`, node -> all, 25 Hz and on change."""
        return f"{self.name}/arm/status"

    @property
    def trajectory(self) -> str:
        """Query: `Trajectory` -> `Reply`."""
        return f"{self.name}/arm/trajectory"

    @property
    def stop(self) -> str:
        """Query: `Stop` -> `Reply`; anyone may."""
        return f"{self.name}/arm/stop"

    @property
    def resume(self) -> str:
        """Query: `Resume` -> `Reply`; deliberate, never implied."""
        return f"{self.name}/arm/resume"

    @property
    def gripper_command(self) -> str:
        """Query: `GripperCommand` -> `Reply`."""
        return f"{self.name}/gripper/command"

    @property
    def gripper_state(self) -> str:
        """`GripperState`, node -> all."""
        return f"{self.name}/gripper/state"

    @property
    def light_command(self) -> str:
        """Query: `LightCommand` -> `Reply`."""
        return f"{self.name}/light/command"

    @property
    def belt_command(self) -> str:
        """Query: `BeltCommand` -> `Reply`."""
        return f"{self.name}/belt/command"

    @property
    def belt_state(self) -> str:
        """`BeltState`, node -> all."""
        return f"{self.name}/belt/state"

    @property
    def heartbeat(self) -> str:
        """`Heartbeat`, supervisor -> node, 25 Hz."""
        return f"{self.name}/supervisor/heartbeat"

    @property
    def supervisor_state(self) -> str:
        """`SupervisorState`, supervisor -> all, 25 Hz."""
        return f"{self.name}/supervisor/state"

    @property
    def detections(self) -> str:
        """`Detections`, supervisor -> all."""
        return f"{self.name}/perception/detections"

    @property
    def hands(self) -> str:
        """`Hands`, supervisor -> all."""
        return f"{self.name}/perception/hands"

    @property
    def planned_path(self) -> str:
        """`PlannedPath`, supervisor -> all, with every trajectory that it sends."""
        return f"{self.name}/supervisor/path"

    @property
    def operator(self) -> str:
        """Query: `OperatorCommand` -> `Reply` of the supervisor."""
        return f"{self.name}/operator/command"

    @property
    def next_round(self) -> str:
        """Query: `NextRound` -> `Reply` of what started the supervisor."""
        return f"{self.name}/operator/next"

    @property
    def sim_step(self) -> str:
        """Query, simulation only: `StepRequest` -> `StepReply`."""
        return f"{self.name}/sim/step"

    @property
    def sim_reset(self) -> str:
        """Query, simulation only: `ResetRequest` -> `StepReply` of the new world, or a refusal."""
        return f"{self.name}/sim/reset"

    @property
    def sim_truth(self) -> str:
        """Query, simulation only: `TruthRequest` -> `Truth`; for judging, never for deciding."""
        return f"{self.name}/sim/truth"

    @property
    def events(self) -> str:
        """`Event`, all -> all."""
        return f"{self.name}/events"

    @property
    def all(self) -> str:
        """Key expression that matches every channel of the cell."""
        return f"{self.name}/**"

    def camera(self, name: str, what: str) -> str:
        """Channel `what` of camera `name`.

        Args:
            name: "belt" or "person".
            what: one of `CAMERA_CHANNELS`: color and depth (`Image`), camera_info
                (`CameraInfo`), capture (query: `Capture` -> `Reply`).

        Raises:
            WireError: `what` is none of them.
        """
        if what not in CAMERA_CHANNELS:
            raise WireError(f"camera channel: {one_of(what, CAMERA_CHANNELS)}")
        return f"{self.name}/camera/{name}/{what}"
