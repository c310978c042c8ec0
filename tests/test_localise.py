"""Boxes and depth to onions in the world, on ideal and on noisy spheres."""

from __future__ import annotations

import numpy as np
import pytest

from cell.config import load
from cell.frames import Array, Pinhole, look_at
from cell.perception.localise import locate
from cell.wire.types import Box
from hil.sim.camera import sense_depth

CONFIG = load()
CAMERA = CONFIG.cameras["belt"]
PINHOLE = Pinhole.from_hfov(CAMERA.width, CAMERA.height, CAMERA.hfov)
X_WC = look_at(CAMERA.position, CAMERA.target)
RNG = np.random.default_rng(3)


def sphere(p_WO: Array, radius: float) -> tuple[np.ndarray, Box]:
    """Ideal depth of a sphere on the belt, by ray casting, and its exact outline."""
    height, width = CAMERA.height, CAMERA.width
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = PINHOLE.back_project(np.stack([u, v], axis=-1), np.ones((height, width)))
    normal_C = X_WC[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    down = rays @ normal_C
    belt = (CONFIG.belt.top_z - X_WC[2, 3]) / np.where(down < -1e-6, down, -1e-6)
    centre = X_WC[:3, :3].T @ (p_WO - X_WC[:3, 3])
    a, b, c = (rays**2).sum(-1), rays @ centre, centre @ centre - radius**2
    root = b * b - a * c
    hit = root > 0
    z = np.where(hit, (b - np.sqrt(np.where(hit, root, 0.0))) / a, belt)
    rows, columns = np.nonzero(hit)
    box = Box((columns.min(), rows.min(), columns.max(), rows.max()), "unblemished", 0.9)
    return z.astype(np.float32), box


def places(count: int) -> list[tuple[Array, float]]:
    """Onions anywhere in the pick window, of any size."""
    (x0, x1), (y0, y1) = CONFIG.belt.pick_x, CONFIG.belt.pick_y
    out = []
    for _ in range(count):
        radius = RNG.uniform(*CONFIG.onions.diameter) / 2
        p = np.array([RNG.uniform(x0, x1), RNG.uniform(y0, y1), CONFIG.belt.top_z + radius])
        out.append((p, float(radius)))
    return out


def test_without_noise_the_centre_is_within_2_mm() -> None:
    for p_WO, radius in places(25):
        depth, box = sphere(p_WO, radius)
        found = locate(box, depth, PINHOLE, X_WC)
        assert found is not None
        assert np.linalg.norm(found.p_WO - p_WO) < 0.002
        assert abs(found.radius - radius) < 0.0015 and found.residual < 0.001


def test_with_the_cameras_noise_the_centre_is_within_8_mm() -> None:
    errors = []
    for p_WO, radius in places(25):
        depth, box = sphere(p_WO, radius)
        found = locate(box, sense_depth(depth, CAMERA, RNG), PINHOLE, X_WC)
        assert found is not None
        errors.append(np.linalg.norm(found.p_WO - p_WO))
    assert max(errors) < 0.008 and np.median(errors) < 0.003


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_partly_hidden_with_noise_and_a_loose_box(side: str) -> None:
    """A neighbour covers a third of the onion; the box is a pixel or two off, as detectors' are."""
    for p_WO, radius in places(6):
        depth, box = sphere(p_WO, radius)
        x0, y0, x1, y1 = (round(v) for v in box.box)
        third_x, third_y = (x1 - x0) // 3, (y1 - y0) // 3
        cover = {
            "left": (slice(None), slice(0, x0 + third_x)),
            "right": (slice(None), slice(x1 - third_x, None)),
            "top": (slice(0, y0 + third_y), slice(None)),
            "bottom": (slice(y1 - third_y, None), slice(None)),
        }[side]
        depth[cover] -= np.float32(0.06)
        off = RNG.uniform(-1.5, 1.5, 4)
        loose = Box((x0 + off[0], y0 + off[1], x1 + off[2], y1 + off[3]), box.label, box.score)
        found = locate(loose, sense_depth(depth, CAMERA, RNG), PINHOLE, X_WC)
        assert found is not None
        assert np.linalg.norm(found.p_WO - p_WO) < 0.008


def test_single_wrong_readings_do_not_pull() -> None:
    for p_WO, radius in places(6):
        depth, box = sphere(p_WO, radius)
        wrong = RNG.random(depth.shape) < 0.10
        depth[wrong] += RNG.uniform(-0.02, 0.02, int(wrong.sum())).astype(np.float32)
        depth[RNG.random(depth.shape) < 0.3] = 0.0
        found = locate(box, depth, PINHOLE, X_WC)
        assert found is not None and np.linalg.norm(found.p_WO - p_WO) < 0.004


def test_without_depth_there_is_no_onion() -> None:
    depth, box = sphere(*places(1)[0])
    assert locate(box, np.zeros_like(depth), PINHOLE, X_WC) is None
    sparse = np.zeros_like(depth)
    sparse[::16, ::16] = depth[::16, ::16]
    assert locate(box, sparse, PINHOLE, X_WC) is None


@pytest.mark.parametrize(
    "corners",
    [(5, 5, 5, 5), (9, 9, 3, 3), (-90, -90, -20, -20), (700, 500, 760, 560), (100, 100, 101, 180)],
)
def test_degenerate_boxes_are_no_onions(corners: tuple[float, ...]) -> None:
    depth, _ = sphere(*places(1)[0])
    assert locate(Box(corners, "unblemished", 0.9), depth, PINHOLE, X_WC) is None  # type: ignore[arg-type]


def test_a_box_over_the_images_edge_still_works() -> None:
    depth, box = sphere(*places(1)[0])
    x0, y0, x1, y1 = box.box
    shift = 0.25 * (x1 - x0)
    columns = round(x0 + shift)
    cut = depth[:, columns:]  # the onion's left quarter is outside
    camera = Pinhole(cut.shape[1], cut.shape[0], PINHOLE.fx, PINHOLE.fy, PINHOLE.cx - columns, PINHOLE.cy)
    whole = locate(box, depth, PINHOLE, X_WC)
    part = locate(Box((x0 - columns, y0, x1 - columns, y1), box.label, 0.9), cut, camera, X_WC)
    assert whole is not None and part is not None
    assert np.linalg.norm(whole.p_WO - part.p_WO) < 0.002
