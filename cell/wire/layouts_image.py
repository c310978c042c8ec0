"""How images and RGB-D frames travel; their pixels are never copied on the way in."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cell.errors import DecodeError, WireError, one_of
from cell.wire import cdr
from cell.wire.cdr import Reader, Writer
from cell.wire.layouts import MAX_SIDE, SMALL, camera_of, check_size, header, optical_frame
from cell.wire.types import Frame, Image
from cell.wire.typestore import FRAME_HEAD, IMAGE_HEAD, make

IMAGE_LIMIT = SMALL + MAX_SIDE * MAX_SIDE * 4
FRAME_LIMIT = 2 * IMAGE_LIMIT

#: encoding -> (dtype, bytes per pixel)
_ENCODINGS: dict[str, tuple[np.dtype[Any], int]] = {
    "rgb8": (np.dtype(np.uint8), 3),
    "32FC1": (np.dtype("<f4"), 4),
}


class ImageLayout:
    """sensor_msgs/Image; rgb8 when the pixels are (H, W, 3) uint8, 32FC1 when (H, W) float32."""

    ros_type = "sensor_msgs/msg/Image"
    limit = IMAGE_LIMIT

    def write(self, w: Writer, m: Image) -> None:
        shape, dtype = m.pixels.shape, m.pixels.dtype
        if dtype == np.uint8 and len(shape) == 3 and shape[2] == 3:
            encoding, pixel = "rgb8", 3
        elif dtype == np.float32 and len(shape) == 2:
            encoding, pixel = "32FC1", 4
        else:
            raise WireError(f"pixels must be (H, W, 3) uint8 or (H, W) float32, got {shape} {dtype}")
        if not (1 <= shape[0] <= MAX_SIDE and 1 <= shape[1] <= MAX_SIDE):
            raise WireError(f"image of {shape[1]} x {shape[0]} pixels, allowed are 1..{MAX_SIDE} each way")
        head = header(m.t, optical_frame(m.camera))
        w.put(IMAGE_HEAD, make(IMAGE_HEAD)(head, shape[0], shape[1], encoding, 0, pixel * shape[1]))
        w.count(m.pixels.nbytes)
        w.raw(np.ascontiguousarray(m.pixels).reshape(-1).view(np.uint8).data)

    def read(self, r: Reader) -> Image:
        head = r.take(IMAGE_HEAD)
        check_size(head.width, head.height)
        if head.encoding not in _ENCODINGS:
            raise DecodeError(f"encoding: {one_of(head.encoding[:40], _ENCODINGS)}")
        dtype, pixel = _ENCODINGS[head.encoding]
        n = r.count(IMAGE_LIMIT, "bytes of pixels")
        if head.is_bigendian or head.step != pixel * head.width or n != head.step * head.height:
            raise DecodeError(
                f"{head.width} x {head.height} {head.encoding} does not fit step {head.step}, "
                f"big-endian {head.is_bigendian}, {n} bytes"
            )
        shape = (head.height, head.width, 3) if pixel == 3 else (head.height, head.width)
        pixels: NDArray[Any] = np.frombuffer(r.raw(n), dtype=dtype).reshape(shape)
        # One comparison that NaN, infinity and negative numbers all fail.
        if head.encoding == "32FC1" and not (pixels.min() >= 0.0 and pixels.max() < np.inf):
            raise DecodeError("depth contains NaN, infinity or negative values")
        t = cdr.seconds(head.header.stamp, "stamp")
        return Image(t, camera_of(head.header.frame_id), pixels)


class FrameLayout:
    """cell_msgs/Frame: both images of a capture in one message."""

    ros_type = "cell_msgs/msg/Frame"
    limit = FRAME_LIMIT
    _image = ImageLayout()

    def write(self, w: Writer, m: Frame) -> None:
        if m.rgb.shape[:2] != m.depth.shape or m.rgb.ndim != 3:
            raise WireError(f"rgb {m.rgb.shape} and depth {m.depth.shape} must be of one size")
        w.put(FRAME_HEAD, make(FRAME_HEAD)(m.camera, m.seq))
        self._image.write(w, Image(m.t, m.camera, m.rgb))
        self._image.write(w, Image(m.t, m.camera, m.depth))

    def read(self, r: Reader) -> Frame:
        head = r.take(FRAME_HEAD)
        color, depth = self._image.read(r), self._image.read(r)
        if head.camera != color.camera:
            raise DecodeError(f"frame of camera {head.camera[:80]!r} holds an image of {color.camera[:80]!r}")
        return join(head.seq, color, depth)


def join(seq: int, color: Image, depth: Image) -> Frame:
    """The frame whose two halves these are; raises DecodeError if they do not belong together."""
    rgb, z = color.pixels, depth.pixels
    if rgb.ndim != 3 or z.shape != rgb.shape[:2]:
        raise DecodeError(f"a frame needs rgb8 and 32FC1 of one size, got {rgb.shape} and {z.shape}")
    if color.camera != depth.camera or color.t != depth.t:
        raise DecodeError("the two images of a frame differ in camera or time")
    return Frame(color.camera, seq, color.t, cast(NDArray[np.uint8], rgb), cast(NDArray[np.float32], z))
