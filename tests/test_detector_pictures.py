"""Labelled photographs are read as the training expects them; a wrong label names its file and line."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell.config import load
from cell.errors import ConfigError

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tools"))

from _detector_pictures import read_folder

CAMERA = load().cameras["belt"]


def picture(folder: Path, labels: str | None, width: int = CAMERA.width) -> None:
    cv2.imwrite(str(folder / "one.png"), np.full((CAMERA.height, width, 3), (10, 20, 30), np.uint8))
    if labels is not None:
        (folder / "one.txt").write_text(labels)


def test_boxes_and_classes_arrive(tmp_path: Path) -> None:
    picture(tmp_path, "0 0.5 0.5 0.1 0.2\n\n1 0.25 0.5 0.05 0.05\n")
    (sample,) = read_folder(tmp_path, CAMERA)
    assert tuple(sample.rgb[0, 0]) == (30, 20, 10)
    assert np.allclose(sample.boxes[0], (287.5, 191.5, 351.5, 287.5))
    assert sample.blemish[0] == 0 and sample.blemish[1] > 100 and not sample.held.any()


def test_a_picture_without_onions_needs_an_empty_file(tmp_path: Path) -> None:
    picture(tmp_path, "")
    assert read_folder(tmp_path, CAMERA)[0].boxes.shape == (0, 4)


@pytest.mark.parametrize(
    ("labels", "width", "words"),
    [
        (None, CAMERA.width, "one.txt is missing"),
        ("0 0.5 0.5 0.1\n", CAMERA.width, "line 1: expected"),
        ("0 0.5 0.5 0.1 0.1\n2 0.5 0.5 0.1 0.1\n", CAMERA.width, "line 2: expected"),
        ("0 0.5 0.5 0.1 nan\n", CAMERA.width, "line 1: expected"),
        ("onion 0.5 0.5 0.1 0.1\n", CAMERA.width, "line 1: expected"),
        ("", 100, "100 x 480"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, labels: str | None, width: int, words: str) -> None:
    picture(tmp_path, labels, width)
    with pytest.raises(ConfigError, match=words):
        read_folder(tmp_path, CAMERA)


def test_an_empty_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="holds no pictures"):
        read_folder(tmp_path, CAMERA)
