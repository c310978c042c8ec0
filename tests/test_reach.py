"""Reach and views: an impossible cell is a sentence that names the key; the shipped one works."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from cell.clock import perf_s
from cell.config import CellConfig, load
from cell.errors import ConfigError
from cell.frames import Array, Pinhole, look_at
from cell.motion.collision import CollisionModel
from cell.motion.coverage import Onion
from cell.motion.reach import check_reachable
from cell.motion.views import InspectionViews

CONFIG = load()
CAMERA = CONFIG.cameras["belt"]
X_WC = look_at(CAMERA.position, CAMERA.target)
PINHOLE = Pinhole.from_hfov(CAMERA.width, CAMERA.height, CAMERA.hfov)


def pixels(p_W: Array) -> Array:
    return PINHOLE.project((p_W - X_WC[:3, 3]) @ X_WC[:3, :3])


def window(n: int = 9) -> Array:
    b = CONFIG.belt
    return np.array(
        [[x, y, b.top_z + 0.035] for x in np.linspace(*b.pick_x, n) for y in np.linspace(*b.pick_y, 2 * n)]
    )


def test_the_shipped_cell_is_reachable() -> None:
    check_reachable(CONFIG)
    start = perf_s()
    check_reachable(CONFIG)  # views are kept
    assert perf_s() - start < 1.5


def altered(section: str, **values: object) -> CellConfig:
    return replace(CONFIG, **{section: replace(getattr(CONFIG, section), **values)})


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (
            altered("bin", center=(0.0, 0.9, -0.1)),
            r"bin\.center: the drop pose at .*0\.900.* out of reach of the UR3e",
        ),
        (altered("bin", center=(0.25, 0.0, -0.05)), r"touching something"),
        (altered("bin", drop_spread=0.11), r"bin\.drop_spread: .* 0\.11 m off the centre hit the bin's wall"),
        (altered("belt", pick_x=(0.25, 0.58)), r"belt\.pick_x.* out of reach of the UR3e"),
        (altered("belt", pick_y=(-0.6, 0.33)), r"belt\.pick_x, belt\.pick_y: the grasp at .* out of reach"),
        (altered("arm", home=(0.0, 0.6, 0.0, 0.0, 1.57, 0.0)), r"arm\.home: .*belt"),
    ],
)
def test_an_impossible_cell_is_named(config: CellConfig, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        check_reachable(config)
    assert "\n" not in str(error.value)


def test_a_camera_that_cannot_see_the_hand_is_named() -> None:
    camera = replace(CAMERA, position=(-1.5, -1.5, 1.5))
    with pytest.raises(ConfigError, match=r"cameras\.belt\.position"):
        InspectionViews(replace(CONFIG, cameras={"belt": camera}))


def test_the_camera_sees_the_whole_window_past_the_arm_at_home() -> None:
    uv = pixels(window())
    assert uv[:, 0].min() >= 25 and uv[:, 1].min() >= 25
    assert uv[:, 0].max() <= CAMERA.width - 25 and uv[:, 1].max() <= CAMERA.height - 25
    hidden = CollisionModel(CONFIG).hides(
        np.array(CONFIG.arm.home), X_WC[:3, 3], window(), radius=CONFIG.onions.diameter[1] / 2
    )
    assert not hidden.any()


def test_views_show_nearly_all_of_an_onion_and_are_the_same_each_time() -> None:
    views = InspectionViews(CONFIG)
    assert 2 <= len(views.views) <= 4
    assert views.coverage >= 0.97
    again = InspectionViews(load())
    assert all(np.array_equal(a.q, b.q) for a, b in zip(views.views, again.views, strict=True))


def test_held_onions_are_in_the_image_and_not_hidden() -> None:
    model = CollisionModel(CONFIG)
    for view in InspectionViews(CONFIG).views:
        p_WT = view.X_WT[:3, 3]
        u, v = pixels(p_WT)
        assert 60 <= u <= CAMERA.width - 60 and 60 <= v <= CAMERA.height - 60
        assert 0.40 <= np.linalg.norm(p_WT - X_WC[:3, 3]) <= 0.651
        assert not model.hides(view.q, X_WC[:3, 3], p_WT[None], radius=0.035, tool=False).any()
        assert model.clearance(view.q, held_radius=0.04)[0] >= CONFIG.motion.clearance


def test_coverage_is_that_of_a_bare_sphere_away_from_the_gripper() -> None:
    """A distant camera below sees the cap within 65 degrees: (1 - cos 65) / 2 of the sphere."""
    onion = Onion(0.035)
    seen = onion.seen_from(np.array([0.0, 0.0, 50.0]))
    cap = (1 - np.cos(np.radians(65.0))) / 2
    pads = 1 - np.cos(np.radians(20.0))
    assert seen.mean() == pytest.approx(cap / (1 - pads), abs=0.01)
    assert not onion.seen_from(np.array([0.0, 0.0, -50.0])).any()  # the palm is in the way
