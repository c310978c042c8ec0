"""The simulated cell: bodies in PyBullet, and the same bodies as a scene for the renderer."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import urdf
from cell.config import CellConfig
from cell.errors import ConfigError
from cell.frames import Array, from_quaternion, pose, quaternion
from cell.settings import BinConfig
from hil.sim.arm import SimArm
from hil.sim.board import add_board
from hil.sim.fixtures import fixtures
from hil.sim.gripper import SimGripper
from hil.sim.light import ModeLight
from hil.sim.onions import Onion, make_onion, onion_body
from hil.sim.physics import bullet, connect, quiet
from hil.sim.render.mesh import box_mesh, cylinder_mesh
from hil.sim.render.scene import Scene, Visual, add_urdf_visuals

if TYPE_CHECKING:
    from hil.sim.person.presence import Presence
    from hil.sim.person.stance import Stance

LABELS = {"robot": 1, "belt": 2, "bin": 3, "post": 4, "floor": 5, "pedestal": 6, "person": 7, "light": 8}
"""Labels of the scene's parts; onion number i has label `ONION_LABEL + i`."""
ONION_LABEL = 100

_SETTLE = 1.0
"""Time for dropped onions to come to rest before the round starts [s]."""


class World:
    """One cell with one batch of onions, a pure function of (config, seed, onions, commands).

    Args:
        config: the cell.
        seed: of the onions' shapes, skins, blemishes and places.
        onions: how many lie on the belt.
        reference_visuals: also give PyBullet textured meshes, which its TinyRenderer needs
            and which cost about half a second.
        person: name of the persona of the person who works here; empty: nobody.

    Attributes:
        person: the person, None where there is nobody.
        signal: what the mode light shows.
    """

    def __init__(
        self, config: CellConfig, seed: int, onions: int, *, reference_visuals: bool = False, person: str = ""
    ) -> None:
        self.config = config
        self.time_step = config.arm.control_period / config.arm.physics_substeps
        self.client = connect(self.time_step)
        self.scene = Scene()
        self.fixed: dict[int, str] = {}
        self.onions: list[Onion] = []
        self.onion_bodies: list[int] = []
        self._reference = reference_visuals
        self._substep = 0
        for fixture in fixtures(config):
            self._add_fixture(fixture.group, fixture.X_WF, fixture.size, fixture.rgba)
        self.robot, self.joints = self._add_robot()
        self.arm = SimArm(
            self.client, self.robot, self.joints, config.arm.lag, self.time_step, np.array(config.arm.home)
        )
        self.gripper = SimGripper(self.client, self.robot, self.joints, config.gripper)
        self._rng = np.random.default_rng([seed, 0x0410])
        self._add_batch(onions)
        if config.board.mounted:
            add_board(self.scene, config.board, self.robot, self.tcp_link)
        self._light = ModeLight(self.scene, config, self._anchor, self._X_WA)
        self.person: Presence | None = None
        if person:
            from hil.sim.person.presence import Presence

            self.person = Presence(self, person, seed, self._anchor, self._X_WA)

    # -- what the backend calls ---------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated time since the round began [s]."""
        return self._substep * self.time_step

    def step(self) -> bool:
        """Advance one control period; True while the gripper's fingers move."""
        moving = self.gripper.drive(self.config.arm.control_period)
        for _ in range(self.config.arm.physics_substeps):
            self.substep()
        if self.person is not None:
            self.person.step(self.signal)
        return moving

    def substep(self) -> None:
        """Advance arm and bodies by one physics step."""
        self.arm.follow(self.time + self.time_step)
        bullet.stepSimulation(physicsClientId=self.client)
        self._substep += 1

    @property
    def signal(self) -> str:
        """What the mode light shows, one of `vocabulary.SIGNALS`."""
        return self._light.signal

    def show(self, signal: str) -> None:
        """Set the mode light."""
        self._light.show(signal)

    def stance(self) -> Stance | None:
        """How the person stands now, for `refresh` later."""
        return None if self.person is None else self.person.stance()

    def refresh(self, stance: Stance | None = None) -> None:
        """Bring the scene up to date with the person, now or as in `stance`, before it is drawn."""
        if self.person is not None:
            self.person.refresh(stance)

    def close(self) -> None:
        """Free the physics client; harmless when repeated."""
        if self.client >= 0:
            bullet.disconnect(physicsClientId=self.client)
            self.client = -1

    # -- ground truth: for judging and for tests, never for deciding ----------------------------

    def onion_pose(self, index: int) -> Array:
        """X_WO of an onion, shape (4, 4)."""
        p, q = bullet.getBasePositionAndOrientation(self.onion_bodies[index], physicsClientId=self.client)
        return pose(from_quaternion(q), p)

    def set_onion_pose(self, index: int, X_WO: Array) -> None:
        """Put an onion somewhere at rest (for training images and tests)."""
        bullet.resetBasePositionAndOrientation(
            self.onion_bodies[index], X_WO[:3, 3].tolist(), quaternion(X_WO[:3, :3]).tolist(),
            physicsClientId=self.client,
        )  # fmt: skip

    def place_of(self, index: int) -> str:
        """Where an onion is: "belt", "bin", "held" (in the air) or "floor"."""
        (x, y, z), _ = bullet.getBasePositionAndOrientation(
            self.onion_bodies[index], physicsClientId=self.client
        )
        if self.person is not None and self.person.agent.held == index:
            return "held"
        if any(_inside(b, x, y, z) for b in (self.config.bin, self.config.person.bin)):
            return "bin"
        b = self.config.belt
        over_belt = b.x[0] <= x <= b.x[1] and b.y[0] <= y <= b.y[1]
        if over_belt and b.top_z < z < b.top_z + 0.06:
            return "belt"
        return "held" if z > b.top_z - 0.05 else "floor"

    def by_human(self, index: int) -> bool:
        """The person has sorted this onion."""
        return self.person is not None and self.person.sorted_by_human(index)

    def forbidden_contacts(self) -> list[str]:
        """Names of fixed parts that the robot touches now (its pedestal excepted)."""
        touched = []
        for body, group in self.fixed.items():
            if group == "pedestal":
                continue
            points = bullet.getContactPoints(self.robot, body, physicsClientId=self.client)
            if any(point[8] < 0.0 for point in points):
                touched.append(group)
        return touched

    # -- building -------------------------------------------------------------------------------

    def _add_fixture(
        self, group: str, X_WF: Array, size: tuple[float, ...], rgba: tuple[float, float, float, float]
    ) -> None:
        c = self.client
        if len(size) == 3:
            half = [v / 2 for v in size]
            shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half, physicsClientId=c)
            visual = bullet.createVisualShape(
                bullet.GEOM_BOX, halfExtents=half, rgbaColor=rgba, physicsClientId=c
            )
            mesh = box_mesh(size)
        else:
            radius, length = size
            shape = bullet.createCollisionShape(
                bullet.GEOM_CYLINDER, radius=radius, height=length, physicsClientId=c
            )
            visual = bullet.createVisualShape(
                bullet.GEOM_CYLINDER, radius=radius, length=length, rgbaColor=rgba, physicsClientId=c
            )
            mesh = cylinder_mesh(radius, length)
        body = bullet.createMultiBody(
            0, shape, visual, X_WF[:3, 3].tolist(), quaternion(X_WF[:3, :3]).tolist(), physicsClientId=c
        )
        bullet.changeDynamics(body, -1, lateralFriction=0.8, rollingFriction=0.01, physicsClientId=c)
        self.fixed[body] = group
        if group == "floor":
            self._anchor, self._X_WA = body, X_WF
        self.scene.add(
            Visual(
                body=body, link=-1, X_LV=np.eye(4), mesh=mesh, rgba=rgba, texture=None, label=LABELS[group]
            )
        )

    def _add_robot(self) -> tuple[int, dict[str, int]]:
        c = self.client
        text = urdf.robot_description(with_meshes=True)
        bare = text if self._reference else urdf.robot_description(with_meshes=False)
        with tempfile.TemporaryDirectory() as folder, quiet():
            file = Path(folder) / "robot.urdf"
            file.write_text(bare)
            body = bullet.loadURDF(
                str(file), useFixedBase=True, flags=bullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=c
            )
        joints = {}
        for index in range(bullet.getNumJoints(body, physicsClientId=c)):
            info = bullet.getJointInfo(body, index, physicsClientId=c)
            joints[info[1].decode()] = index
            if info[12].decode() == "tcp":
                self.tcp_link = index
            if info[12].decode() in ("base", "flange", "tool0", "tcp"):
                # PyBullet gives links without inertia 1 kg; these are frames, not bodies.
                bullet.changeDynamics(
                    body, index, mass=1e-5, localInertiaDiagonal=[1e-9] * 3, physicsClientId=c
                )
            bullet.changeDynamics(
                body, index, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=c
            )
        add_urdf_visuals(self.scene, text, body, c, LABELS["robot"], urdf.resolve)
        return body, joints

    def _add_batch(self, count: int) -> None:
        """Drop `count` onions onto the belt at random, apart, and let them come to rest."""
        for index, p_WO in enumerate(self._places(count)):
            onion = make_onion(self._rng, self.config.onions, index)
            self.onions.append(onion)
            self.onion_bodies.append(self._add_onion(index, onion))
            R_WO = from_quaternion(_random_quaternion(self._rng))
            self.set_onion_pose(index, pose(R_WO, [*p_WO, self.config.belt.top_z + onion.radius + 0.002]))
        for _ in range(round(_SETTLE / self.time_step)):
            bullet.stepSimulation(physicsClientId=self.client)

    def _places(self, count: int) -> list[Array]:
        """Random places in the pick window at least `onions.spacing` apart, shape (2,) each [m].

        Where a batch is so large that chance does not find room, the spacing gives way by up to a
        tenth, as long as the largest onions stay apart.
        """
        if not count:
            return []
        b, config = self.config.belt, self.config.onions
        lo, hi = np.array([b.pick_x[0], b.pick_y[0]]), np.array([b.pick_x[1], b.pick_y[1]])
        spacing, least = config.spacing, max(0.9 * config.spacing, 1.02 * config.diameter[1])
        while True:
            for _ in range(200):
                chosen: list[Array] = []
                for _ in range(400):
                    p = self._rng.uniform(lo, hi)
                    if all(np.linalg.norm(p - other) >= spacing for other in chosen):
                        chosen.append(p)
                    if len(chosen) == count:
                        return chosen
            if spacing <= least:
                raise ConfigError(
                    f"{count} onions do not fit into the pick window with a spacing of {least:.3f} m; "
                    "ask for fewer onions, or change belt.pick_x, belt.pick_y or onions.spacing"
                )
            spacing = max(least, 0.98 * spacing)

    def _add_onion(self, index: int, onion: Onion) -> int:
        visual = self._reference_visual(onion) if self._reference else -1
        body = onion_body(self.client, onion.mass, onion.collision_radius, visual)
        if self._reference:
            self._reference_texture(body, onion)
        self.scene.add(
            Visual(
                body=body, link=-1, X_LV=np.eye(4), mesh=onion.mesh, rgba=(1.0, 1.0, 1.0, 1.0),
                texture=onion.texture, label=ONION_LABEL + index,
            )
        )  # fmt: skip
        return body

    def _reference_visual(self, onion: Onion) -> int:
        mesh = onion.mesh
        assert mesh.uv is not None
        shape: int = bullet.createVisualShape(
            bullet.GEOM_MESH, vertices=mesh.vertices.tolist(), indices=mesh.faces.ravel().tolist(),
            normals=mesh.normals.tolist(), uvs=mesh.uv.tolist(), rgbaColor=[1, 1, 1, 1],
            physicsClientId=self.client,
        )  # fmt: skip
        return shape

    def _reference_texture(self, body: int, onion: Onion) -> None:
        import cv2

        with tempfile.TemporaryDirectory() as folder:
            file = os.path.join(folder, "skin.png")
            cv2.imwrite(file, np.ascontiguousarray(onion.texture[:, :, 2::-1]))
            texture = bullet.loadTexture(file, physicsClientId=self.client)
        bullet.changeVisualShape(body, -1, textureUniqueId=texture, physicsClientId=self.client)


def _inside(bin: BinConfig, x: float, y: float, z: float) -> bool:
    """Whether the centre of an onion at (x, y, z) [m] is in a bin, or on the pile that fills it."""
    (cx, cy, top), (sx, sy, depth) = bin.center, bin.size
    return abs(x - cx) <= sx / 2 and abs(y - cy) <= sy / 2 and top - depth - 0.02 < z < top + 0.03


def _random_quaternion(rng: np.random.Generator) -> Array:
    """Uniform over rotations, (x, y, z, w)."""
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


__all__ = ["LABELS", "ONION_LABEL", "World"]
