"""A Luxonis OAK-D S2 as a `CameraSource` (depthai 3): stereo depth registered to the colour image.

Extended disparity is on: a hand at the belt is half a metre from the camera, and without it the
stereo pair measures nothing nearer than 0.6 m.
"""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import cv2
import numpy as np

from cell.clock import WallClock
from cell.errors import BackendError
from cell.frames import Pinhole
from cell.settings import CameraConfig
from cell.wire.types import Frame
from hil.ur3e.rectify import Rectifier
from hil.ur3e.streamed import StreamedCamera

_SIZE, _STEREO, _RATE = (640, 480), (640, 400), 20
"""Colour and stereo images [px], and pictures per second."""
_WAIT = timedelta(milliseconds=500)
_MILLIMETRE = 1e-3


class OakD(StreamedCamera):
    """See `StreamedCamera`."""

    def __init__(self, name: str, camera: CameraConfig, serial: str, clock: WallClock) -> None:
        super().__init__(name, camera, serial, clock)
        self._pipeline: Any = None

    def _open(self) -> Rectifier:
        dai = library()
        device = open_device(dai, self._serial)
        try:
            matrix = device.readCalibration().getCameraIntrinsics(dai.CameraBoardSocket.CAM_A, *_SIZE)
            rectifier = self.fit(matrix)
            self._pipeline, self._queue = build(dai, device)
            self._pipeline.start()
        except (BackendError, RuntimeError) as error:
            device.close()
            raise BackendError(f"camera {self.name}: {error}") from None
        return rectifier

    def fit(self, matrix: list[list[float]]) -> Rectifier:
        """Take in the device's colour intrinsics, a 3 x 3 matrix for pictures of its size [px]."""
        (fx, _, cx), (_, fy, cy), _ = matrix
        self._rectifier = Rectifier(self.name, self._camera, Pinhole(*_SIZE, fx, fy, cx, cy))
        return self._rectifier

    def _release(self) -> None:
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = None

    def _grab(self) -> tuple[bool, Frame | None]:
        group = self._queue.get(_WAIT)
        return (False, None) if group is None else (True, self.convert(group["colour"], group["depth"]))

    def convert(self, colour: Any, depth: Any) -> Frame | None:
        """One pair of `depthai.ImgFrame`s; None when it was not asked for.

        The library's stamps are of the host's monotonic clock, as the node's are.
        """
        exposed = colour.getTimestamp().total_seconds() + self._clock.offset
        if not self._shutter.wants(exposed):
            return None
        rgb = cv2.cvtColor(colour.getCvFrame(), cv2.COLOR_BGR2RGB)
        metres = depth.getFrame().astype(np.float32) * np.float32(_MILLIMETRE)
        return self._frame(exposed, np.asarray(rgb, np.uint8), metres)


def library() -> Any:
    """depthai; raises `BackendError` with what to install."""
    try:
        import depthai
    except ImportError as error:
        raise BackendError(
            f"the OAK-D library cannot be loaded ({error}); install it with: pip install 'sorting-cell[oakd]'"
        ) from None
    return depthai


def open_device(dai: Any, serial: str) -> Any:
    """The device with this serial number, or the only one; raises `BackendError`."""
    there = [info.getDeviceId() for info in dai.Device.getAllAvailableDevices()]
    if not there or (serial and serial not in there):
        raise BackendError(
            f"no OAK-D camera{f' {serial}' if serial else ''} at this machine; there are: "
            f"{', '.join(there) or 'none'}; look at its USB 3 cable and the udev rule (docs/robot.md)"
        )
    try:
        return dai.Device(dai.DeviceInfo(serial or there[0]))
    except RuntimeError as error:
        raise BackendError(f"the OAK-D camera does not open: {error}") from None


def build(dai: Any, device: Any) -> tuple[Any, Any]:
    """(pipeline, queue of colour and depth in step)."""
    sockets = dai.CameraBoardSocket
    pipeline = dai.Pipeline(device)
    colour = pipeline.create(dai.node.Camera).build(sockets.CAM_A)
    picture = colour.requestOutput(size=_SIZE, fps=_RATE, enableUndistortion=True)
    stereo = pipeline.create(dai.node.StereoDepth)
    stereo.setExtendedDisparity(True)
    stereo.setLeftRightCheck(True)
    for socket, side in ((sockets.CAM_B, stereo.left), (sockets.CAM_C, stereo.right)):
        pipeline.create(dai.node.Camera).build(socket).requestOutput(size=_STEREO, fps=_RATE).link(side)
    picture.link(stereo.inputAlignTo)
    sync = pipeline.create(dai.node.Sync)
    sync.setSyncThreshold(timedelta(seconds=0.5 / _RATE))
    picture.link(sync.inputs["colour"])
    stereo.depth.link(sync.inputs["depth"])
    return pipeline, sync.out.createOutputQueue(maxSize=2, blocking=False)
