"""The RGB-D sensor model: noise as the configuration asks for, and holes where they should lie."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from cell.config import load
from cell.frames import Pinhole, look_at
from cell.settings import CameraConfig
from hil.sim.camera import Camera, sense, sense_depth
from hil.sim.render.renderer import Image

BELT = load().cameras["belt"]
SIGMA_1M = BELT.disparity_noise / (BELT.depth_focal * BELT.depth_baseline)
F_B = Pinhole.from_hfov(BELT.width, BELT.height, BELT.hfov).fx * BELT.depth_baseline


def flat(z: float) -> np.ndarray:
    return np.full((BELT.height, BELT.width), z, dtype=np.float32)


def with_(**changes: object) -> CameraConfig:
    return msgspec.structs.replace(BELT, **changes)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def picture(z: float = 0.9, grey: int = 120) -> Image:
    rgb = np.full((BELT.height, BELT.width, 3), grey, dtype=np.uint8)
    return Image(rgb, flat(z), np.zeros(rgb.shape[:2], np.int32), None)


@pytest.mark.parametrize("z", [0.5, 0.9, 1.8])
def test_stereo_noise_grows_with_the_square_of_the_distance(z: float) -> None:
    out = sense_depth(flat(z), BELT, rng())
    seen = out > 0
    assert seen.mean() > 0.99
    assert abs(float(out[seen].mean()) - z) < 0.02 * SIGMA_1M * z * z + 1e-4
    assert float(out[seen].std()) == pytest.approx(SIGMA_1M * z * z, rel=0.05)


def test_noise_is_smooth_over_a_few_pixels_only() -> None:
    error = sense_depth(flat(1.5), with_(depth_unit=1e-6), rng()) - 1.5

    def correlation(shift: int) -> float:
        return float(np.corrcoef(error[:, :-shift].ravel(), error[:, shift:].ravel())[0, 1])

    assert correlation(1) > 0.5
    assert abs(correlation(5)) < 0.02
    assert correlation(1) == pytest.approx(np.corrcoef(error[:-1].ravel(), error[1:].ravel())[0, 1], abs=0.03)


def test_readings_are_multiples_of_the_unit_and_within_range() -> None:
    ramp = np.repeat(np.linspace(0.1, 4.0, BELT.width, dtype=np.float32)[None], BELT.height, axis=0)
    out = sense_depth(ramp, BELT, rng())
    steps = out / BELT.depth_unit
    assert np.abs(steps - np.round(steps)).max() < 1e-3
    seen = out[out > 0]
    assert seen.min() >= BELT.min_depth and seen.max() <= BELT.max_depth
    assert not out[:, ramp[0] < BELT.min_depth - 0.01].any()
    assert not out[:, ramp[0] > BELT.max_depth + 0.15].any()
    assert out.dtype == np.float32


def test_a_band_left_of_a_near_object_is_hidden() -> None:
    """Its width is the difference of the disparities, f B (1 / near - 1 / far)."""
    near, far = 0.5, 1.2
    depth = flat(far)
    depth[150:330, 250:400] = near
    out = sense_depth(depth, BELT, rng())
    band = F_B * (1 / near - 1 / far)
    left = (out[160:320, :250] == 0).sum(axis=1)
    assert abs(float(left.mean()) - band) < 2.0
    assert np.all(out[160:320, round(250 - band) + 2 : 249] == 0)
    right = (out[160:320, 402:] == 0).sum(axis=1)
    assert right.mean() < 1.0
    assert (out[160:320, 255:395] > 0).mean() > 0.99


def test_grazing_surfaces_lose_readings_facing_ones_do_not() -> None:
    """A floor 0.3 m below a level camera: nearly edge-on in the distance, steeper in front."""
    pinhole = Pinhole.from_hfov(BELT.width, BELT.height, BELT.hfov)
    rows = np.arange(BELT.height, dtype=np.float32)[:, None]
    slope = np.maximum((rows - pinhole.cy) / pinhole.fy, 1e-3)
    depth = np.broadcast_to(0.3 / slope, (BELT.height, BELT.width)).astype(np.float32)
    out = sense_depth(depth, with_(disparity_noise=0.0), rng())
    lost = (out == 0).mean(axis=1)
    z = depth[:, 0]
    assert lost[(z > 0.75) & (z < 1.1)].max() == 0.0
    steep = (z > 2.4) & (z < 2.9)
    assert 0.1 < lost[steep].mean() < 0.95


def test_missing_stays_missing() -> None:
    depth = flat(1.0)
    depth[100:200, 300:500] = 0.0
    out = sense_depth(depth, BELT, rng())
    assert not out[100:200, 300:500].any()
    assert (out[:, 510:] > 0).mean() > 0.99


def test_colour_noise_is_a_couple_of_grey_levels_without_bias() -> None:
    image = picture(grey=120)
    rgb, _ = sense(image, BELT, rng())
    assert rgb.dtype == np.uint8 and rgb.shape == image.rgb.shape
    assert abs(rgb.mean() - 120) < 0.1
    assert 1.5 < rgb.std() < 2.5
    assert np.all(image.rgb == 120), "the ideal image must stay as it was"
    white, _ = sense(picture(grey=255), BELT, rng())
    assert white.min() > 240, "noise must saturate, not wrap around"


def test_frames_depend_on_seed_name_and_number_only() -> None:
    image = picture()
    a, b = Camera("belt", BELT, 3), Camera("belt", BELT, 3)
    other = Camera("person", BELT, 3)
    a.expose(0.0, image)
    other.expose(0.0, image)
    a.expose(0.1, image)
    for t in (5.0, 6.0):
        b.expose(t, image)
    frames_a, frames_b, frames_o = a.due(9.0), b.due(9.0), other.due(9.0)
    for x, y in zip(frames_a, frames_b, strict=True):
        assert np.array_equal(x.rgb, y.rgb) and np.array_equal(x.depth, y.depth)
    assert not np.array_equal(frames_a[0].depth, frames_a[1].depth)
    assert not np.array_equal(frames_a[0].depth, frames_o[0].depth)
    fresh = Camera("belt", BELT, 4)
    fresh.expose(0.0, image)
    assert not np.array_equal(fresh.due(9.0)[0].depth, frames_a[0].depth)


def test_frames_arrive_once_after_the_latency_in_order() -> None:
    camera = Camera("belt", with_(latency=0.05), 0)
    for t in (1.000, 1.016):
        camera.expose(t, picture())
    assert camera.due(1.048) == []
    first = camera.due(1.05)
    assert [(f.camera, f.seq, f.t) for f in first] == [("belt", 1, 1.0)]
    assert [f.seq for f in camera.due(2.0)] == [2]
    assert camera.due(3.0) == []


@pytest.mark.parametrize("rate", [30.0, 15.0, 125.0])
def test_a_free_running_camera_keeps_its_rate(rate: float) -> None:
    camera = Camera("belt", with_(rate=rate), 0)
    exposures = [tick for tick in range(1250) if camera.wants_exposure(tick * 0.008)]
    assert exposures[0] == 0
    assert len(exposures) == pytest.approx(10 * rate, abs=1)
    assert np.diff(exposures).max() - np.diff(exposures).min() <= 1


def test_on_demand_only() -> None:
    camera = Camera("belt", with_(rate=0.0), 0)
    assert not any(camera.wants_exposure(tick * 0.008) for tick in range(100))


def test_camera_stands_where_the_configuration_says() -> None:
    camera = Camera("belt", BELT, 0)
    assert np.array_equal(camera.X_WC, look_at(BELT.position, BELT.target))
    assert (camera.pinhole.width, camera.pinhole.height) == (BELT.width, BELT.height)
    assert 2 * np.arctan(BELT.width / 2 / camera.pinhole.fx) == pytest.approx(BELT.hfov)
    assert camera.near < BELT.min_depth and camera.far >= BELT.max_depth
