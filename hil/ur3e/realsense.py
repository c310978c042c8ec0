"""An Intel RealSense (D400 series) as a `CameraSource`: depth registered to the colour image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.clock import WallClock
from cell.errors import BackendError
from cell.frames import Pinhole
from cell.settings import CameraConfig
from cell.wire.types import Frame
from hil.ur3e.clock_map import ClockMap
from hil.ur3e.rectify import Rectifier
from hil.ur3e.streamed import StreamedCamera

_COLOUR, _DEPTH, _RATE = (640, 480), (848, 480), 30
"""Streams: size [px], and pictures per second."""
_WAIT = 500
"""[ms]"""
_LONGEST = 0.5
"""Pictures are not held up for longer [s]."""


@dataclass(frozen=True)
class Opened:
    """A device that streams.

    Attributes:
        wait: next set of frames, or None after so many milliseconds.
        colour: the colour stream's profile. depth_unit: of a raw depth reading [m].
        close: stops it.
    """

    wait: Callable[[int], Any]
    colour: Any
    depth_unit: float
    close: Callable[[], None]


class RealSense(StreamedCamera):
    """See `StreamedCamera`; `opener` opens another device than a real one."""

    def __init__(
        self,
        name: str,
        camera: CameraConfig,
        serial: str,
        clock: WallClock,
        opener: Callable[[str], Opened] | None = None,
    ) -> None:
        super().__init__(name, camera, serial, clock)
        self._opener = opener or open_device
        self._opened: Opened | None = None

    def _open(self) -> Rectifier:
        rs = library()
        opened = self._opener(self._serial)
        try:
            i = opened.colour.as_video_stream_profile().get_intrinsics()
            rectifier = Rectifier(
                self.name,
                self._camera,
                Pinhole(i.width, i.height, i.fx, i.fy, i.ppx, i.ppy),
                _coefficients(rs, i),
                inverse=i.model == rs.distortion.inverse_brown_conrady,
            )
        except BackendError:
            opened.close()
            raise
        self._opened, self._align, self._map = opened, rs.align(rs.stream.color), ClockMap(_LONGEST)
        self._host_time = (rs.timestamp_domain.global_time, rs.timestamp_domain.system_time)
        return rectifier

    def _release(self) -> None:
        if self._opened is not None:
            self._opened.close()
            self._opened = None

    def _grab(self) -> tuple[bool, Frame | None]:
        assert self._opened is not None
        frames = self._opened.wait(_WAIT)
        if frames is None:
            return False, None
        colour = frames.get_color_frame()
        if not colour or not frames.get_depth_frame():
            return True, None
        exposed = self._exposure(colour)
        if not self._shutter.wants(exposed):
            return True, None
        registered = self._align.process(frames)
        colour, depth = registered.get_color_frame(), registered.get_depth_frame()
        if not colour or not depth:
            return True, None
        metres = np.asarray(depth.get_data()).astype(np.float32) * np.float32(self._opened.depth_unit)
        return True, self._frame(exposed, np.asarray(colour.get_data(), np.uint8), metres)

    def _exposure(self, frame: Any) -> float:
        """When it was exposed [s], by the node's clock.

        The library gives host time where the device can be synchronised; otherwise the stamp counts
        from the device's start, and the quickest delivery took about the configured latency.
        """
        stamp = frame.get_timestamp() * 1e-3
        if frame.get_frame_timestamp_domain() in self._host_time:
            return float(stamp)
        return self._map.to_wall(stamp, self._clock.now()) - self._camera.latency


def library() -> Any:
    """pyrealsense2; raises `BackendError` with what to install."""
    try:
        import pyrealsense2
    except ImportError as error:
        raise BackendError(
            f"the RealSense library cannot be loaded ({error}); install it with: pip install "
            "'sorting-cell[realsense]', and the system's libusb-1.0"
        ) from None
    return pyrealsense2


def open_device(serial: str) -> Opened:
    """Start the device's streams; raises `BackendError` when it is not there."""
    rs = library()
    there = {d.get_info(rs.camera_info.serial_number) for d in rs.context().query_devices()}
    if not there or (serial and serial not in there):
        raise BackendError(
            f"no RealSense camera{f' {serial}' if serial else ''} at this machine; there are: "
            f"{', '.join(sorted(there)) or 'none'}; look at its USB 3 cable"
        )
    config = rs.config()
    if serial:
        config.enable_device(serial)
    config.enable_stream(rs.stream.color, *_COLOUR, rs.format.rgb8, _RATE)
    config.enable_stream(rs.stream.depth, *_DEPTH, rs.format.z16, _RATE)
    pipeline = rs.pipeline()
    try:
        profile = pipeline.start(config)
        unit = profile.get_device().first_depth_sensor().get_depth_scale()
    except RuntimeError as error:
        raise BackendError(f"the RealSense camera does not start: {error}") from None

    def wait(milliseconds: int) -> Any:
        there, frames = pipeline.try_wait_for_frames(milliseconds)
        return frames if there else None

    return Opened(wait, profile.get_stream(rs.stream.color), unit, pipeline.stop)


def _coefficients(rs: Any, intrinsics: Any) -> tuple[float, ...] | None:
    """k1, k2, p1, p2, k3; raises `BackendError` for a model that is not handled here."""
    coefficients = tuple(float(c) for c in intrinsics.coeffs)
    if intrinsics.model == rs.distortion.none or not any(coefficients):
        return None
    if intrinsics.model in (rs.distortion.brown_conrady, rs.distortion.inverse_brown_conrady):
        return coefficients
    raise BackendError(
        f"the camera's distortion model {intrinsics.model} is not handled; use a D400-series camera"
    )
