"""What a recording is made of: samples of the wire, what tools need besides, and the decisions."""

from __future__ import annotations

from dataclasses import dataclass, field

from cell.config import CellConfig
from cell.errors import CellError
from cell.record import tick
from cell.record.decision import CodedDecision
from cell.record.mcap_writer import McapFile
from cell.record.transforms import STRING, TF, Transforms
from cell.wire import codec, pictures
from cell.wire.keys import Keys
from cell.wire.service import Tapped
from cell.wire.types import GripperState, Image, JointState

INPUTS, OUTPUTS, OPERATOR = "/replay/inputs", "/replay/outputs", "/replay/operator"
"""Topics of the decisions; an operator's orders come before the inputs that they belong to."""
ABOUT = "cell"
"""Name of the metadata record that says what the recording is of."""
CONFIG_FILE, POLICY_FILE = "config.json", "policy.csv"
"""Files attached to a recording that a replay needs."""
FORMAT, READABLE = "2", ("1", "2")
"""Version of what the replay needs, and those that it can read: 1 knew no operator."""
EYES = "eyes"
"""Companion that a replay can make again: it sees what the person camera sees."""
_TF_EVERY = 4
"""Joint states from one set of transforms to the next."""


@dataclass(frozen=True)
class About:
    """What is recorded, and what a replay of it needs to know.

    Attributes:
        facts: names and versions, for people. companion: `EYES`, "none", or a name of something that
            knows more than the cameras show and cannot be replayed. holder: of the lease.
        files: attached, by name.
    """

    facts: dict[str, str]
    companion: str = "none"
    holder: str = "supervisor"
    files: dict[str, bytes] = field(default_factory=dict)


class Content:
    """Puts things into a file.

    Args:
        about: what the recording is of; needed for a replay. lossless: noted there; see `whole_frames`.
    """

    def __init__(self, config: CellConfig, file: McapFile, about: About | None, lossless: bool) -> None:
        self._file, self._cameras = file, config.cameras
        self._transforms = Transforms(config)
        keys = Keys(config.name)
        self._joints, self._gripper = keys.joint_states, keys.gripper_state
        self._width = config.gripper.stroke
        self._counted = 0
        self._begun = False
        if about is not None:
            facts = {"format": FORMAT, "companion": about.companion, "holder": about.holder}
            facts |= {"lossless": str(lossless).lower(), **about.facts}
            file.describe(ABOUT, facts, about.files)

    def sample(self, sample: Tapped) -> None:
        """One message of the wire, its pictures compressed; raises KeyError for an unknown type."""
        self._begin(sample.t)
        topic, kind, payload = f"/{sample.key}", sample.ros_type, sample.payload
        if kind == codec.ros_type(Image):
            topic, kind, payload = self._compressed(topic, payload)
        self._file.add(topic, kind, sample.t, sample.seq, payload)
        if sample.key == self._gripper:
            self._width = codec.decode(GripperState, payload).width
        elif sample.key == self._joints:
            self._counted += 1
            if self._counted % _TF_EVERY == 1:
                joints = codec.decode(JointState, payload)
                moved = self._transforms.moving(joints.t, joints.q, self._width)
                self._file.add("/tf", TF, joints.t, self._counted, moved)

    def decision(self, d: CodedDecision) -> None:
        """One tick of the supervisor."""
        if d.operator:
            self._file.add(OPERATOR, tick.OPERATOR, d.t, d.number, d.operator)
        self._file.add(INPUTS, tick.INPUTS, d.t, d.number, d.inputs)
        self._file.add(OUTPUTS, tick.OUTPUTS, d.t, d.number, d.outputs)

    def _begin(self, t: float) -> None:
        """What never changes, at the time of the first message."""
        if not self._begun:
            self._begun = True
            self._file.add("/robot_description", STRING, t, 1, self._transforms.description(), latched=True)
            self._file.add("/tf_static", TF, t, 1, self._transforms.static(), latched=True)

    def _compressed(self, topic: str, payload: bytes) -> tuple[str, str, bytes]:
        """(topic, ROS type, payload) of a picture; as it is if it cannot be compressed."""
        try:
            image = codec.decode(Image, payload)
            small = pictures.compress(image, self._cameras[image.camera])
        except (CellError, KeyError):
            return topic, codec.ros_type(Image), payload
        suffix = pictures.COLOR_SUFFIX if image.pixels.ndim == 3 else pictures.DEPTH_SUFFIX
        return topic + suffix, pictures.COMPRESSED, small
