"""Every exception the project raises on purpose.

One base class, so that the command line can turn any of them into one clear line
and exit code 2. A message says what was wrong and lists what would be right.
"""

from collections.abc import Iterable


class CellError(Exception):
    """Base of all deliberate errors; the CLI prints its text and exits with 2."""


class ConfigError(CellError):
    """A configuration or cell description is missing, malformed or impossible."""


class PolicyError(CellError):
    """A policy table is missing, incomplete or garbled; the message names the row."""


class DecodeError(CellError):
    """Bytes from outside are not a valid message within the agreed bounds."""


class WireError(CellError):
    """The Zenoh session, a query or an endpoint failed."""


class StaleError(CellError):
    """A reading is missing or older than its reader accepts."""


class PlanError(CellError):
    """No motion satisfies the request; the message says which constraint failed."""


class PerceptionError(CellError):
    """Model weights or images are missing or unusable."""


class CalibrationError(CellError):
    """A set of views says too little, or contradicts itself; the message says which and how."""


class BackendError(CellError):
    """A backend cannot do what was asked, or its device failed."""


class RenderError(CellError):
    """The chosen renderer cannot work on this machine."""


class RefusedError(CellError):
    """The backend refused a command.

    Attributes:
        code: one of `cell.limits.RefusalCode`'s values.
        reason: the sentence a user reads.
    """

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(f"{code}: {reason}")
        self.code = code
        self.reason = reason


def one_of(value: object, legal: Iterable[object]) -> str:
    """Format "got X; legal values: A, B" for messages.

    Args:
        value: what was given.
        legal: any iterable of acceptable values.
    """
    return f"got {value!r}; legal values: {', '.join(str(v) for v in legal)}"
