"""The words of the sorting task, as the paper and the published domain number them.

They are part of the wire contract (the supervisor's state names them) and of the policy
CSV, so decision code, learner and viewer import them from here.
"""

from enum import IntEnum


class OnionLocation(IntEnum):
    """Where the onion in focus is."""

    UNKNOWN = 0
    ON_CONVEYOR = 1
    IN_FRONT = 2
    AT_HOME = 3


class EefLocation(IntEnum):
    """Where the agent's hand (end effector) is."""

    IN_BIN = 0
    ON_CONVEYOR = 1
    IN_FRONT = 2
    AT_HOME = 3


class Prediction(IntEnum):
    """What the agent believes of the onion in focus."""

    UNKNOWN = 0
    BLEMISHED = 1
    UNBLEMISHED = 2


class RobotType(IntEnum):
    """The robot's own type: its working mode."""

    COLLABORATIVE = 0
    INDUSTRIAL = 1


class Action(IntEnum):
    """The robot's nine actions; the human's 7 and 8 are thumbs-up and thumbs-down."""

    NO_OP = 0
    DETECT = 1
    DETECT_PICK = 2
    PICK = 3
    INSPECT = 4
    PLACE_ON_CONVEYOR = 5
    PLACE_IN_BIN = 6
    SPEED_UP = 7
    SLOW_DOWN = 8


SIGNALS = ("off", "collaborative", "requested", "industrial", "hold", "stopped")
"""What the mode light can show. "requested": industrial mode is wanted, but not permitted yet."""

ORDERS = ("hold", "go", "cap", "resume")
"""What an operator may order: wait on the path, go on, a speed cap, lift a stop."""

LEAST_CAP = 0.05
"""An operator's speed cap is at least this [m/s]."""


class Mode(IntEnum):
    """The supervisor's mode (state machine of the speed supervision)."""

    STOPPED = 0
    HOLD = 1
    COLLABORATIVE = 2
    INDUSTRIAL = 3
    RECOVERING = 4
