"""Cameras without devices: RealSense through the library's software device, OAK-D frames, recordings."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

from cell.clock import WallClock, perf_s
from cell.config import load
from cell.errors import BackendError, ConfigError
from cell.frames import Pinhole
from cell.record.mcap_writer import McapFile
from cell.wire import codec
from cell.wire.types import Frame, Image
from hil.cameras import CameraSource
from hil.ur3e.cameras import make_cameras
from hil.ur3e.oakd import OakD
from hil.ur3e.realsense import Opened, RealSense
from hil.ur3e.rectify import Rectifier, brown_conrady
from hil.ur3e.shutter import Grabber, Shutter
from tests.wire_helpers import pause, until

CONFIG = load()
BELT = CONFIG.cameras["belt"]
IDEAL = Pinhole.from_hfov(BELT.width, BELT.height, BELT.hfov)
CLOCK = WallClock()


def scene(width: int, height: int, fx: float, cx: float, cy: float) -> tuple[np.ndarray, np.ndarray]:
    """A white square of 0.1 m, 0.6 m away on the optical axis, 5 mm to the right, on black at 0.8 m."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y = (u - cx) / fx * 0.6, (v - cy) / fx * 0.6
    inside = (np.abs(x - 0.005) < 0.05) & (np.abs(y) < 0.05)
    rgb = np.zeros((height, width, 3), np.uint8)
    rgb[inside] = 255
    return rgb, np.where(inside, 600, 800).astype(np.uint16)


def centre_of_square(frame: Frame) -> np.ndarray:
    """Where the square is, from colour and depth together, in the camera frame [m]."""
    rows, columns = np.nonzero(frame.rgb[:, :, 0] > 200)
    uv = np.stack([columns, rows], axis=-1).mean(axis=0)
    distance = np.median(frame.depth[rows, columns])
    out: np.ndarray = IDEAL.back_project(uv, distance)
    return out


# -- RealSense ------------------------------------------------------------------------------------------


class SoftwareDevice:
    """A D435 of the library's own making: colour and depth side by side, 15 mm apart."""

    def __init__(self, **colour: Any) -> None:
        self.rs = rs = pytest.importorskip("pyrealsense2")
        self._device = rs.software_device()
        self._depth_sensor, self._colour_sensor = (self._device.add_sensor(n) for n in ("Depth", "Color"))
        self._fx, self._cx, self._cy = 615.0, 318.0, 243.0
        self._depth = self._stream(self._depth_sensor, rs.stream.depth, 0, rs.format.z16, 2)
        self._colour = self._stream(self._colour_sensor, rs.stream.color, 1, rs.format.rgb8, 3, **colour)
        self._depth_sensor.add_read_only_option(rs.option.depth_units, 0.001)
        moved = rs.extrinsics()
        moved.rotation, moved.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0.015, 0.0, 0.0]
        self._depth.register_extrinsics_to(self._colour, moved)
        self._device.create_matcher(rs.matchers.default)
        self._syncer = rs.syncer()
        for sensor, profile in ((self._depth_sensor, self._depth), (self._colour_sensor, self._colour)):
            sensor.open(profile)
            sensor.start(self._syncer)
        self._number = 0
        self._ended = threading.Event()
        self.silent = False
        threading.Thread(target=self._run, daemon=True).start()

    def _stream(self, sensor: Any, kind: Any, uid: int, form: Any, bpp: int, **changes: Any) -> Any:
        rs = self.rs
        i = rs.intrinsics()
        i.width, i.height, i.fx, i.fy, i.ppx, i.ppy = 640, 480, self._fx, self._fx, self._cx, self._cy
        i.model, i.coeffs = changes.get("model", rs.distortion.none), changes.get("coeffs", [0.0] * 5)
        s = rs.video_stream()
        s.type, s.uid, s.width, s.height, s.fps, s.bpp, s.fmt, s.intrinsics = (
            kind,
            uid,
            640,
            480,
            30,
            bpp,
            form,
            i,
        )
        return sensor.add_video_stream(s).as_video_stream_profile()

    def _run(self) -> None:
        rs = self.rs
        while not self._ended.wait(0.02):
            if self.silent:
                continue
            self._number += 1
            rgb, _ = scene(640, 480, self._fx, self._cx, self._cy)
            _, depth = scene(640, 480, self._fx, self._cx + 0.015 / 0.6 * self._fx, self._cy)
            for sensor, profile, pixels, bpp in (
                (self._depth_sensor, self._depth, depth, 2),
                (self._colour_sensor, self._colour, rgb, 3),
            ):
                frame = rs.software_video_frame()
                frame.pixels, frame.stride, frame.bpp = pixels.ravel().view(np.uint8), 640 * bpp, bpp
                frame.timestamp, frame.domain = self._number * 20.0, rs.timestamp_domain.hardware_clock
                frame.frame_number, frame.profile = self._number, profile
                sensor.on_video_frame(frame)

    def open(self, serial: str) -> Opened:
        def wait(milliseconds: int) -> Any:
            end = perf_s() + milliseconds * 1e-3
            while perf_s() < end:
                frames = self._syncer.poll_for_frames()
                if frames and frames.size() == 2:
                    return frames
                pause(0.002)
            return None

        return Opened(wait, self._colour, 0.001, self.close)

    def close(self) -> None:
        self._ended.set()


@pytest.fixture
def realsense() -> Iterator[tuple[RealSense, SoftwareDevice]]:
    device = SoftwareDevice()
    camera = RealSense("belt", BELT, "", CLOCK, device.open)
    yield camera, device
    camera.close()


def frames(camera: CameraSource, count: int, seconds: float = 5.0) -> list[Frame]:
    out: list[Frame] = []
    until(lambda: len(out.extend(camera.take()) or out) >= count, seconds)
    return out


def test_a_realsense_frame_is_registered_rectified_and_dated(
    realsense: tuple[RealSense, SoftwareDevice],
) -> None:
    camera, _ = realsense
    camera.connect()
    pause(0.3)
    assert camera.take() == []  # on request only
    before = CLOCK.now()
    camera.request()
    (frame,) = frames(camera, 1)
    assert frame.rgb.shape == (480, 640, 3) and frame.rgb.dtype == np.uint8
    assert frame.depth.shape == (480, 640) and frame.depth.dtype == np.float32
    assert centre_of_square(frame) == pytest.approx([0.005, 0.0, 0.6], abs=2e-3)
    assert before <= frame.t <= CLOCK.now() and (frame.camera, frame.seq) == ("belt", 1)
    info = camera.info()
    assert (info.fx, info.cx, info.frame) == (IDEAL.fx, IDEAL.cx, "camera_belt")
    camera.request()
    assert frames(camera, 1)[0].seq == 2


def test_a_free_running_realsense_sends_no_more_than_its_rate() -> None:
    device = SoftwareDevice()
    camera = RealSense("belt", msgspec.structs.replace(BELT, rate=10.0), "", CLOCK, device.open)
    camera.connect()
    times = [f.t for f in frames(camera, 6)]
    camera.close()
    assert np.diff(times).mean() > 0.07  # a busy machine may drop some


def test_a_realsense_that_falls_silent_is_reported(
    monkeypatch: pytest.MonkeyPatch, realsense: tuple[RealSense, SoftwareDevice]
) -> None:
    monkeypatch.setattr("hil.ur3e.shutter.SILENCE", 0.6)
    camera, device = realsense
    camera.connect()
    device.silent = True
    until(lambda: _gone(camera), 5.0)


def _gone(camera: CameraSource) -> bool:
    try:
        camera.take()
    except BackendError as error:
        return "no picture for" in str(error)
    return False


def test_distortion_is_taken_out_or_refused() -> None:
    rs = pytest.importorskip("pyrealsense2")
    for model, handled in ((rs.distortion.inverse_brown_conrady, True), (rs.distortion.ftheta, False)):
        device = SoftwareDevice(model=model, coeffs=[0.02, 0.0, 0.0, 0.0, 0.0])
        camera = RealSense("belt", BELT, "", CLOCK, device.open)
        if handled:
            camera.connect()
        else:
            with pytest.raises(BackendError, match=r"distortion model .* is not handled"):
                camera.connect()
        camera.close()


def test_no_camera_at_this_machine_is_said() -> None:
    pytest.importorskip("pyrealsense2")
    with pytest.raises(BackendError, match="no RealSense camera 123 at this machine"):
        RealSense("belt", BELT, "123", CLOCK).connect()


# -- OAK-D ----------------------------------------------------------------------------------------------


def test_an_oakd_pair_becomes_a_frame() -> None:
    dai = pytest.importorskip("depthai")
    camera = OakD("belt", BELT, "", CLOCK)
    camera.fit([[600.0, 0.0, 321.0], [0.0, 600.0, 238.0], [0.0, 0.0, 1.0]])
    rgb, millimetres = scene(640, 480, 600.0, 321.0, 238.0)
    colour, depth = dai.ImgFrame(), dai.ImgFrame()
    colour.setCvFrame(np.ascontiguousarray(rgb[:, :, ::-1]), dai.ImgFrame.Type.BGR888i)
    depth.setFrame(millimetres)
    depth.setType(dai.ImgFrame.Type.RAW16)
    depth.setSize(640, 480)
    colour.setTimestamp(timedelta(seconds=50.0))
    assert camera.convert(colour, depth) is None  # on request only
    camera._shutter.ask(50.0 + CLOCK.offset)
    frame = camera.convert(colour, depth)
    assert frame is not None
    assert frame.t == pytest.approx(50.0 + CLOCK.offset, abs=1e-6) and frame.seq == 1
    assert centre_of_square(frame) == pytest.approx([0.005, 0.0, 0.6], abs=2e-3)


def test_no_oakd_at_this_machine_is_said() -> None:
    pytest.importorskip("depthai")
    with pytest.raises(BackendError, match="no OAK-D camera at this machine"):
        OakD("belt", BELT, "", CLOCK).connect()


# -- recordings -----------------------------------------------------------------------------------------


def images(count: int) -> list[tuple[float, np.ndarray, np.ndarray]]:
    rgb, millimetres = scene(640, 480, IDEAL.fx, IDEAL.cx, IDEAL.cy)
    return [(1000.0 + 0.1 * k, np.roll(rgb, k, axis=1), millimetres) for k in range(count)]


def recording(folder: Path, count: int = 4) -> Path:
    file = McapFile(folder / "run.mcap")
    for name in CONFIG.cameras:
        for seq, (t, rgb, mm) in enumerate(images(count)):
            for what, pixels in (("color", rgb), ("depth", mm.astype(np.float32) * 1e-3)):
                message = Image(t, name, pixels)  # type: ignore[arg-type]
                topic = f"/cell/camera/{name}/{what}"
                file.add(topic, "sensor_msgs/msg/Image", t, seq, codec.encode(message))
    file.close()
    return folder / "run.mcap"


def folder_of(folder: Path, count: int = 4, times: str = "") -> Path:
    for name in CONFIG.cameras:
        (folder / name).mkdir()
        for k, (_, rgb, mm) in enumerate(images(count)):
            cv2.imwrite(str(folder / name / f"color_{k:04d}.png"), rgb[:, :, ::-1])
            cv2.imwrite(str(folder / name / f"depth_{k:04d}.png"), mm)
        if times:
            (folder / name / "times.txt").write_text(times)
    return folder


@pytest.mark.parametrize("make", [recording, folder_of])
def test_a_recording_comes_back_as_it_was_and_when_it_was(make: Any, tmp_path: Path) -> None:
    cameras = make_cameras(str(make(tmp_path)), CONFIG, "", CLOCK)
    assert set(cameras) == set(CONFIG.cameras)
    began = CLOCK.now()
    for camera in cameras.values():
        camera.connect()
    seen = frames(cameras["belt"], 4)
    took = CLOCK.now() - began
    others = frames(cameras["person"], 4)
    assert np.diff([f.t for f in seen]) == pytest.approx([0.1] * 3, abs=1e-6)
    assert took >= 0.3 and [f.seq for f in seen] == [1, 2, 3, 4]
    assert seen[0].t == pytest.approx(others[0].t, abs=1e-6) and seen[0].t >= began - 1e-3
    for frame, (_, rgb, mm) in zip(seen, images(4), strict=True):
        assert (frame.rgb == rgb).all()
        assert np.abs(frame.depth - mm * 1e-3).max() < 1e-6
    until(lambda: _ended(cameras["belt"]))
    for camera in cameras.values():
        camera.close()
        camera.close()


def _ended(camera: CameraSource) -> bool:
    try:
        camera.take()
    except BackendError as error:
        return "recording has ended" in str(error)
    return False


def test_bad_recordings_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="legal values: sim, real"):
        make_cameras(str(tmp_path / "none"), CONFIG, "", CLOCK)
    with pytest.raises(ConfigError, match="holds no pictures of the camera 'belt'"):
        make_cameras(str(tmp_path), CONFIG, "", CLOCK)
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"nothing of the kind")
    with pytest.raises(ConfigError, match="is no recording of this project"):
        make_cameras(str(junk), CONFIG, "", CLOCK)
    bad = tmp_path / "bad"
    bad.mkdir()
    with pytest.raises(ConfigError, match="needs 4 rising times"):
        make_cameras(str(folder_of(bad, times="0\n1\n")), CONFIG, "", CLOCK)


def test_pictures_of_another_size_end_the_camera(tmp_path: Path) -> None:
    small = {**CONFIG.cameras, "belt": msgspec.structs.replace(BELT, width=320, height=240)}
    config = msgspec.structs.replace(CONFIG, cameras=small)
    camera = make_cameras(str(recording(tmp_path)), config, "", CLOCK)["belt"]
    camera.connect()
    until(lambda: "320 x 240" in _problem(camera))
    camera.close()


def _problem(camera: CameraSource) -> str:
    try:
        camera.take()
    except BackendError as error:
        return str(error)
    return ""


# -- parts ----------------------------------------------------------------------------------------------


def test_both_directions_of_the_distortion_model_agree() -> None:
    k = (0.1, -0.05, 0.001, -0.002, 0.01)
    device = Pinhole(640, 480, 560.0, 560.0, 319.5, 239.5)
    one = Rectifier("belt", BELT, device, k, inverse=True)
    x, y = (one._u - device.cx) / device.fx, (one._v - device.cy) / device.fy
    back = brown_conrady(x.astype(float), y.astype(float), k)
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    assert np.abs(back[0] * IDEAL.fx + IDEAL.cx - u).max() < 0.01
    assert np.abs(back[1] * IDEAL.fy + IDEAL.cy - v).max() < 0.01


def test_a_field_of_view_that_the_device_lacks_is_refused() -> None:
    with pytest.raises(BackendError, match=r"set cameras\.belt\.hfov to about that"):
        Rectifier("belt", BELT, Pinhole(640, 480, 1200.0, 1200.0, 319.5, 239.5))


def test_the_shutter_gives_what_was_asked_and_what_is_due() -> None:
    asked = Shutter(0.0)
    asked.ask(1.0)
    assert [asked.wants(t) for t in (0.9, 1.01, 1.04)] == [False, True, False]
    running = Shutter(10.0)
    wanted = [running.wants(k / 30) for k in range(60)]
    assert sum(wanted) == 20


def test_a_camera_that_raises_is_gone_and_says_why() -> None:
    def grab() -> tuple[bool, Frame | None]:
        raise RuntimeError("USB\nunplugged")

    grabber = Grabber("belt", grab, CLOCK)
    until(lambda: not grabber._thread.is_alive())
    with pytest.raises(BackendError, match="USB unplugged"):
        grabber.take()
    grabber.close()
