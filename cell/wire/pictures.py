"""Images as recordings keep them for people and tools: JPEG colour, and depth as ROS's `compressedDepth`.

Depth is stored as inverse depth in steps of a share of the stereo camera's own noise (16-bit PNG after a
header with the two constants), and four neighbours share the reading of one of them: a tenth of what
lossless depth costs. Neither a round nor its replay decides on these.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import DecodeError, WireError
from cell.settings import CameraConfig
from cell.wire import cdr
from cell.wire.layouts import MAX_SIDE, SMALL, camera_of, check_size, header, optical_frame
from cell.wire.types import Image
from cell.wire.typestore import make

COMPRESSED = "sensor_msgs/msg/CompressedImage"
"""ROS type of what `compress` gives."""
COLOR_SUFFIX, DEPTH_SUFFIX = "/compressed", "/compressedDepth"
"""What ROS appends to the topic of the raw image."""
_COLOR, _DEPTH = "rgb8; jpeg compressed bgr8", "32FC1; compressedDepth png"
_QUALITY = 75
_STEP = 3.0
"""Steps of inverse depth, as a share of the disparity's noise; rounding to them adds 0.87 of it."""
_BLOCK = 2
"""Side of the square of pixels that share one reading."""
_PNG = b"\x89PNG\r\n\x1a\n"
_HEADER = struct.Struct("<iff")
_LIMIT = SMALL + MAX_SIDE * MAX_SIDE * 4


def compress(image: Image, camera: CameraConfig) -> bytes:
    """An image -> sensor_msgs/CompressedImage in CDR.

    Args:
        camera: whose noise decides the steps of depth.

    Raises:
        WireError: the image cannot be coded.
    """
    import cv2

    if image.pixels.ndim == 3:
        bgr = cv2.cvtColor(image.pixels, cv2.COLOR_RGB2BGR)
        fine, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        return _message(image, _COLOR, b"", data if fine else None)
    scale = np.float32(camera.depth_focal * camera.depth_baseline / max(_STEP * camera.disparity_noise, 1e-3))
    scale = min(scale, np.float32(60_000.0 * camera.min_depth))
    steps = np.zeros(image.pixels.shape, np.float32)
    np.divide(scale, image.pixels, out=steps, where=image.pixels > 0.0)
    steps = np.repeat(np.repeat(steps[::_BLOCK, ::_BLOCK], _BLOCK, axis=0), _BLOCK, axis=1)
    steps = steps[: image.pixels.shape[0], : image.pixels.shape[1]]
    counts = np.rint(np.minimum(steps, 65535.0)).astype(np.uint16)
    # Neighbours differ by little, and nothing repeats but what is smooth.
    how = [
        cv2.IMWRITE_PNG_STRATEGY,
        cv2.IMWRITE_PNG_STRATEGY_RLE,
        cv2.IMWRITE_PNG_FILTER,
        cv2.IMWRITE_PNG_FILTER_PAETH,
    ]
    fine, data = cv2.imencode(".png", counts, [cv2.IMWRITE_PNG_COMPRESSION, 1, *how])
    return _message(image, _DEPTH, _HEADER.pack(0, float(scale), 0.0), data if fine else None)


def expand(payload: bytes) -> Image:
    """The inverse of `compress`, as far as there is one. Raises DecodeError."""
    import cv2

    reader = cdr.Reader(payload, _LIMIT)
    ros = reader.take(COMPRESSED)
    reader.finish()
    t, camera = cdr.seconds(ros.header.stamp, "stamp"), camera_of(ros.header.frame_id)
    raw = bytes(ros.data)
    if "compressedDepth" in ros.format:
        if len(raw) < _HEADER.size:
            raise DecodeError("compressed depth is cut short")
        _, scale, offset = _HEADER.unpack_from(raw)
        raw = raw[_HEADER.size :]
        check_size(*png_size(raw))
        counts = _decoded(cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_UNCHANGED), np.uint16, 2)
        depth = np.zeros(counts.shape, np.float32)
        np.divide(np.float32(scale), counts - np.float32(offset), out=depth, where=counts > 0)
        if not (np.isfinite(depth).all() and (depth >= 0).all()):
            raise DecodeError("compressed depth gives NaN, infinity or negative values")
        return Image(t, camera, depth)
    check_size(*(png_size(raw) if raw.startswith(_PNG) else jpeg_size(raw)))
    bgr = _decoded(cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_COLOR), np.uint8, 3)
    return Image(t, camera, np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8))


# Sizes are read before anything is unpacked: a small file may claim to be an enormous picture.


def png_size(raw: bytes) -> tuple[int, int]:
    """(width, height) that a PNG claims. Raises DecodeError."""
    if not raw.startswith(_PNG) or len(raw) < 33:
        raise DecodeError("not a PNG")
    width, height = struct.unpack_from(">II", raw, 16)
    return width, height


def jpeg_size(raw: bytes) -> tuple[int, int]:
    """(width, height) that a JPEG claims. Raises DecodeError."""
    at = 2
    while raw.startswith(b"\xff\xd8") and at + 9 <= len(raw) and raw[at] == 0xFF:
        marker, length = struct.unpack_from(">BH", raw, at + 1)
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", raw, at + 5)
            return width, height
        at += 2 + length
    raise DecodeError("neither PNG nor JPEG")


def _message(image: Image, form: str, head: bytes, data: Any) -> bytes:
    if data is None:
        raise WireError(f"cannot compress an image {image.pixels.shape} {image.pixels.dtype}")
    body = np.frombuffer(head + data.tobytes(), np.uint8)
    writer = cdr.Writer()
    writer.put(COMPRESSED, make(COMPRESSED)(header(image.t, optical_frame(image.camera)), form, body))
    return writer.finish()


def _decoded(pixels: Any, dtype: type[Any], dimensions: int) -> NDArray[Any]:
    if pixels is None or pixels.dtype != dtype or pixels.ndim != dimensions:
        raise DecodeError("a compressed image cannot be unpacked")
    check_size(pixels.shape[1], pixels.shape[0])
    return np.asarray(pixels)
