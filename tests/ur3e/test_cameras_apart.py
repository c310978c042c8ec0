"""Cameras in a process of their own: frames come by the wire, and what happens to a camera is said."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from cell.clock import WallClock
from cell.config import CellConfig, load
from cell.errors import BackendError
from cell.trials.one_round import free_port
from cell.wire.session import Session
from hil.ur3e.camera_set import CamerasApart

CLOCK = WallClock()
COUNT = 15


@pytest.fixture
def config() -> CellConfig:
    return msgspec.structs.replace(load(), port=free_port())


@pytest.fixture
def node(config: CellConfig) -> Iterator[Session]:
    with Session.listen(config) as session:
        yield session


def pictures(config: CellConfig, folder: Path) -> str:
    for name, camera in config.cameras.items():
        (folder / name).mkdir()
        for k in range(COUNT):
            shape = (camera.height, camera.width)
            cv2.imwrite(str(folder / name / f"color_{k:04d}.png"), np.full((*shape, 3), 10 * k, np.uint8))
            cv2.imwrite(str(folder / name / f"depth_{k:04d}.png"), np.full(shape, 500 + k, np.uint16))
    return str(folder)


def test_frames_are_on_the_wire_and_a_camera_that_ends_is_named(
    config: CellConfig, node: Session, tmp_path: Path
) -> None:
    cameras = CamerasApart(pictures(config, tmp_path), config, "", CLOCK)
    with Session.connect(config) as client:
        reader = client.latest_frame("belt")
        cameras.connect()
        began = CLOCK.now()
        frame = reader.wait(10.0)
        assert frame.camera == "belt" and abs(frame.t - began) < 5.0
        assert frame.rgb.shape == (*frame.depth.shape, 3)
        assert 0.4995 < float(frame.depth[0, 0]) < 0.52
        assert cameras.take() == []
        cameras.request("belt")
        with pytest.raises(BackendError, match="ceiling"):
            cameras.request("ceiling")
        news: list[str] = []
        while sum("is gone: " in text for text in news) < 2:
            assert CLOCK.now() < began + 20.0
            CLOCK.sleep_until(CLOCK.now() + 0.05)
            news += cameras.news()
        assert "camera belt is gone: the recording has ended" in news
        with pytest.raises(BackendError, match="gone"):
            cameras.request("belt")
    cameras.close()
    cameras.close()


def test_why_a_camera_cannot_be_opened_is_told(config: CellConfig, node: Session, tmp_path: Path) -> None:
    cameras = CamerasApart(str(tmp_path / "none"), config, "", CLOCK)
    with pytest.raises(BackendError, match="a recording or folder that exists"):
        cameras.connect()


def test_a_process_that_dies_takes_its_cameras_along(
    config: CellConfig, node: Session, tmp_path: Path
) -> None:
    cameras = CamerasApart(pictures(config, tmp_path), config, "", CLOCK)
    cameras.connect()
    assert cameras._process is not None
    cameras._process.kill()
    cameras._process.wait()
    with pytest.raises(BackendError, match="gone"):
        cameras.request("belt")
    end = CLOCK.now() + 5.0
    while not any("process ended" in text for text in cameras.news()):
        assert CLOCK.now() < end
        CLOCK.sleep_until(CLOCK.now() + 0.02)
    cameras.close()
