"""Both renderers against geometry, against each other, and against themselves in another process."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import urdf
from cell.errors import RenderError
from cell.frames import Pinhole, from_quaternion, look_at, pose, quaternion, rot_x, rot_y, rot_z
from hil.sim.physics import bullet, connect, quiet
from hil.sim.render import gl, tiny
from hil.sim.render.mesh import Mesh
from hil.sim.render.renderer import Image, Lighting, gl_problem, make_renderer
from hil.sim.render.scene import (
    MESH_ERROR,
    Scene,
    Visual,
    add_urdf_visuals,
    box_mesh,
    capsule_mesh,
    cylinder_mesh,
    sphere_mesh,
)

ROOT = Path(__file__).resolve().parent.parent
ROBOT, BELT, ONION = 1, 2, 100
PINHOLE = Pinhole.from_hfov(640, 480, 0.96)
X_WC = look_at((-0.12, -0.36, 0.72), (0.32, -0.02, -0.12))
NEAR, FAR = 0.05, 8.0
NO_GL = gl_problem()
needs_gl = pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
BOTH = [pytest.param("gl", marks=needs_gl), "tiny"]


@dataclass
class Cell:
    client: int
    scene: Scene
    robot: int


def skin(seed: int) -> np.ndarray:
    """A texture with soft noise and one marked, dark spot."""
    rng = np.random.default_rng(seed)
    texture = np.zeros((128, 256, 4), dtype=np.uint8)
    noise = cv2.resize(rng.normal(0, 14, (16, 32)).astype(np.float32), (256, 128))
    texture[..., :3] = np.clip(np.array([190, 120, 60]) + noise[..., None], 0, 255)
    cv2.circle(texture, (int(rng.integers(40, 216)), 64), 16, (40, 26, 20, 255), -1)
    return texture


def add_textured(
    client: int, scene: Scene, mesh: Mesh, texture: np.ndarray, X: np.ndarray, label: int
) -> int:
    """A body that both renderers draw from the same triangles and the same texture."""
    assert mesh.uv is not None
    shape = bullet.createVisualShape(
        bullet.GEOM_MESH, vertices=mesh.vertices.tolist(), indices=mesh.faces.ravel().tolist(),
        normals=mesh.normals.tolist(), uvs=mesh.uv.tolist(), physicsClientId=client,
    )  # fmt: skip
    body = bullet.createMultiBody(
        0, -1, shape, X[:3, 3].tolist(), quaternion(X[:3, :3]).tolist(), physicsClientId=client
    )
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder) / "skin.png")
        cv2.imwrite(file, np.ascontiguousarray(texture[:, :, 2::-1]))
        loaded = bullet.loadTexture(file, physicsClientId=client)
    bullet.changeVisualShape(body, -1, textureUniqueId=loaded, physicsClientId=client)
    return scene.add(Visual(body, -1, np.eye(4), mesh, (1.0, 1.0, 1.0, 1.0), texture, label))


def add_box(client: int, scene: Scene, size: tuple[float, ...], X: np.ndarray, label: int) -> int:
    half = [v / 2 for v in size]
    shape = bullet.createVisualShape(
        bullet.GEOM_BOX, halfExtents=half, rgbaColor=[0.3, 0.3, 0.3, 1], physicsClientId=client
    )
    body: int = bullet.createMultiBody(
        0, -1, shape, X[:3, 3].tolist(), quaternion(X[:3, :3]).tolist(), physicsClientId=client
    )
    scene.add(Visual(body, -1, np.eye(4), box_mesh(size), (0.3, 0.3, 0.3, 1.0), None, label))
    return body


def load_urdf(client: int, text: str, **options: object) -> int:
    with tempfile.TemporaryDirectory() as folder, quiet():
        file = Path(folder) / "body.urdf"
        file.write_text(text)
        body: int = bullet.loadURDF(str(file), physicsClientId=client, **options)
    return body


def build_cell() -> Cell:
    """The UR3e in its full meshes, a belt, and 15 textured spheres of different sizes."""
    client, scene = connect(1 / 240), Scene()
    add_box(client, scene, (0.4, 1.6, 0.05), pose(p=(0.4, 0.0, -0.175)), BELT)
    text = urdf.robot_description()
    robot = load_urdf(client, text, useFixedBase=True)
    add_urdf_visuals(scene, text, robot, client, ROBOT, urdf.resolve)
    for name, angle in zip(urdf.JOINT_NAMES, (0.5, -1.4, 1.2, -1.4, -1.57, 0.3), strict=True):
        for index in range(bullet.getNumJoints(robot, physicsClientId=client)):
            if bullet.getJointInfo(robot, index, physicsClientId=client)[1].decode() == name:
                bullet.resetJointState(robot, index, angle, physicsClientId=client)
    rng = np.random.default_rng(5)
    for i in range(15):
        r = 0.026 + 0.001 * i
        R = rot_z(rng.uniform(0, 6)) @ rot_x(rng.uniform(0, 6)) @ rot_y(rng.uniform(0, 6))
        p = (0.27 + 0.15 * (i % 2) + 0.01 * rng.uniform(), -0.49 + 0.07 * i, -0.15 + r)
        add_textured(client, scene, sphere_mesh(r), skin(i), pose(R, p), ONION + i)
    return Cell(client, scene, robot)


@pytest.fixture(scope="module")
def cell() -> Iterator[Cell]:
    made = build_cell()
    yield made
    bullet.disconnect(physicsClientId=made.client)


@pytest.fixture
def empty() -> Iterator[tuple[int, Scene]]:
    client = connect(1 / 240)
    yield client, Scene()
    bullet.disconnect(physicsClientId=client)


def draw(kind: str, client: int, scene: Scene, pinhole: Pinhole = PINHOLE, X: np.ndarray = X_WC) -> Image:
    renderer = make_renderer(kind, client, scene, Lighting(shadows=False))
    try:
        return renderer.render(X, pinhole, NEAR, FAR)
    finally:
        renderer.close()


def off_edges(labels: np.ndarray, width: int = 2) -> np.ndarray:
    """Pixels at least `width` px away from any change of label."""
    edge = np.zeros(labels.shape, dtype=np.uint8)
    edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    edge[1:] |= labels[1:] != labels[:-1]
    size = 2 * width + 1
    return cv2.dilate(edge, np.ones((size, size), np.uint8)) == 0


def digest(image: Image) -> str:
    sha = hashlib.sha256()
    for part in (image.rgb, image.depth, image.labels, image.marks):
        sha.update(np.ascontiguousarray(part).tobytes())
    return sha.hexdigest()


# -- the two renderers against each other -------------------------------------------------------


@needs_gl
@pytest.mark.parametrize("eye", [(-0.12, -0.36, 0.72), (0.9, 0.7, 0.5)])
def test_gl_agrees_with_the_reference(cell: Cell, eye: tuple[float, float, float]) -> None:
    X = look_at(eye, (0.25, -0.02, -0.05))
    fast, reference = (draw(kind, cell.client, cell.scene, X=X) for kind in ("gl", "tiny"))
    seen = off_edges(reference.labels) & (reference.labels >= 0)
    error = np.abs(fast.depth - reference.depth)[seen]
    assert np.mean(error <= 0.002) >= 0.99
    compared = 0
    for label in np.unique(reference.labels):
        a, b = fast.labels == label, reference.labels == label
        if b.sum() >= 200:
            compared += 1
            assert (a & b).sum() / (a | b).sum() >= 0.97, f"label {label}"
    assert compared >= 15


@pytest.mark.parametrize("kind", BOTH)
def test_projection_is_exact(kind: str, empty: tuple[int, Scene]) -> None:
    """Small spheres appear where the pinhole says, with uneven and off-centre intrinsics."""
    client, scene = empty
    pinhole = Pinhole(640, 480, 640.0, 560.0, 290.3, 255.6)
    rng = np.random.default_rng(1)
    p_CO = np.array(
        [pinhole.back_project((u, v), rng.uniform(0.5, 1.2)) for u in (60, 250, 560) for v in (50, 240, 430)]
    )
    for i, p in enumerate(p_CO):
        shape = bullet.createVisualShape(bullet.GEOM_SPHERE, radius=0.006, physicsClientId=client)
        p_WO = X_WC[:3, :3] @ p + X_WC[:3, 3]
        body = bullet.createMultiBody(0, -1, shape, p_WO.tolist(), physicsClientId=client)
        scene.add(Visual(body, -1, np.eye(4), sphere_mesh(0.006), label=i))
    image = draw(kind, client, scene, pinhole)
    for i, p in enumerate(p_CO):
        rows, columns = np.nonzero(image.labels == i)
        assert len(rows) > 15
        assert np.abs([columns.mean(), rows.mean()] - pinhole.project(p)).max() < 0.3


@pytest.mark.parametrize("kind", BOTH)
def test_depth_is_metric_along_the_optical_axis(kind: str, empty: tuple[int, Scene]) -> None:
    client, scene = empty
    add_box(client, scene, (4.0, 4.0, 0.1), pose(p=(0, 0, -0.05)), 7)
    X = look_at((0.0, -0.8, 0.9), (0.0, 0.0, 0.0))
    image = draw(kind, client, scene, X=X)
    v, u = np.mgrid[0:480, 0:640]
    rays = PINHOLE.back_project(np.stack([u, v], axis=-1), np.ones((480, 640))) @ X[:3, :3].T
    z = np.where(rays[..., 2] < 0, -X[2, 3] / np.minimum(rays[..., 2], -1e-9), np.inf)
    inside = np.abs(X[:3, 3] + z[..., None] * rays)[..., :2].max(axis=-1) < 1.99
    assert inside.sum() > 100_000
    assert np.abs(image.depth - z)[inside].max() < 0.001
    assert np.all(image.labels[inside] == 7)


@pytest.mark.parametrize("kind", BOTH)
def test_nothing_in_sight(kind: str, empty: tuple[int, Scene]) -> None:
    image = draw(kind, *empty)
    assert image.rgb.shape == (480, 640, 3) and image.rgb.dtype == np.uint8
    assert image.depth.dtype == np.float32 and not image.depth.any()
    assert image.labels.dtype == np.int32 and np.all(image.labels == -1)
    assert np.all(image.rgb == np.round(255 * np.array(Lighting().background)).astype(np.uint8))


@pytest.mark.parametrize("kind", BOTH)
def test_texture_row_zero_is_v_one(kind: str, empty: tuple[int, Scene]) -> None:
    """A picture put on a wall is seen upright: its top row has v = 1, its left column u = 0."""
    client, scene = empty
    texture = np.zeros((64, 64, 4), dtype=np.uint8)
    texture[:32, :32], texture[:32, 32:] = (200, 40, 40, 255), (40, 200, 40, 0)
    texture[32:, :32], texture[32:, 32:] = (40, 40, 200, 0), (200, 200, 40, 0)
    wall = Mesh.of(
        [[-0.5, 0, -0.5], [0.5, 0, -0.5], [0.5, 0, 0.5], [-0.5, 0, 0.5]],
        [[0, 1, 2], [0, 2, 3]],
        [[0, -1, 0]] * 4,
        [[0, 0], [1, 0], [1, 1], [0, 1]],
    )
    add_textured(client, scene, wall, texture, np.eye(4), 0)
    image = draw(kind, client, scene, X=look_at((0.0, -1.5, 0.0), (0, 0, 0)))
    strongest = {
        "top left": ((180, 260), [0]), "top right": ((180, 380), [1]),
        "bottom left": ((300, 260), [2]), "bottom right": ((300, 380), [0, 1]),
    }  # fmt: skip
    for where, ((row, column), channels) in strongest.items():
        rgb = image.rgb[row, column].astype(int)
        assert set(np.nonzero(rgb > rgb.max() - 30)[0]) == set(channels), where
    if image.marks is not None:
        assert image.marks[180, 260]
        assert not image.marks[[180, 300, 300], [380, 260, 380]].any()


@pytest.mark.parametrize("kind", BOTH)
def test_visuals_hang_on_urdf_frames_not_inertial_ones(kind: str, empty: tuple[int, Scene]) -> None:
    client, scene = empty
    text = """<robot name="r"><link name="a">
      <inertial><origin xyz="0.1 0.2 -0.1" rpy="0.3 0.2 0.1"/><mass value="1"/>
        <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
      <visual><origin xyz="0 0.05 0" rpy="0 0 0.4"/>
        <geometry><box size="0.3 0.1 0.1"/></geometry></visual></link>
      <link name="b"><inertial><origin xyz="0 0.3 0"/><mass value="1"/>
        <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
      <visual><origin xyz="0.1 0 0"/>
        <geometry><cylinder radius="0.04" length="0.2"/></geometry></visual></link>
      <joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.2" rpy="0.5 0 0"/>
        <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""
    body = load_urdf(client, text, basePosition=[0.3, 0.1, 0.1], baseOrientation=[0.1, 0.2, 0.3, 0.9])
    bullet.resetJointState(body, 0, 0.7, physicsClientId=client)
    add_urdf_visuals(scene, text, body, client, 3, urdf.resolve)
    image = draw(kind, client, scene)
    reference = draw("tiny", client, scene)
    both = (image.labels == 3) & (reference.labels == 3)
    assert both.sum() / ((image.labels == 3) | (reference.labels == 3)).sum() > 0.99
    # Independent of either renderer: the middle of the first box, from the URDF by hand.
    R = from_quaternion(np.array([0.1, 0.2, 0.3, 0.9]) / np.linalg.norm([0.1, 0.2, 0.3, 0.9]))
    inertial = pose(rot_z(0.1) @ rot_y(0.2) @ rot_x(0.3), (0.1, 0.2, -0.1))
    state = bullet.getBasePositionAndOrientation(body, physicsClientId=client)
    X_WL = pose(from_quaternion(state[1]), state[0]) @ np.linalg.inv(inertial)
    assert np.allclose(X_WL, pose(R, (0.3, 0.1, 0.1)), atol=1e-6)
    p_C = np.linalg.inv(X_WC) @ X_WL @ np.array([0.0, 0.05, 0.0, 1.0])
    u, v = np.round(PINHOLE.project(p_C[:3])).astype(int)
    assert image.labels[v, u] == 3


# -- the fast renderer -----------------------------------------------------------------------------


@needs_gl
def test_two_processes_give_the_same_bits() -> None:
    code = (
        "import sys; sys.path[:0] = ['.', 'tests']; import test_render as t\n"
        "c = t.build_cell(); r = t.make_renderer('gl', c.client, c.scene)\n"
        "a = t.digest(r.render(t.X_WC, t.PINHOLE, t.NEAR, t.FAR))\n"
        "b = t.digest(r.render(t.X_WC, t.PINHOLE, t.NEAR, t.FAR)); print(a, b)"
    )
    command = [sys.executable, "-c", code]
    out = [
        subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout for _ in range(2)
    ]
    assert len(set(" ".join(out).split())) == 1, out


@needs_gl
def test_marks_show_marked_texels_and_nothing_else(cell: Cell) -> None:
    image = draw("gl", cell.client, cell.scene)
    assert image.marks is not None
    assert image.marks.sum() > 100
    assert np.all(image.labels[image.marks] >= ONION)
    # By geometry alone: pixel -> point -> place on the sphere -> texel.
    for visual in cell.scene.visuals:
        if visual.texture is None:
            continue
        rows, columns = np.nonzero(image.labels == visual.label)
        p_C = PINHOLE.back_project(np.column_stack([columns, rows]), image.depth[rows, columns])
        p_W = p_C @ X_WC[:3, :3].T + X_WC[:3, 3]
        p, q = bullet.getBasePositionAndOrientation(visual.body, physicsClientId=cell.client)
        n = (p_W - p) @ from_quaternion(q)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        u = np.arctan2(n[:, 1], n[:, 0]) / (2 * np.pi) % 1.0
        v = 1.0 - np.arccos(n[:, 2]) / np.pi
        texel = np.minimum(((1 - v) * 128).astype(int), 127), np.minimum((u * 256).astype(int), 255)
        spot = np.ascontiguousarray(visual.texture[..., 3])
        marked = image.marks[rows, columns]
        assert np.all(cv2.dilate(spot, np.ones((9, 9)))[texel][marked] == 255)
        # Less exact inside: towards the outline one pixel averages many texels.
        assert np.all(marked[cv2.erode(spot, np.ones((13, 13)))[texel] == 255])


@needs_gl
def test_set_vertices_deforms(empty: tuple[int, Scene]) -> None:
    client, scene = empty
    body = bullet.createMultiBody(0, physicsClientId=client)
    ball = sphere_mesh(0.05)
    other = scene.add(Visual(body, -1, pose(p=(0.2, 0, 0)), ball, label=1))
    handle = scene.add(Visual(body, -1, np.eye(4), ball, label=0))
    renderer = make_renderer("gl", client, scene)
    X = look_at((0.0, -1.0, 0.0), (0, 0, 0))
    before = renderer.render(X, PINHOLE, NEAR, FAR)
    scene.set_vertices(handle, 2 * ball.vertices)
    after = renderer.render(X, PINHOLE, NEAR, FAR)
    renderer.close()
    assert abs(before.depth[240, 320] - 0.95) < 1e-3 and abs(after.depth[240, 320] - 0.90) < 1e-3
    assert 3.7 < (after.labels == 0).sum() / (before.labels == 0).sum() < 4.3
    assert (before.labels == 1).sum() == (after.labels == 1).sum()
    with pytest.raises(RenderError, match="expected shape"):
        scene.set_vertices(handle, ball.vertices[:-1])
    scene.remove(other)
    with pytest.raises(RenderError, match="no visual"):
        scene.set_vertices(other, ball.vertices)


@needs_gl
def test_removed_and_added_bodies_and_the_lighting_are_followed(cell: Cell) -> None:
    scene, client = Scene(), cell.client
    for visual in cell.scene.visuals:
        scene.add(visual)
    renderer = make_renderer("gl", client, scene, Lighting(shadows=True))
    lit = renderer.render(X_WC, PINHOLE, NEAR, FAR)
    scene.remove_body(cell.robot)
    bare = renderer.render(X_WC, PINHOLE, NEAR, FAR)
    assert (lit.labels == ROBOT).any() and not (bare.labels == ROBOT).any()
    belt = (lit.labels == BELT) & (bare.labels == BELT)
    assert (bare.rgb[belt].sum(axis=1).astype(int) - lit.rgb[belt].sum(axis=1) > 20).sum() > 200  # its shadow
    renderer.lighting = Lighting(shadows=False, ambient=0.2, diffuse=0.1, background=(0.0, 0.5, 1.0))
    dim = renderer.render(X_WC, PINHOLE, NEAR, FAR)
    assert dim.rgb[belt].mean() < 0.7 * bare.rgb[belt].mean()
    assert np.all(dim.rgb[dim.labels == -1] == (0, 128, 255))
    assert np.array_equal(dim.depth, bare.depth) and np.array_equal(dim.labels, bare.labels)
    renderer.close()
    renderer.close()
    with pytest.raises(RenderError, match="closed"):
        renderer.render(X_WC, PINHOLE, NEAR, FAR)


@needs_gl
def test_rendering_leaves_the_physics_alone() -> None:
    def run(look: bool) -> str:
        client, scene = connect(1 / 240), Scene()
        text = urdf.robot_description(with_meshes=False)
        robot = load_urdf(client, text, useFixedBase=True)
        add_urdf_visuals(scene, text, robot, client, ROBOT, urdf.resolve)
        renderer = make_renderer("gl", client, scene)
        for step in range(60):
            bullet.stepSimulation(physicsClientId=client)
            if look and step % 7 == 0:
                renderer.render(X_WC, Pinhole.from_hfov(64, 48, 1.0), NEAR, FAR)
        states = bullet.getJointStates(robot, range(8), physicsClientId=client)
        renderer.close()
        bullet.disconnect(physicsClientId=client)
        return repr([s[:2] for s in states])

    assert run(look=True) == run(look=False)


# -- choosing -----------------------------------------------------------------------------------


def test_without_egl_gl_says_what_to_install_and_auto_falls_back() -> None:
    code = (
        "import warnings; warnings.simplefilter('always')\n"
        "from hil.sim.render.renderer import make_renderer, gl_problem\n"
        "from hil.sim.render.scene import Scene\n"
        "print(gl_problem())\n"
        "with warnings.catch_warnings(record=True) as caught:\n"
        "    print(make_renderer('auto', 0, Scene()).name, len(caught))\n"
        "try: make_renderer('gl', 0, Scene())\n"
        "except Exception as e: print(type(e).__name__)"
    )
    env = {**os.environ, "GLCONTEXT_LINUX_LIBEGL": "/nonexistent/libEGL.so", "PYTHONPATH": str(ROOT)}
    out = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    problem, fallback, error = out.stdout.splitlines()
    assert "apt-get install libegl1" in problem
    assert fallback == "tiny 1"
    assert error == "RenderError"


def test_unknown_choice_lists_the_legal_ones() -> None:
    with pytest.raises(RenderError, match="auto, gl, tiny"):
        make_renderer("vulkan", 0, Scene())


# -- meshes and scenes ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (box_mesh((0.1, 0.2, 0.3)), 0.006),
        (cylinder_mesh(0.05, 0.2), np.pi * 0.05**2 * 0.2),
        (sphere_mesh(0.05), 4 / 3 * np.pi * 0.05**3),
        (capsule_mesh(0.05, 0.2), 4 / 3 * np.pi * 0.05**3 + np.pi * 0.05**2 * 0.2),
    ],
)
def test_primitives_are_closed_and_face_outwards(mesh: Mesh, volume: float) -> None:
    corners = mesh.vertices[mesh.faces].astype(float)
    signed = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert 0.97 * volume < signed <= 1.0001 * volume
    face_n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.all(np.einsum("fi,fki->fk", face_n, mesh.normals[mesh.faces]) > 0)
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("name", ["base", "shoulder", "upperarm", "forearm", "wrist1", "wrist2", "wrist3"])
def test_simplified_meshes_stay_within_a_millimetre(name: str) -> None:
    """Every point of the cheap surface; what it leaves out is compared as seen by a camera below."""
    import trimesh

    original = Mesh.from_file(urdf.resolve(f"package://airo_models/arms/ur3e/visual/{name}.obj"))
    cheap = original.simplified(MESH_ERROR)
    assert len(cheap.faces) < 0.25 * len(original.faces) + 1500
    assert cheap.colors is not None and original.colors is not None
    assert set(map(tuple, cheap.colors)) == set(map(tuple, original.colors))
    surface = trimesh.Trimesh(original.vertices, original.faces, process=False)
    points = trimesh.sample.sample_surface(
        trimesh.Trimesh(cheap.vertices, cheap.faces, process=False), 400, seed=0
    )[0]
    distance = trimesh.proximity.closest_point(surface, points)[1]
    assert distance.max() < 1e-3


@needs_gl
def test_simplified_robot_looks_like_the_original(empty: tuple[int, Scene]) -> None:
    client, scene = empty
    body = bullet.createMultiBody(0, physicsClientId=client)
    original = Mesh.from_file(urdf.resolve("package://airo_models/arms/ur3e/visual/upperarm.obj"))
    depths = []
    for mesh in (original, original.simplified(MESH_ERROR)):
        scene.remove_body(body)
        scene.add(Visual(body, -1, np.eye(4), mesh, label=0))
        images = [
            draw("gl", client, scene, X=look_at(eye, (0, 0, 0.15)))
            for eye in ((0.5, 0.1, 0.2), (-0.4, 0.3, 0.1), (0.1, -0.5, 0.5))
        ]
        depths.append(np.stack([image.depth for image in images]))
    seen = (depths[0] > 0) & (depths[1] > 0)
    assert (depths[0] > 0).sum() > 50_000
    assert ((depths[0] > 0) != (depths[1] > 0)).sum() < 0.003 * seen.sum()
    # A camera sees steps of the surface a pixel early or late, hence not every single pixel.
    assert np.mean(np.abs(depths[0] - depths[1])[seen] < 1e-3) > 0.995


def test_obj_files(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"
        "usemtl red\nf 1/1/1 2/2/1 3/3/1\nusemtl blue\nf 1/1/1 3/3/1 4/4/1\n"
    )
    mesh = Mesh.from_file(tmp_path / "m.obj", (2.0, 1.0, 1.0))
    assert mesh.faces.shape == (2, 3) and mesh.uv is not None and mesh.colors is not None
    assert mesh.vertices[:, 0].max() == 2.0
    assert mesh.colors[mesh.faces[0]].tolist() == [[255, 0, 0]] * 3
    assert mesh.colors[mesh.faces[1]].tolist() == [[0, 0, 255]] * 3
    assert mesh.simplified(1e-3) is mesh
    (tmp_path / "q.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    quad = Mesh.from_file(tmp_path / "q.obj")
    assert len(quad.faces) == 2 and np.allclose(quad.normals, [0, 0, 1])
    for content in ("v 0 0 0\n", "v 0 0 0\nf 1 2 3\n", "v a b c\nf 1 1 1\n"):
        (tmp_path / "bad.obj").write_text(content)
        with pytest.raises(RenderError, match="cannot read mesh"):
            Mesh.from_file(tmp_path / "bad.obj")
    with pytest.raises(RenderError, match="not found"):
        Mesh.from_file(tmp_path / "none.obj")


@pytest.mark.parametrize(
    ("visual", "message"),
    [
        ("<geometry><torus/></geometry>", "legal: box"),
        ("<geometry><box size='1 2'/></geometry>", "expected 3 numbers"),
        ("<geometry><mesh filename='package://nowhere/a.obj'/></geometry>", "not installed"),
        ("", "without <geometry>"),
    ],
)
def test_bad_urdf_visuals_are_named(visual: str, message: str, empty: tuple[int, Scene]) -> None:
    client, scene = empty
    body = load_urdf(client, "<robot name='r'><link name='a'/></robot>")
    text = f"<robot name='r'><link name='a'><visual>{visual}</visual></link></robot>"
    with pytest.raises(RenderError, match=message):
        add_urdf_visuals(scene, text, body, client, 0, urdf.resolve)
    with pytest.raises(RenderError, match="not in the body"):
        add_urdf_visuals(scene, text.replace("'a'", "'z'"), body, client, 0, urdf.resolve)


def test_unusable_visuals_are_refused() -> None:
    plain = Mesh.of([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    rgba = (1.0, 1.0, 1.0, 1.0)
    with pytest.raises(RenderError, match="no texture coordinates"):
        Scene().add(Visual(0, -1, np.eye(4), plain, rgba, np.zeros((4, 4, 4), np.uint8)))
    with pytest.raises(RenderError, match=r"\(H, W, 4\) uint8"):
        Scene().add(Visual(0, -1, np.eye(4), sphere_mesh(0.1), rgba, np.zeros((4, 4, 3), np.uint8)))
    with pytest.raises(RenderError, match="label"):
        Scene().add(Visual(0, -1, np.eye(4), plain, rgba, None, -1))
    with pytest.raises(ValueError, match="face indices"):
        Mesh.of([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]])


@settings(max_examples=200, deadline=None)
@given(
    st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.1, 5.0)),
    st.tuples(st.floats(200, 900), st.floats(200, 900), st.floats(200, 440), st.floats(150, 330)),
)
def test_projection_matrices_are_the_pinhole(
    p: tuple[float, float, float], k: tuple[float, float, float, float]
) -> None:
    pinhole = Pinhole(640, 480, *k)
    u, v = pinhole.project(np.array(p))
    x, y, z, w = gl._projection(pinhole, 0.05, 6.0) @ [*p, 1.0]
    assert np.isclose((x / w + 1) * 320 - 0.5, u) and np.isclose((y / w + 1) * 240 - 0.5, v)
    assert -1 <= z / w <= 1
    x, y, z, w = tiny._projection(pinhole, 0.05, 6.0) @ [p[0], -p[1], -p[2], 1.0]
    depth = 0.05 * 6.0 / (6.0 - (6.0 - 0.05) * (z / w + 1) / 2)
    assert np.isclose(depth, p[2]) and np.isclose((x / w + 1) * 320, u)
