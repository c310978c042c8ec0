"""Procedural onions: sizes, skins, blemishes and the truth about them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cell.config import load
from cell.frames import Array
from hil.sim.onions import TEXTURE_SHAPE, Onion, make_onion

COUNT = 80


@cache
def batch(seed: int = 1, count: int = COUNT) -> list[Onion]:
    rng = np.random.default_rng(seed)
    return [make_onion(rng, load().onions, i) for i in range(count)]


def directions() -> Array:
    """Unit vector of each texel: row 0 at the neck (+z), columns by longitude."""
    rows, columns = TEXTURE_SHAPE
    theta, phi = np.meshgrid(
        (np.arange(rows) + 0.5) / rows * np.pi,
        (np.arange(columns) + 0.5) / columns * 2 * np.pi,
        indexing="ij",
    )
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def test_sizes_lie_within_the_configuration() -> None:
    small, large = load().onions.diameter
    for onion in batch():
        assert small <= 2 * onion.radius <= large
        across = np.ptp(onion.mesh.vertices[:, :2], axis=0)
        assert small * 0.95 <= across.min() and across.max() <= large * 1.04  # a slight waviness
        assert 0.8 * small <= np.ptp(onion.mesh.vertices[:, 2]) <= 1.11 * large
        assert 0.05 < onion.mass < 0.30
    diameters = [2 * onion.radius for onion in batch()]
    assert np.ptp(diameters) > 0.7 * (large - small)


def test_marks_on_the_skin_exist_if_and_only_if_the_onion_is_blemished() -> None:
    kinds = set()
    for onion in batch():
        marks = onion.texture[:, :, 3]
        assert onion.texture.shape == (*TEXTURE_SHAPE, 4) and set(np.unique(marks)) <= {0, 255}
        assert onion.blemished == bool(onion.blemishes) == bool(marks.any())
        kinds.add(onion.blemished)
    assert kinds == {True, False}
    share = np.mean([onion.blemished for onion in batch()])
    assert abs(share - load().onions.blemished_share) < 3 * 0.5 / np.sqrt(COUNT)


def test_blemishes_are_where_the_truth_says_and_look_different() -> None:
    contrast = []
    for onion in batch():
        if not onion.blemished:
            continue
        marks = onion.texture[:, :, 3] > 0
        off = np.min(
            [np.arccos(np.clip(directions() @ np.array(d), -1, 1)) - a for d, a in onion.blemishes], axis=0
        )
        assert off[marks].max() < 0.25  # ragged edges, but near a blob
        skin = onion.texture[(off > 0.4) & ~marks][:, :3].mean(axis=0)
        contrast.append(np.abs(onion.texture[marks][:, :3].mean(axis=0) - skin).max())
    assert min(contrast) > 8 and np.median(contrast) > 40  # grey mould on a red onion is the faintest


def test_some_blemishes_can_be_seen_only_from_below() -> None:
    """An onion at rest hides half of its skin; this is why inspection exists."""
    up = np.array([0.0, 0.0, 1.0])
    faces_up, hidden = 0, 0
    for onion in batch():
        if onion.blemished:
            seen = any(np.array(d) @ up > 0.0 for d, _ in onion.blemishes)
            faces_up, hidden = faces_up + seen, hidden + (not seen)
    assert faces_up >= 5 and hidden >= 3


def test_onions_are_a_function_of_seed_and_index() -> None:
    for a, b in zip(batch(7, 4), batch.__wrapped__(7, 4), strict=True):
        assert a is not b and a.blemishes == b.blemishes
        assert np.array_equal(a.texture, b.texture) and np.array_equal(a.mesh.vertices, b.mesh.vertices)
    assert not np.array_equal(batch(7, 4)[0].texture, batch(8, 4)[0].texture)
    assert not np.array_equal(batch(7, 4)[0].texture, batch(7, 4)[1].texture)


def test_the_collision_sphere_is_within_4_mm_of_the_mesh() -> None:
    for onion in batch()[:8]:
        # The neck and the root are thin tips that nothing touches: the fingers close round the middle.
        body = onion.mesh.vertices[np.abs(onion.mesh.vertices[:, 2]) < 0.8 * onion.height]
        gap = np.abs(np.linalg.norm(body, axis=1) - onion.collision_radius)
        assert gap.max() < 0.004


def test_the_mesh_is_closed_and_faces_outward() -> None:
    for onion in batch()[:5]:
        tri = onion.mesh.vertices[onion.mesh.faces].astype(float)
        volume = np.einsum("ij,ij->i", tri[:, 0], np.cross(tri[:, 1], tri[:, 2])).sum() / 6
        assert volume == pytest.approx(4 / 3 * np.pi * onion.radius**2 * onion.height, rel=0.12)
        assert np.einsum("ij,ij->i", onion.mesh.normals, onion.mesh.vertices).min() > 0.0
        np.testing.assert_allclose(np.linalg.norm(onion.mesh.normals, axis=1), 1.0, atol=1e-5)
