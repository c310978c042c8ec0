"""Labelled photographs as training samples: a folder of pictures, each with a text file of boxes.

`name.png` or `name.jpg` belongs to `name.txt` with a line per onion: class (0 unblemished, 1 blemished),
then the box's centre, width and height as shares of the picture (the format that YOLO tools write).
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from _detector_data import BLEMISH_PIXELS, Sample

from cell.errors import ConfigError
from cell.settings import CameraConfig

_SUFFIXES = (".png", ".jpg", ".jpeg")


def read_folder(folder: Path, camera: CameraConfig) -> list[Sample]:
    """Every labelled picture of a folder; raises `ConfigError` naming the file and line that is wrong."""
    files = sorted(p for p in folder.glob("*") if p.suffix.lower() in _SUFFIXES)
    if not files:
        raise ConfigError(f"{folder} holds no pictures ({', '.join(_SUFFIXES)})")
    return [_read(file, camera) for file in files]


def _read(file: Path, camera: CameraConfig) -> Sample:
    picture = cv2.imread(str(file))
    if picture is None:
        raise ConfigError(f"{file} is no picture")
    height, width = picture.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise ConfigError(
            f"{file} has {width} x {height} pixels, the belt camera {camera.width} x {camera.height}; take "
            "pictures with that camera, at its distance"
        )
    labels = file.with_suffix(".txt")
    if not labels.is_file():
        raise ConfigError(f"{labels} is missing; a picture without onions needs an empty one")
    boxes, blemish = [], []
    for number, line in enumerate(labels.read_text().splitlines(), start=1):
        if not line.strip():
            continue
        kind, box = _line(line, f"{labels}, line {number}")
        x, y, w, h = box * [width, height, width, height]
        boxes.append((x - w / 2 - 0.5, y - h / 2 - 0.5, x + w / 2 - 0.5, y + h / 2 - 0.5))
        blemish.append(4 * BLEMISH_PIXELS * kind)
    count = len(boxes)
    return Sample(
        rgb=np.ascontiguousarray(picture[:, :, ::-1]),
        depth=np.zeros((height, width), np.float32),
        boxes=np.array(boxes, np.float32).reshape(-1, 4),
        blemish=np.array(blemish, int),
        p_WO=np.zeros((count, 3)),
        held=np.zeros(count, bool),
        on_belt=np.ones(count, bool),
        visible=np.ones(count, np.float32),
    )


def _line(line: str, where: str) -> tuple[int, np.ndarray]:
    words = line.split()
    try:
        kind, box = int(words[0]), np.array([float(word) for word in words[1:]])
    except ValueError:
        kind, box = -1, np.zeros(0)
    if kind not in (0, 1) or box.shape != (4,) or not ((box >= 0) & (box <= 1)).all() or min(box[2:]) <= 0:
        raise ConfigError(
            f"{where}: expected 0 or 1 and four shares from 0 to 1 (x y width height), got '{line}'"
        )
    return kind, box
