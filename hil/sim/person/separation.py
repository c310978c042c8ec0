"""How far the person's body is from the robot: truth for judging, from skin to collision shapes.

The robot is what collides in PyBullet: boxes and cylinders on its links, and the onion that the
gripper holds. The person is the vertices of the skin, which lie so close that the surface between
them is at most a few millimetres nearer.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import urdf
from cell.errors import BackendError
from cell.frames import Array
from hil.sim.physics import bullet
from hil.sim.render.bodies import LinkPoses
from hil.sim.render.scene import link_indices, origin

_COARSE = 16
"""Every so many vertices give a first bound of the distance."""

Points = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Solid:
    """A box or an upright cylinder on a link.

    Attributes:
        link: of PyBullet, -1 the base. X_LS: pose in the link's URDF frame, shape (4, 4).
        half: box: half lengths (3,); cylinder: radius, radius, half length [m]. round: a cylinder.
    """

    link: int
    X_LS: Array
    half: Array
    round: bool

    def distance(self, p_S: Points) -> Points:
        """Of points (N, 3) in the solid's frame from its surface (N,) [m], negative inside."""
        if self.round:
            across = np.hypot(p_S[:, 0], p_S[:, 1]) - self.half[0]
            outside = np.stack([across, np.abs(p_S[:, 2]) - self.half[2]], axis=1)
        else:
            outside = np.abs(p_S) - self.half
        out: Points = np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0)
        return out


class RobotShape:
    """The robot's collision shapes where its links are now.

    Args:
        client, body: of PyBullet. Raises `BackendError` for a shape that is neither box nor cylinder.
    """

    def __init__(self, client: int, body: int) -> None:
        self._body, self._links = body, LinkPoses(client)
        robot = ET.fromstring(urdf.robot_description(with_meshes=False))
        self.solids = _solids(robot, link_indices(body, client))
        self._client = client
        self._moving = sorted({solid.link for solid in self.solids if solid.link >= 0})
        self._radii = np.array([np.linalg.norm(solid.half) for solid in self.solids])

    def poses(self) -> list[Array]:
        """X_WS of each solid, shape (4, 4)."""
        X_WL = self._links.read(dict.fromkeys((self._body, solid.link) for solid in self.solids))
        return [X_WL[self._body, solid.link] @ solid.X_LS for solid in self.solids]

    def ahead(self) -> float:
        """x [m] of the foremost link's origin."""
        states = bullet.getLinkStates(
            self._body, self._moving, computeForwardKinematics=1, physicsClientId=self._client
        )
        return max(float(state[4][0]) for state in states)

    def distance(self, p_W: Points, spheres: tuple[tuple[Array, float], ...] = ()) -> float:
        """Least distance [m] of points (N, 3) from the robot and from spheres (centre, radius) it holds.

        Negative when a point is inside.
        """
        poses = self.poses()
        least = min(
            [float(np.linalg.norm(p_W - c, axis=1).min()) - r for c, r in spheres], default=float("inf")
        )
        least = min(least, self._least(p_W[::_COARSE], poses, least))
        return min(least, self._least(p_W, poses, least))

    def _least(self, p_W: Points, poses: list[Array], bound: float) -> float:
        """Least distance, at most `bound`: points that cannot be nearer are left out."""
        for solid, X_WS, radius in zip(self.solids, poses, self._radii, strict=True):
            away = p_W - X_WS[:3, 3]
            near = np.einsum("ij,ij->i", away, away) < max(bound + radius, 0.0) ** 2
            if near.any():
                bound = min(bound, float(solid.distance(away[near] @ X_WS[:3, :3]).min()))
        return bound


def _solids(robot: ET.Element, links: dict[str, int]) -> list[Solid]:
    """PyBullet itself keeps cylinders as meshes, so the shapes are read from the URDF."""
    return [
        _solid(links[link.get("name", "")], collision)
        for link in robot.findall("link")
        for collision in link.findall("collision")
    ]


def _solid(link: int, collision: ET.Element) -> Solid:
    X_LS = origin(collision.find("origin"))
    if (box := collision.find("geometry/box")) is not None:
        return Solid(link, X_LS, np.array([float(v) / 2 for v in box.get("size", "").split()]), False)
    if (tube := collision.find("geometry/cylinder")) is not None:
        radius, length = float(tube.get("radius", "")), float(tube.get("length", ""))
        return Solid(link, X_LS, np.array([radius, radius, length / 2]), True)
    raise BackendError("the robot's URDF has a collision shape that is neither a box nor a cylinder")
