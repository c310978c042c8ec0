"""The simulated backend: the PyBullet cell behind the same interface as the real one."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Callable

import numpy as np

from cell.cameras import camera_pinhole
from cell.config import CellConfig
from cell.errors import BackendError, one_of
from cell.wire.types import (
    ArmStatus,
    Array,
    BeltState,
    CameraInfo,
    Frame,
    GripperState,
    JointState,
    Truth,
)
from hil.sim.camera import Camera
from hil.sim.render.renderer import Image, Pending, Renderer, gl_problem, make_renderer
from hil.sim.world import World

_CONTACTS_KEPT = 20


class SimBackend:
    """`hil.backend.Backend` on PyBullet.

    Args:
        config: the cell.
        seed, onions: the first batch; see `reset`.
        person: persona of the simulated person; empty: nobody.
    """

    name = "sim"
    steppable = True

    def __init__(self, config: CellConfig, seed: int = 0, onions: int = 15, person: str = "") -> None:
        self._config = config
        self._first = (seed, onions)
        self._persona = person
        self._world: World | None = None
        self._renderer: Renderer | None = None
        self._cameras: dict[str, Camera] = {}
        self._batch = 0
        self._fingers_moving = False
        self._contacts: list[str] = []
        self._contact_ticks = 0
        self._undrawn: deque[Exposure] = deque()

    # -- life cycle -----------------------------------------------------------------------------

    def connect(self) -> None:
        if self._world is None:
            self.reset(*self._first)

    def reset(self, seed: int, onions: int) -> None:
        """Rebuild the world from `seed` with `onions` onions; simulated time restarts at 0."""
        self.close()
        choice = self._config.renderer
        if choice == "auto":
            choice = best_renderer()
        if choice == "tiny" and self._persona:
            raise BackendError(
                "the simulated person needs the gl renderer (renderer: gl): PyBullet's own cannot draw "
                "a body that moves; where EGL does not work, use --person none"
            )
        self._world = self._make_world(seed, onions, reference_visuals=choice == "tiny")
        self._renderer = make_renderer(choice, self._world.client, self._world.scene)
        self._cameras = {name: Camera(name, camera, seed) for name, camera in self._config.cameras.items()}
        for camera in self._cameras.values():  # the first image compiles shaders: not in the loop
            self._renderer.render(camera.X_WC, camera.pinhole, camera.near, camera.far)
        self._undrawn.clear()
        self._batch = 1
        self._fingers_moving = False
        self._contacts, self._contact_ticks = [], 0

    def _make_world(self, seed: int, onions: int, *, reference_visuals: bool) -> World:
        return World(self._config, seed, onions, reference_visuals=reference_visuals, person=self._persona)

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if self._world is not None:
            self._world.close()
            self._world = None

    # -- time and commands ------------------------------------------------------------------------

    @property
    def world(self) -> World:
        """The simulated world; raises `BackendError` before `connect`."""
        if self._world is None:
            raise BackendError("the simulation is not connected; call connect() first")
        return self._world

    def now(self) -> float:
        return self.world.time

    def command_joints(self, q: Array, qd: Array) -> None:
        self.world.arm.command(self.now() + self._config.arm.control_period, q, qd)

    def command_gripper(self, width: float, speed: float, force: float) -> tuple[float, float, float]:
        return self.world.gripper.command(width, speed, force)

    def command_light(self, signal: str) -> None:
        if signal != self.world.signal:
            self._draw_waiting()
        self.world.show(signal)

    def command_belt(self, onions: int, seed: int) -> None:
        del onions, seed
        raise BackendError("the simulated belt brings a new batch only by sim/reset")

    def advance(self) -> None:
        world = self.world
        self._fingers_moving = world.step()
        touched = world.forbidden_contacts()
        if touched:
            self._contact_ticks += 1
            if len(self._contacts) < _CONTACTS_KEPT:
                self._contacts.append(f"{world.time:.3f} s: robot touches {', '.join(touched)}")
        self._expose_due()

    def _expose_due(self) -> None:
        """Free-running cameras whose time has come expose."""
        world = self.world
        for camera in self._cameras.values():
            watched = camera.name != "person" or world.person is not None
            if watched and camera.wants_exposure(world.time):
                self._expose(camera)

    # -- measurements -----------------------------------------------------------------------------

    def read_joints(self) -> JointState:
        q, qd, effort = self.world.arm.measure()
        return JointState(self.now(), q, qd, effort)

    def read_status(self) -> ArmStatus:
        return ArmStatus(self.now())

    def read_gripper(self) -> GripperState:
        gripper = self.world.gripper
        width, _ = gripper.measure()
        return GripperState(self.now(), width, gripper.target, self._fingers_moving, gripper.holding)

    def read_belt(self) -> BeltState:
        return BeltState(self.now(), self._batch, moving=False, speed=0.0)

    def camera_info(self, camera: str) -> CameraInfo:
        p = camera_pinhole(self._camera(camera).config)
        return CameraInfo(self.now(), f"camera_{camera}", p.width, p.height, p.fx, p.fy, p.cx, p.cy)

    def request_frame(self, camera: str) -> None:
        self._expose(self._camera(camera))

    def work_ahead(self) -> bool:
        """Draw or develop one exposure ahead of its time; False when there is none."""
        if self._undrawn:
            self._undrawn.popleft().start()
            return True
        return any(camera.develop() for camera in self._cameras.values())

    def take_frames(self) -> list[Frame]:
        now = self.now()
        return [frame for camera in self._cameras.values() for frame in camera.due(now)]

    def truth(self) -> Truth:
        """Ground truth for judging the round; the supervisor never decides by it."""
        world = self.world
        count = len(world.onions)
        return Truth(
            t=self.now(),
            blemished=np.array([onion.blemished for onion in world.onions], dtype=bool),
            place=tuple(world.place_of(i) for i in range(count)),
            p_WO=np.array([world.onion_pose(i)[:3, 3] for i in range(count)]).reshape(count, 3),
            radius=np.array([onion.radius for onion in world.onions]),
            arm_contacts=self._contact_ticks,
            contact_log=tuple(self._contacts),
            by_human=np.array([world.by_human(i) for i in range(count)], dtype=bool),
            person=None if world.person is None else world.person.truth(),
        )

    # -- cameras ------------------------------------------------------------------------------------

    def _camera(self, name: str) -> Camera:
        if name not in self._cameras:
            raise BackendError(f"camera: {one_of(name, self._cameras)}")
        return self._cameras[name]

    def _expose(self, camera: Camera) -> None:
        """Take a frame. It is drawn when it is due, or earlier where `work_ahead` finds the time."""
        renderer, world = self._renderer, self.world
        assert renderer is not None
        moment, stance = renderer.moment(), world.stance()

        def draw() -> Pending:
            world.refresh(stance)
            return renderer.submit(camera.X_WC, camera.pinhole, camera.near, camera.far, moment)

        picture = Exposure(draw)
        if moment is None:
            picture.start()
        while self._undrawn and self._undrawn[0].started:
            self._undrawn.popleft()
        self._undrawn.append(picture)
        camera.expose(self.now(), picture)

    def _draw_waiting(self) -> None:
        """Draw what was exposed so far, before something changes that a moment does not keep."""
        while self._undrawn:
            self._undrawn.popleft().start()


class Exposure:
    """A picture that is drawn when somebody asks for it or finds the time.

    Args:
        draw: draws the scene as it was at the exposure.
    """

    def __init__(self, draw: Callable[[], Pending]) -> None:
        self._draw: Callable[[], Pending] | None = draw
        self._drawn: Pending | None = None

    @property
    def started(self) -> bool:
        """It is being drawn, or is done."""
        return self._draw is None

    def start(self) -> None:
        """Begin to draw, once."""
        if self._draw is not None:
            draw, self._draw = self._draw, None
            self._drawn = draw()

    def image(self) -> Image:
        self.start()
        assert self._drawn is not None
        return self._drawn.image()


def best_renderer() -> str:
    """ "gl" where an EGL context can be made, else "tiny", with a warning that says why."""
    problem = gl_problem()
    if not problem:
        return "gl"
    warnings.warn(f"{problem} Using PyBullet's TinyRenderer, which is slower.", stacklevel=2)
    return "tiny"
