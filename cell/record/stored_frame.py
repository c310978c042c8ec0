"""Camera frames in a recording, exactly as a decision saw them, in little space.

Colour is PNG. Depth readings that are whole multiples of the camera's unit are 16-bit PNG, others stay
float32. Of a frame whose colour only networks look at (the person camera's), the pixels that the
geometry reads are enough: every third one, and those round the palms that were found.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.errors import DecodeError, WireError
from cell.perception.hands.landmarks import Hand
from cell.perception.separation import STRIDE
from cell.wire import cdr
from cell.wire.layouts import MAX_SIDE, check_size
from cell.wire.pictures import png_size
from cell.wire.types import Frame
from cell.wire.typestore import make

#: Most rectangles of depth in one frame.
MAX_PATCHES = 16
_UNIT = np.float32(0.001)
_HOW = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY]
_COLOR_HOW, _DEPTH_HOW = [*_HOW, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY], [*_HOW, cv2.IMWRITE_PNG_STRATEGY_RLE]
"""Noisy pictures repeat nothing: looking for repetitions takes longer and ends up larger."""
_PALM = [0, 5, 9, 13, 17]
"""Landmarks whose hull holds every pixel at which a palm's depth is read."""
_EDGE = 2


def store(frame: Frame, whole: bool, hands: tuple[Hand, ...] = ()) -> Any:
    """A frame -> cell_msgs/StoredFrame.

    Args:
        whole: keep every pixel; else only those of the depth that the geometry reads.
        hands: found in this frame; the depth of their palms is kept.
    """
    height, width = frame.depth.shape
    stride = 1 if whole else STRIDE
    unit, depth = _coded(np.ascontiguousarray(frame.depth[::stride, ::stride]))
    patches = [] if whole else [_patch(frame.depth, hand) for hand in hands[:MAX_PATCHES]]
    return make("cell_msgs/msg/StoredFrame")(
        frame.camera,
        frame.seq,
        cdr.stamp(frame.t),
        width,
        height,
        png(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR)) if whole else np.zeros(0, np.uint8),
        stride,
        float(unit),
        depth,
        [patch for patch in patches if patch is not None],
    )


def restore(ros: Any) -> Frame:
    """The inverse of `store`; pixels that were not kept are 0. Raises DecodeError."""
    width, height, stride = ros.width, ros.height, ros.stride
    check_size(width, height)
    if stride not in (1, STRIDE) or len(ros.patches) > MAX_PATCHES:
        raise DecodeError(f"stored frame: stride {stride}, {len(ros.patches)} patches")
    grid = (-(-height // stride), -(-width // stride))
    if ros.unit > 0.0:
        depth = unpng(ros.depth, *grid, np.uint16).astype(np.float32) * np.float32(ros.unit)
    elif len(ros.depth) == 4 * grid[0] * grid[1]:
        depth = np.frombuffer(bytes(ros.depth), "<f4").reshape(grid)
    else:
        raise DecodeError(f"stored frame: {len(ros.depth)} bytes of depth for {grid[1]} x {grid[0]} pixels")
    if not (np.isfinite(depth).all() and depth.min() >= 0.0):
        raise DecodeError("stored frame: depth contains NaN, infinity or negative values")
    if stride > 1:
        sparse, depth = depth, np.zeros((height, width), np.float32)
        depth[::stride, ::stride] = sparse
    for patch in ros.patches:
        _lay(patch, depth)
    rgb = np.zeros((height, width, 3), np.uint8)
    if len(ros.color):
        rgb = np.asarray(cv2.cvtColor(unpng(ros.color, height, width, np.uint8), cv2.COLOR_BGR2RGB))
    return Frame(cdr.text(ros.camera, "camera"), ros.seq, cdr.seconds(ros.stamp, "stamp"), rgb, depth)


def png(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """An image (H, W) or (H, W, 3), uint8 (blue first) or uint16, as PNG."""
    fine, data = cv2.imencode(".png", pixels, _COLOR_HOW if pixels.ndim == 3 else _DEPTH_HOW)
    if not fine:
        raise WireError(f"cannot write an image {pixels.shape} {pixels.dtype} as PNG")
    return np.asarray(data, np.uint8).ravel()


def unpng(data: NDArray[np.uint8], height: int, width: int, dtype: type[Any]) -> NDArray[Any]:
    """An image from PNG; raises DecodeError unless it is one of that size and type."""
    raw = bytes(data)
    if png_size(raw) != (width, height):
        raise DecodeError(f"not a PNG of {width} x {height} pixels")
    pixels = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_UNCHANGED)
    channels = 3 if dtype is np.uint8 else 1
    if pixels is None or pixels.dtype != dtype or pixels.size != height * width * channels:
        raise DecodeError(f"not a PNG of {8 * np.dtype(dtype).itemsize} bits in {channels} channels")
    return np.asarray(pixels)


def _coded(depth: NDArray[np.float32]) -> tuple[np.float32, NDArray[np.uint8]]:
    """(unit, bytes): PNG if that loses nothing, else float32 as they are with unit 0."""
    counts = np.rint(depth / _UNIT)
    if counts.max() <= 65535.0 and np.array_equal(counts.astype(np.float32) * _UNIT, depth):
        return _UNIT, png(counts.astype(np.uint16))
    return np.float32(0), np.frombuffer(depth.astype("<f4").tobytes(), np.uint8)


def _patch(depth: NDArray[np.float32], hand: Hand) -> Any | None:
    """The palm's rectangle of a depth image; None where the palm is outside."""
    corners = hand.landmarks[_PALM]
    if not np.isfinite(corners).all():
        return None
    height, width = depth.shape
    u0, v0 = np.maximum(np.floor(corners.min(axis=0)).clip(-9, MAX_SIDE).astype(int) - _EDGE, 0)
    u1, v1 = np.ceil(corners.max(axis=0)).clip(-9, MAX_SIDE).astype(int) + _EDGE + 1
    part = depth[v0 : min(v1, height), u0 : min(u1, width)]
    if not part.size:
        return None
    return make("cell_msgs/msg/DepthPatch")(int(u0), int(v0), part.shape[1], part.ravel())


def _lay(patch: Any, depth: NDArray[np.float32]) -> None:
    height, width = depth.shape
    rows = len(patch.depth) // max(patch.width, 1)
    fits = patch.u + patch.width <= width and patch.v + rows <= height
    if not fits or rows * patch.width != len(patch.depth):
        raise DecodeError("stored frame: a depth patch does not fit into the image")
    values = np.asarray(patch.depth, np.float32)
    if not (np.isfinite(values).all() and (values >= 0.0).all()):
        raise DecodeError("stored frame: a depth patch contains NaN, infinity or negative values")
    depth[patch.v : patch.v + rows, patch.u : patch.u + patch.width] = values.reshape(rows, patch.width)
