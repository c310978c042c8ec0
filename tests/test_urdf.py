"""The robot's description against published numbers and against every other kinematics here.

Reference poses: computed from the Denavit-Hartenberg table that Universal Robots publishes for
the UR3e; positions and axis-angle in the controller's frame "base".
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import urdf
from cell.config import load
from cell.frames import Array, from_quaternion, inverse, pose, rot_x, rot_y, rot_z
from cell.limits import Q_MAX, QD_MAX, fk_flange, tcp_positions
from cell.motion.collision import CollisionModel
from hil.sim.physics import bullet, connect, quiet

X_WB = pose(rot_z(np.pi))
"""The controller's base in the world."""
REFERENCE = [
    (
        (-1.54, -1.83, -2.28, -0.59, 1.60, 0.023),
        (-0.119995, -0.273535, 0.120594),
        (-0.012413, 3.111990, -0.018048),
    ),
    ((0.3, -1.2, 1.1, -1.4, -1.5, 0.7), (-0.321443, -0.243430, 0.302456), (2.546676, 1.683626, 0.073301)),
    ((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (-0.456750, -0.223150, 0.066500), (1.570796, 0.0, 0.0)),
]
ARM_MASSES = [1.98, 3.4445, 1.437, 0.871, 0.805, 0.261]
LINKS = [
    "base_link",
    "base",
    "base_link_inertia",
    "shoulder_link",
    "upper_arm_link",
    "forearm_link",
    "wrist_1_link",
    "wrist_2_link",
    "wrist_3_link",
    "flange",
    "tool0",
    "gripper_base",
    "left_finger",
    "right_finger",
    "tcp",
]


@cache
def description() -> ET.Element:
    return ET.fromstring(urdf.robot_description())


@cache
def robot() -> Any:
    """yourdfpy's reading of the description, an implementation that is not ours."""
    import io

    import yourdfpy

    return yourdfpy.URDF.load(io.StringIO(urdf.robot_description(with_meshes=False)), load_meshes=False)


def random_joints(count: int) -> Array:
    return np.random.default_rng(5).uniform(-np.pi, np.pi, (count, 6))


def X_W(link: str, q: Array) -> Array:
    """Pose of a link in the world by yourdfpy."""
    robot().update_cfg(dict(zip(urdf.JOINT_NAMES, q, strict=True)))
    return np.asarray(robot().get_transform(link, "base_link"))


def test_kinematics_equals_yourdfpys() -> None:
    for q in random_joints(20):
        np.testing.assert_allclose(fk_flange(q), X_W("tool0", q), atol=1e-6)
        p_WT = tcp_positions(q[None], load().gripper.length)[0]
        np.testing.assert_allclose(p_WT, X_W("tcp", q)[:3, 3], atol=1e-6)


@pytest.mark.parametrize(("q", "p", "axis_angle"), REFERENCE)
def test_published_reference_poses(q: tuple[float, ...], p: Array, axis_angle: Array) -> None:
    for X_WE in (fk_flange(np.array(q)), X_W("tool0", np.array(q))):
        X_BE = inverse(X_WB) @ X_WE
        np.testing.assert_allclose(X_BE[:3, 3], p, atol=2e-6)
        expected = Rotation.from_rotvec(axis_angle).as_matrix()
        np.testing.assert_allclose(X_BE[:3, :3], expected, atol=5e-6)


def test_base_is_base_link_turned_by_half_a_turn() -> None:
    """RTDE reports poses in `base`; ROS and this project use `base_link`."""
    np.testing.assert_allclose(X_W("base", np.zeros(6)), X_WB, atol=1e-12)
    q, (x, y, z) = np.array(REFERENCE[0][0]), REFERENCE[0][1]
    np.testing.assert_allclose(X_W("tool0", q)[:3, 3], (-x, -y, z), atol=2e-6)


def test_kinematics_equals_the_analytic_package() -> None:
    from ur_analytic_ik import ur3e

    for q in random_joints(20):
        X_BE = np.asarray(ur3e.forward_kinematics(*q))
        np.testing.assert_allclose(X_WB @ X_BE, fk_flange(q), atol=1e-6)


def test_pybullet_agrees(tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf"
    file.write_text(urdf.robot_description(with_meshes=False))
    client = connect(0.002)
    try:
        with quiet():
            body = bullet.loadURDF(str(file), useFixedBase=True, physicsClientId=client)
        count = bullet.getNumJoints(body, physicsClientId=client)
        info = [bullet.getJointInfo(body, i, physicsClientId=client) for i in range(count)]
        joint = {row[1].decode(): row[0] for row in info}
        link = {row[12].decode(): row[0] for row in info}
        for q in random_joints(10):
            for name, angle in zip(urdf.JOINT_NAMES, q, strict=True):
                bullet.resetJointState(body, joint[name], angle, physicsClientId=client)
            state = bullet.getLinkState(
                body, link["tool0"], computeForwardKinematics=True, physicsClientId=client
            )
            X_WE = pose(from_quaternion(state[5]), state[4])
            np.testing.assert_allclose(X_WE, fk_flange(q), atol=1e-5)
    finally:
        bullet.disconnect(client)


def test_links_joints_and_limits_are_complete() -> None:
    tree = description()
    assert [link.get("name") for link in tree.iter("link")] == LINKS
    joints = {j.get("name"): j for j in tree.iter("joint")}
    for i, name in enumerate(urdf.JOINT_NAMES):
        limit = joints[name].find("limit")
        assert joints[name].get("type") == "revolute" and limit is not None
        assert float(limit.get("upper", "")) == -float(limit.get("lower", "")) == pytest.approx(Q_MAX[i])
        assert float(limit.get("velocity", "")) == pytest.approx(QD_MAX[i])
        assert float(limit.get("effort", "")) == (54.0, 54.0, 28.0, 9.0, 9.0, 9.0)[i]
    children = [j.find("child").get("link") for j in tree.iter("joint")]  # type: ignore[union-attr]
    assert sorted(map(str, children)) == sorted(set(LINKS) - {"base_link"})


def test_every_moving_link_looks_like_something_and_can_collide() -> None:
    tree = description()
    meshes = [Path(m.get("filename", "")) for m in tree.iter("mesh")]
    assert len(meshes) == 7 and all(m.is_file() for m in meshes)
    for link in tree.iter("link"):
        if link.get("name") in ("base_link", "base", "flange", "tool0", "tcp"):
            assert link.find("inertial") is None
            continue
        assert link.find("visual") is not None and link.find("collision") is not None
        assert link.find("inertial/mass") is not None and link.find("inertial/inertia") is not None
    bare = ET.fromstring(urdf.robot_description(with_meshes=False))
    assert not list(bare.iter("mesh")) and len(list(bare.iter("link"))) == len(LINKS)


def test_masses_and_inertias() -> None:
    mass, tensor = {}, {}
    for link in description().iter("link"):
        if (m := link.find("inertial/mass")) is not None:
            mass[link.get("name")] = float(m.get("value", ""))
            i = link.find("inertial/inertia")
            assert i is not None
            tensor[link.get("name")] = [float(i.get(k, "")) for k in ("ixx", "iyy", "izz")]
    arm = [
        mass[n] for n in LINKS if n in mass and n.endswith("_link") and not n.startswith(("base", "gripper"))
    ]
    assert arm == ARM_MASSES
    assert mass["base_link_inertia"] == 2.0
    assert sum(mass.values()) == pytest.approx(2.0 + 8.7985 + 0.925)  # base, arm, 2F-85
    for name, (xx, yy, zz) in tensor.items():  # what a body of positive mass can have
        assert min(xx, yy, zz) > 0.0 and xx <= yy + zz and yy <= xx + zz and zz <= xx + yy, name


def test_the_gripper_is_a_2f85() -> None:
    gripper = load().gripper
    joints = {j.get("name"): j for j in description().iter("joint")}
    stroke, speed = 0.0, 0.0
    for name in urdf.FINGER_JOINT_NAMES:
        limit = joints[name].find("limit")
        assert joints[name].get("type") == "prismatic" and limit is not None
        assert float(limit.get("effort", "")) == 235.0 and float(limit.get("lower", "")) == 0.0
        stroke += float(limit.get("upper", ""))
        speed += float(limit.get("velocity", ""))
    assert stroke == pytest.approx(0.085) == gripper.stroke
    assert speed == pytest.approx(0.150) == gripper.max_speed
    assert (gripper.min_speed, gripper.min_force, gripper.max_force) == (0.020, 20.0, 235.0)
    p_ET = (inverse(X_W("tool0", np.zeros(6))) @ X_W("tcp", np.zeros(6)))[:3, 3]
    np.testing.assert_allclose(p_ET, (0.0, 0.0, gripper.length), atol=1e-12)


def test_missing_meshes_say_which() -> None:
    with pytest.raises(FileNotFoundError, match="not installed"):
        urdf.resolve("package://no_such_package/mesh.obj")
    with pytest.raises(FileNotFoundError, match=r"no such file.*airo_models"):
        urdf.resolve("package://airo_models/arms/ur3e/visual/none.obj")


@pytest.mark.parametrize("link", ["upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link"])
def test_the_planner_knows_every_part_that_can_touch(link: str) -> None:
    """Collision shapes lie inside the planner's spheres, but for little more than the clearance it keeps."""
    config = load()
    model = CollisionModel(config)
    for q in (np.array(config.arm.home), np.array([0.3, -1.2, 1.1, -1.4, -1.5, 0.7])):
        p_WS, radii, _ = model.spheres(q[None])
        for shape in description().findall(f"./link[@name='{link}']/collision"):
            cylinder = shape.find("geometry/cylinder")
            assert cylinder is not None
            points = _surface(float(cylinder.attrib["radius"]), float(cylinder.attrib["length"]))
            X_WC = X_W(link, q) @ _origin(shape.find("origin"))
            points = points @ X_WC[:3, :3].T + X_WC[:3, 3]
            outside = (np.linalg.norm(points[:, None] - p_WS[0], axis=2) - radii).min(axis=1)
            assert outside.max() < 0.010, f"{outside.max():.4f} m outside of the planner's model"


def _surface(radius: float, length: float) -> Array:
    """Points (N, 3) [m] on a cylinder about z."""
    around = np.linspace(0, 2 * np.pi, 24)
    rings = [
        np.stack([r * np.cos(around), r * np.sin(around), np.full(24, z)], axis=1)
        for z in np.linspace(-length / 2, length / 2, 9)
        for r in (radius, 0.5 * radius)
    ]
    return np.concatenate(rings)


def _origin(element: ET.Element | None) -> Array:
    assert element is not None
    xyz, rpy = ([float(v) for v in element.attrib[k].split()] for k in ("xyz", "rpy"))
    return pose(rot_z(rpy[2]) @ rot_y(rpy[1]) @ rot_x(rpy[0]), xyz)
