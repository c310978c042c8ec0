"""What the cameras that stream have in common: connect, ask, take, close."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from cell.cameras import camera_pinhole
from cell.clock import WallClock
from cell.errors import BackendError
from cell.settings import CameraConfig
from cell.wire.types import CameraInfo, Frame
from hil.ur3e.rectify import Rectifier
from hil.ur3e.shutter import Grabber, Shutter


class StreamedCamera(ABC):
    """A `hil.cameras.CameraSource` on a device that streams.

    Args:
        camera: the ideal camera that pictures are made to fit. serial: of the device; empty: the only one.
        clock: of the node.
    """

    def __init__(self, name: str, camera: CameraConfig, serial: str, clock: WallClock) -> None:
        self.name = name
        self._camera, self._serial, self._clock = camera, serial, clock
        self._rectifier: Rectifier | None = None
        self._grabber: Grabber | None = None
        self._shutter = Shutter(camera.rate)
        self._seq = 0

    def connect(self) -> None:
        """Raises `BackendError` when the device is not there or does not fit the configuration."""
        if self._grabber is None:
            self._rectifier = self._open()
            self._grabber = Grabber(self.name, self._grab, self._clock)

    def info(self) -> CameraInfo:
        self._fitted()  # raises before it is connected
        p = camera_pinhole(self._camera)
        return CameraInfo(self._clock.now(), f"camera_{self.name}", p.width, p.height, p.fx, p.fy, p.cx, p.cy)

    def request(self) -> None:
        self._shutter.ask(self._clock.now())

    def take(self) -> list[Frame]:
        if self._grabber is None:
            raise self._not_connected()
        return self._grabber.take()

    def close(self) -> None:
        if self._grabber is not None:
            self._grabber.close()
            self._grabber = None
        self._release()

    def _frame(self, exposed: float, rgb: NDArray[np.uint8], metres: NDArray[np.float32]) -> Frame:
        """A wanted picture of the device, made to fit the ideal camera."""
        picture, distance = self._fitted().picture(rgb, metres)
        self._seq += 1
        return Frame(self.name, self._seq, exposed, picture, distance)

    def _fitted(self) -> Rectifier:
        if self._rectifier is None:
            raise self._not_connected()
        return self._rectifier

    def _not_connected(self) -> BackendError:
        return BackendError(f"camera {self.name} is not connected; call connect() first")

    @abstractmethod
    def _open(self) -> Rectifier:
        """Start the device; how its pictures become those of the ideal camera."""

    @abstractmethod
    def _grab(self) -> tuple[bool, Frame | None]:
        """See `Grabber`."""

    @abstractmethod
    def _release(self) -> None:
        """Stop the device; harmless when repeated."""
