"""The simulated person's body: mesh, skinning, inverse kinematics, hands and texture, without pictures."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from functools import cache
from importlib.resources import files
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.config import load
from cell.errors import ConfigError
from cell.frames import Array, rot_x, rot_y, rot_z
from hil.sim.person.body import Body, body_names
from hil.sim.person.hands import SHAPES, shape
from hil.sim.person.keyposes import KeyPoses
from hil.sim.person.reach import Pose, Poser, hand_frame
from hil.sim.person.stance import Arm, Stance, blend, minimum_jerk
from hil.sim.person.texture import SKINS, Look, paint

CONFIG = load()
FLOOR = CONFIG.floor_z
BODIES = pytest.mark.parametrize("name", body_names())
MIRROR = np.diag([1.0, -1.0, 1.0])
"""Left to right, in P."""
angle = st.floats(-np.pi, np.pi)


@cache
def poser(name: str) -> Poser:
    return Poser(Body(name), FLOOR)


def standing(name: str, **changes: float) -> Stance:
    p = poser(name)
    return replace(Stance(0.0, 0.0, 0.0, p.hanging("L"), p.hanging("R")), **changes)


def degrees_between(a: Array, b: Array) -> float:
    cos = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(cos, -1.0, 1.0))))


def skinned(name: str, pose: Pose) -> Array:
    return poser(name).body.skin(pose.G, pose.p)[0].astype(float)


# -- the data ----------------------------------------------------------------------------------------


def test_the_bodies_are_small_plain_arrays() -> None:
    path = files("hil.sim.person") / "data" / "bodies.npz"
    with path.open("rb") as file:
        data = np.load(file, allow_pickle=False)
        kinds = {data[key].dtype.kind for key in data.files}
    assert "O" not in kinds
    with path.open("rb") as file:
        assert sum(entry.compress_size for entry in zipfile.ZipFile(file).infolist()) < 3e6
    assert (files("hil.sim.person") / "data" / "NOTICE").is_file()


def test_there_are_six_bodies_of_different_heights() -> None:
    heights = sorted(Body(name).height for name in body_names())
    assert len(heights) >= 6
    assert heights[0] >= 1.55 and heights[-1] <= 1.91
    assert heights[-1] - heights[0] > 0.15


def test_an_unknown_body_is_an_error_that_lists_the_names() -> None:
    with pytest.raises(ConfigError, match=", ".join(body_names())):
        Body("giant")


@BODIES
def test_the_mesh_is_whole(name: str) -> None:
    mesh = Body(name).mesh
    assert mesh.uv is not None and mesh.uv.min() >= 0.0 and mesh.uv.max() <= 1.0
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)  # no vertex without a triangle
    tri = mesh.vertices[mesh.faces].astype(float)
    volume = np.einsum("ij,ij->i", tri[:, 0], np.cross(tri[:, 1], tri[:, 2])).sum() / 6.0
    assert 0.03 < volume < 0.13  # [m3]: positive means that triangles face outwards
    face = np.cross(tri[:, 1] - tri[:, 0], tri[:, 2] - tri[:, 0])
    assert (np.einsum("ij,ij->i", face, mesh.normals[mesh.faces[:, 0]]) > 0.0).mean() > 0.97


# -- skinning ----------------------------------------------------------------------------------------


@BODIES
def test_bones_at_rest_leave_the_mesh_at_rest(name: str) -> None:
    body = Body(name)
    still = np.tile(np.eye(3), (len(body.rig.bones), 1, 1))
    vertices, normals = body.skin(still, body.rig.p)
    assert vertices.dtype == normals.dtype == np.float32
    assert np.allclose(vertices, body.mesh.vertices, atol=2e-6)
    assert np.allclose(normals, body.mesh.normals, atol=1e-4)


@given(angle, angle, angle, st.tuples(*[st.floats(-2.0, 2.0)] * 3))
@settings(max_examples=15, deadline=None)
def test_a_rigid_motion_of_all_bones_moves_the_mesh_rigidly(
    a: float, b: float, c: float, shift: tuple[float, float, float]
) -> None:
    body = poser("lean").body
    R, t = rot_z(a) @ rot_y(b) @ rot_x(c), np.array(shift)
    G = np.tile(R, (len(body.rig.bones), 1, 1))
    vertices, normals = body.skin(G, body.rig.p @ R.T + t)
    assert np.allclose(vertices, body.mesh.vertices @ R.T + t, atol=5e-6)
    assert np.allclose(normals, body.mesh.normals @ R.T, atol=1e-3)


def test_seams_of_the_texture_stay_closed() -> None:
    body = poser("slim").body
    pose = poser("slim").pose(standing("slim", lean=0.5, twist=0.3))
    vertices, normals = body.skin(pose.G, pose.p)
    _, group = np.unique(body.mesh.vertices, axis=0, return_inverse=True)
    order = np.argsort(group, kind="stable")
    same = np.flatnonzero(np.diff(group[order]) == 0)
    assert len(same) > 500
    assert np.allclose(vertices[order[same]], vertices[order[same + 1]], atol=1e-6)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-4)


def test_points_are_the_vertices_without_copies() -> None:
    pose = poser("tall").pose(standing("tall", lean=0.3))
    body = poser("tall").body
    points, vertices = body.points(pose.G, pose.p), body.skin(pose.G, pose.p)[0]
    assert len(points) < len(vertices)
    assert {p.tobytes() for p in points} >= {v.tobytes() for v in vertices}
    assert np.array_equal(body.points(pose.G, pose.p, 4), points[::4])


def test_the_same_stance_gives_the_same_bits() -> None:
    stance = standing("short", lean=0.4, twist=-0.2, stride=0.3)
    first, second = (Poser(Body("short"), FLOOR).pose(stance) for _ in range(2))
    assert first.G.tobytes() == second.G.tobytes() and first.p.tobytes() == second.p.tobytes()
    assert skinned("short", first).tobytes() == skinned("short", second).tobytes()


# -- standing ----------------------------------------------------------------------------------------


@BODIES
def test_a_person_stands_on_the_floor_and_faces_ahead(name: str) -> None:
    pose = poser(name).pose(standing(name, x=1.0, y=-0.5, yaw=np.pi / 2))
    v, rig = skinned(name, pose), Body(name).rig
    assert abs(v[:, 2].min() - FLOOR) < 0.012
    assert abs(v[:, 2].max() - FLOOR - Body(name).height) < 0.03
    ankles = pose.p[[rig.index("foot.L"), rig.index("foot.R")]]
    assert np.linalg.norm(ankles.mean(axis=0)[:2] - [1.0, -0.5]) < 0.02
    assert ankles[0, 0] < 1.0 < ankles[1, 0]  # yaw 90 degrees: the left is towards -x
    sole = v[v[:, 2] < FLOOR + 0.03]
    assert sole[:, 1].max() + 0.5 > 0.15 > -0.5 - sole[:, 1].min()  # toes ahead, heels behind


@BODIES
def test_leaning_forward_moves_the_head_but_not_the_feet(name: str) -> None:
    upright, leant = (skinned(name, poser(name).pose(standing(name, lean=a))) for a in (0.0, 0.5))
    legs = upright[:, 2] < FLOOR + 0.45
    assert np.abs(leant - upright)[legs].max() < 1e-4
    top = np.argmax(upright[:, 2])
    assert leant[top, 0] - upright[top, 0] > 0.25 and leant[top, 2] < upright[top, 2]


def test_bones_keep_their_length_in_every_stance() -> None:
    rig = poser("broad").body.rig
    rng = np.random.default_rng(4)
    child = np.array([i for i, b in enumerate(rig.bones) if b.startswith(("lowerarm", "wrist", "lowerleg"))])
    parent = np.array(rig.parents)[child]
    rest = np.linalg.norm(rig.p[child] - rig.p[parent], axis=1)
    for _ in range(20):
        arms = [random_arm(rng, side) for side in "LR"]
        pose = poser("broad").pose(Stance(0.0, 0.0, 1.0, arms[0], arms[1], 0.3, 0.2, 0.3, 0.5))
        # Axes at rest are float32.
        assert np.allclose(pose.G @ pose.G.transpose(0, 2, 1), np.eye(3), atol=1e-5)
        assert np.allclose(np.linalg.det(pose.G), 1.0, atol=1e-5)
        assert np.allclose(np.linalg.norm(pose.p[child] - pose.p[parent], axis=1), rest, atol=1e-6)


# -- arms --------------------------------------------------------------------------------------------


def random_arm(rng: np.random.Generator, side: str) -> Arm:
    """Somewhere before the person, any way round; often out of reach or impossible for a wrist."""
    out = 1.0 if side == "L" else -1.0
    p = np.array([rng.uniform(0.1, 0.9), out * rng.uniform(-0.3, 0.6), rng.uniform(0.6, 1.7)])
    R = rot_z(rng.uniform(-3, 3)) @ rot_y(rng.uniform(-1.5, 1.5)) @ rot_x(rng.uniform(-3, 3))
    return Arm(p, R, rng.uniform(-0.3, 2.4), shape(str(rng.choice(SHAPES)), rng, 0.1))


@pytest.mark.parametrize("side", ["L", "R"])
def test_a_wrist_never_bends_beyond_its_limit(side: str) -> None:
    rng = np.random.default_rng(7)
    rig = poser("lean").body.rig
    wrist, fore = rig.index(f"wrist.{side}"), rig.index(f"lowerarm01.{side}")
    along = rig.p[wrist] - rig.p[fore]
    for _ in range(150):
        stance = standing("lean").with_arm(side, random_arm(rng, side))
        pose = poser("lean").pose(stance)
        assert degrees_between(pose.G[fore] @ along, pose.G[wrist] @ along) < 25.1


@BODIES
def test_out_of_reach_the_arm_points_at_the_goal(name: str) -> None:
    far = Arm(np.array([3.0, 0.5, 1.2]), hand_frame((1, 0, 0), (0, -1, 0)), 0.3)
    pose = poser(name).pose(standing(name).with_arm("L", far))
    rig = poser(name).body.rig
    shoulder, wrist = (pose.p[rig.index(f"{bone}.L")] for bone in ("upperarm01", "wrist"))
    goal = far.p + np.array([0.0, 0.0, FLOOR])
    assert degrees_between(wrist - shoulder, goal - shoulder) < 4.0
    assert np.isfinite(pose.p).all()


@BODIES
@pytest.mark.parametrize("fingers", SHAPES)
def test_left_and_right_are_mirror_images(name: str, fingers: str) -> None:
    """Also the fingers, whose turns about y and z change their sign."""
    R = hand_frame((0.9, -0.2, 0.3), (0.2, 0.9, -0.4))
    right = Arm(np.array([0.4, -0.2, 1.15]), R, 0.7, shape(fingers))
    R_left = MIRROR @ R @ np.diag([1.0, -1.0, 1.0])
    left = Arm(MIRROR @ right.p, R_left, 0.7, shape(fingers))
    pose = poser(name).pose(standing(name).with_arm("L", left).with_arm("R", right))
    marks_L, marks_R = (poser(name).landmarks(pose, side) for side in "LR")
    assert np.allclose(marks_L, marks_R @ MIRROR, atol=2e-3)
    assert np.allclose(poser(name).grip(pose, "L"), MIRROR @ poser(name).grip(pose, "R"), atol=2e-3)


# -- hands -------------------------------------------------------------------------------------------


def hand(name: str, fingers: str) -> tuple[Array, Array]:
    """Landmarks of a right hand (21, 3) in its own frame, from the wrist, and its finger lengths."""
    R = hand_frame((1, 0, 0), (0, 0, -1))
    arm = Arm(np.array([0.42, -0.2, 1.2]), R, 0.5, shape(fingers))
    pose = poser(name).pose(standing(name).with_arm("R", arm))
    marks = poser(name).landmarks(pose, "R")
    along = marks[9] - marks[0]
    own = hand_frame(along, np.cross(along, marks[17] - marks[5]))
    lengths = np.linalg.norm(np.diff(marks[1:].reshape(5, 4, 3), axis=1), axis=2)
    return (marks - marks[0]) @ own, lengths


@BODIES
def test_hands_have_the_size_of_hands(name: str) -> None:
    """From the wrist's joint, which lies about 1 cm before the crease."""
    marks, lengths = hand(name, "open")
    assert 0.075 < marks[9, 0] < 0.120
    assert 0.160 < np.linalg.norm(marks[12]) < 0.225
    assert (lengths > 0.015).all() and (lengths < 0.07).all()
    assert np.argmax(lengths[1:].sum(axis=1)) == 1  # the middle finger is the longest


@BODIES
@pytest.mark.parametrize("fingers", ["thumb", "fist"])
def test_closed_fingers_lie_in_the_palm_and_not_through_it(name: str, fingers: str) -> None:
    closed, _ = hand(name, fingers)
    flat, _ = hand(name, "open")
    tips, knuckles = closed[[8, 12, 16, 20]], closed[[5, 9, 13, 17]]
    ratio = np.linalg.norm(tips, axis=1) / np.linalg.norm(knuckles, axis=1)
    assert ratio.mean() < 1.4 < (np.linalg.norm(flat[[8, 12, 16, 20]], axis=1) / knuckles[:, 0]).mean()
    assert (tips[:, 2] > 0.005).all()  # on the palm's side
    away = np.linalg.norm(closed[[5, 6, 10]] - closed[4], axis=1).min() / np.linalg.norm(closed[9])
    assert away > 0.4 if fingers == "thumb" else away < 0.4


@BODIES
def test_the_signs_point_where_they_should(name: str) -> None:
    keys = KeyPoses(poser(name), CONFIG, "R")
    for sign, up in (("up", 1.0), ("down", -1.0)):
        arm = keys.sign(sign, 0.0, shape("thumb"))
        trunk = keys.trunk(arm, "L")
        lean, twist, nod = (float(v) for v in trunk)
        stance = standing(name, lean=lean, twist=twist, nod=nod)
        pose = poser(name).pose(stance.with_arm("L", keys.settled(arm, "L", trunk)))
        marks = poser(name).landmarks(pose, "L")
        assert degrees_between(marks[4] - marks[2], np.array([0.0, 0.0, up])) < 40.0
        tip, rest = marks[4, 2] * up, np.delete(marks[:, 2], [2, 3, 4]) * up
        assert tip > rest.max()


def test_sloppy_fingers_are_seeded_and_stay_near() -> None:
    a, b = (shape("thumb", np.random.default_rng(3), 0.05) for _ in range(2))
    assert np.array_equal(a, b)
    assert 0.0 < np.abs(a - shape("thumb")).max() < 0.3
    assert not np.array_equal(a, shape("thumb", np.random.default_rng(4), 0.05))


# -- between stances ---------------------------------------------------------------------------------


def test_blending_begins_and_ends_where_it_should_and_never_jumps() -> None:
    rng = np.random.default_rng(11)
    a = standing("slim", x=0.2, yaw=3.0).with_arm("L", random_arm(rng, "L"))
    b = standing("slim", lean=0.4, yaw=-3.0).with_arm("L", random_arm(rng, "L"))
    assert blend(a, b, 0.0) is a and blend(a, b, 1.0) is b
    steps = [blend(a, b, w) for w in np.linspace(0.001, 0.999, 200)]
    for s, t in pairwise(steps):
        assert np.allclose(s.left.R @ s.left.R.T, np.eye(3), atol=1e-9)
        assert degrees_between(s.left.R[:, 0], t.left.R[:, 0]) < 2.0
        assert np.linalg.norm(t.left.p - s.left.p) < 0.02
        assert abs(t.yaw - s.yaw) < 0.01  # the short way round, not through zero
    assert minimum_jerk(-1.0) == 0.0 and minimum_jerk(0.5) == 0.5 and minimum_jerk(2.0) == 1.0


# -- texture -----------------------------------------------------------------------------------------


@cache
def painted(sleeve: float) -> tuple[Array, Array]:
    """Colours of the mesh's vertices (V, 3), read as a renderer does, and the texture."""
    body = poser("tall").body
    texture = paint(body, Look(SKINS[5], shirt=(40, 200, 40), sleeve=sleeve))
    assert body.mesh.uv is not None
    size = len(texture)
    u, v = np.clip(body.mesh.uv * size, 0, size - 1).astype(int).T
    return texture[np.clip(size - 1 - v, 0, size - 1), u, :3].astype(float), texture


@pytest.mark.parametrize("sleeve", [0.2, 0.9])
def test_skin_clothes_and_hair_are_where_they_belong(sleeve: float) -> None:
    colours, texture = painted(sleeve)
    assert texture.dtype == np.uint8 and not texture[..., 3].any()  # nothing is a mark
    body = poser("tall").body
    bone, rest = body.region()
    names = np.array(body.rig.bones)[bone]

    def share(where: Array, colour: tuple[int, int, int]) -> float:
        return float((np.abs(colours[where] - colour).max(axis=1) < 45).mean())

    look = Look(SKINS[5])
    fingers = np.char.startswith(names, "finger")
    assert share(fingers, SKINS[5]) > 0.97
    assert share(rest[:, 2] > 0.985 * body.height, look.hair) > 0.97
    assert share(rest[:, 2] < 0.02, look.shoes) > 0.97
    chest = np.char.startswith(names, "spine") & (rest[:, 2] > 0.66 * body.height)
    assert share(chest & (rest[:, 2] < 0.74 * body.height), (40, 200, 40)) > 0.95
    fore = np.char.startswith(names, "lowerarm01")
    assert share(fore, (40, 200, 40) if sleeve == 0.9 else SKINS[5]) > 0.95


def test_painting_is_seeded() -> None:
    body = poser("tall").body
    first, again, other = (paint(body, Look(seed=seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
