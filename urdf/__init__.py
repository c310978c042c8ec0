"""Descriptions of the machines in the cell: URDFs, the reference cell and its sources.

`SOURCES.md` beside this file says where each number comes from.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""The arm's joints from base to flange, in the order of every joint array."""

FINGER_JOINT_NAMES = ("left_finger_joint", "right_finger_joint")


def path(name: str) -> Path:
    """Path of a file in this package, e.g. `path("ur3e.urdf")`."""
    return Path(str(files(__name__) / name))


def resolve(uri: str) -> Path:
    """`package://<python package>/<path>` -> file path; other names are returned as paths.

    Raises:
        FileNotFoundError: the package is not installed or lacks the file; says which.
    """
    if not uri.startswith("package://"):
        return Path(uri)
    package, _, rest = uri.removeprefix("package://").partition("/")
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise FileNotFoundError(f"{uri}: the Python package '{package}' is not installed")
    found = Path(next(iter(spec.submodule_search_locations))) / rest
    if not found.is_file():
        raise FileNotFoundError(f"{uri}: no such file in the Python package '{package}'")
    return found


def robot_description(with_meshes: bool = True, absolute: bool = True) -> str:
    """The arm with its gripper as one URDF text; the gripper hangs on `tool0`.

    Args:
        with_meshes: keep mesh visuals (else only primitives remain).
        absolute: turn `package://` mesh names into absolute file paths.
    """
    robot = ET.parse(path("ur3e.urdf")).getroot()
    robot.set("name", "ur3e_2f85")
    robot.extend(ET.parse(path("gripper.urdf")).getroot())
    mount = ET.SubElement(robot, "joint", name="tool0-gripper_base", type="fixed")
    ET.SubElement(mount, "parent", link="tool0")
    ET.SubElement(mount, "child", link="gripper_base")
    ET.SubElement(mount, "origin", xyz="0 0 0", rpy="0 0 0")
    for link in robot.iter("link"):
        for visual in list(link.findall("visual")):
            mesh = visual.find("geometry/mesh")
            if mesh is None:
                continue
            if not with_meshes:
                link.remove(visual)
            elif absolute:
                mesh.set("filename", str(resolve(mesh.get("filename", ""))))
    return ET.tostring(robot, encoding="unicode")
