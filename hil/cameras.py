"""Where a backend's pictures come from: one small interface for simulated and real cameras."""

from __future__ import annotations

from typing import Protocol

from cell.wire.types import CameraInfo, Frame


class CameraSource(Protocol):
    """One RGB-D camera.

    Life cycle: `connect` -> (`request`, `take`)* -> `close`. `close` may be called at any time, more
    than once. Times are those of the node that reads it: wall clock [s] of `cell.clock.WallClock`.

    Attributes:
        name: as in the configuration, "belt" or "person".
    """

    name: str

    def connect(self) -> None:
        """Open the device and start it. Raises `CellError` with what to do when it is absent."""
        ...

    def info(self) -> CameraInfo:
        """Intrinsics of both images; known from `connect` on."""
        ...

    def request(self) -> None:
        """Expose one frame now; never blocks for longer than a few milliseconds.

        A camera that runs freely all the time may deliver its next frame instead.
        """
        ...

    def take(self) -> list[Frame]:
        """Frames that arrived since the last call, oldest first, each once; never blocks.

        Raises:
            BackendError: the camera is gone.
        """
        ...

    def close(self) -> None:
        """Stop the device; harmless when repeated."""
        ...
