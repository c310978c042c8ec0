"""Where PyBullet's links are, in the frames URDF visuals are written in."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cell.frames import Array, from_quaternion, inverse, pose
from hil.sim.physics import bullet


class LinkPoses:
    """Reads poses X_WL of links of a PyBullet client.

    PyBullet reports a base's INERTIAL frame; the offset to its URDF frame is read once per body.
    """

    def __init__(self, client: int) -> None:
        self._client = client
        self._X_IB: dict[int, Array] = {}

    def forget(self) -> None:
        """Call when bodies may have been removed: PyBullet could hand out their ids again."""
        self._X_IB.clear()

    def read(self, keys: Iterable[tuple[int, int]]) -> dict[tuple[int, int], Array]:
        """(body, link) -> X_WL, shape (4, 4); link -1 is the base."""
        wanted: dict[int, list[int]] = {}
        for body, link in keys:
            wanted.setdefault(body, []).append(link)
        poses: dict[tuple[int, int], Array] = {}
        for body, links in wanted.items():
            if -1 in links:
                poses[body, -1] = self._base(body)
            joints = [link for link in links if link >= 0]
            if joints:
                states = bullet.getLinkStates(
                    body, joints, computeForwardKinematics=1, physicsClientId=self._client
                )
                for link, state in zip(joints, states, strict=True):
                    poses[body, link] = pose(from_quaternion(state[5]), state[4])
        return poses

    def _base(self, body: int) -> Array:
        p, q = bullet.getBasePositionAndOrientation(body, physicsClientId=self._client)
        X_WI = pose(from_quaternion(q), p)
        if body not in self._X_IB:
            info = bullet.getDynamicsInfo(body, -1, physicsClientId=self._client)
            self._X_IB[body] = inverse(pose(from_quaternion(info[4]), info[3]))
        return np.asarray(X_WI @ self._X_IB[body])
