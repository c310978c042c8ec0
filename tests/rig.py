"""A cell in one process: the supervisor against the simulated backend, without wire or detector.

`TruthDetector` knows where the onions are, so these tests do not depend on how well the trained
detector sees. It stands in tests only; the product never looks at the truth to decide.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from cell.config import CellConfig, load
from cell.decision import policy
from cell.decision.io import Command, Inputs, Outputs
from cell.decision.supervisor import Supervisor
from cell.errors import RefusedError
from cell.frames import Array, Pinhole, look_at
from cell.limits import Limits, tcp_positions
from cell.motion.planner import Planner
from cell.motion.views import InspectionViews
from cell.wire.types import Box, Capture, GripperCommand, LightCommand, Reply, Trajectory
from hil.executor import Executor
from hil.sim.backend import SimBackend

CROP = 192


@cache
def reference() -> CellConfig:
    return load()


@cache
def motion() -> tuple[Planner, InspectionViews]:
    """Planner and views of the reference cell; neither keeps anything between motions."""
    return Planner(reference()), InspectionViews(reference())


def supervisor(detector: object, policy_name: str = "expert") -> Supervisor:
    """A fresh supervisor of the reference cell."""
    return Supervisor(reference(), policy.load(policy_name), *motion(), detector, "test")  # type: ignore[arg-type]


class TruthDetector:
    """Boxes round the onions' true outlines; blemished where a blemish faces the camera.

    Whole images show every onion on the belt, square crops the one in the hand.
    """

    def __init__(self, backend: SimBackend) -> None:
        camera = reference().cameras["belt"]
        self._backend = backend
        self._pinhole = Pinhole.from_hfov(camera.width, camera.height, camera.hfov)
        self._X_WC = look_at(camera.position, camera.target)
        self.log: list[tuple[tuple[Box, float], ...]] = []
        self.blind_to_held = False

    def detect(self, rgb: np.ndarray) -> tuple[tuple[Box, float], ...]:
        height, width = rgb.shape[:2]
        if (height, width) == (CROP, CROP):
            found = () if self.blind_to_held else self._in_hand()
        else:
            found = tuple(
                self._seen(i, 0, 0)
                for i in range(len(self._backend.world.onions))
                if self._backend.world.place_of(i) == "belt"
            )
        self.log.append(found)
        return found

    def _in_hand(self) -> tuple[tuple[Box, float], ...]:
        q = self._backend.read_joints().q
        p_WT = tcp_positions(q[None], reference().gripper.length)[0]
        world = self._backend.world
        for i in range(len(world.onions)):
            if np.linalg.norm(world.onion_pose(i)[:3, 3] - p_WT) < 0.05:
                u, v = self._pinhole.project(self._to_camera(p_WT[None]))[0]
                x0 = int(np.clip(u - CROP / 2, 0, self._pinhole.width - CROP))
                y0 = int(np.clip(v - CROP / 2, 0, self._pinhole.height - CROP))
                return (self._seen(i, x0, y0),)
        return ()

    def _seen(self, index: int, x0: int, y0: int) -> tuple[Box, float]:
        onion, X_WO = self._backend.world.onions[index], self._backend.world.onion_pose(index)
        points_W = onion.mesh.vertices @ X_WO[:3, :3].T + X_WO[:3, 3]
        uv = self._pinhole.project(self._to_camera(points_W)) - (x0, y0)
        to_camera = self._X_WC[:3, 3] - X_WO[:3, 3]
        to_camera /= np.linalg.norm(to_camera)
        facing = [float(to_camera @ X_WO[:3, :3] @ np.array(d)) > 0.4 for d, _ in onion.blemishes]
        p = 1.0 if any(facing) else 0.0
        (left, top), (right, bottom) = uv.min(axis=0), uv.max(axis=0)
        label = "blemished" if p else "unblemished"
        return Box((float(left), float(top), float(right), float(bottom)), label, 0.9), p

    def _to_camera(self, p_W: Array) -> Array:
        out: Array = (p_W - self._X_WC[:3, 3]) @ self._X_WC[:3, :3]
        return out


class Replayed:
    """Says again what a `TruthDetector` said, in the same order."""

    def __init__(self, log: list[tuple[tuple[Box, float], ...]]) -> None:
        self._log = iter(log)

    def detect(self, rgb: np.ndarray) -> tuple[tuple[Box, float], ...]:
        del rgb
        return next(self._log)


class Rig:
    """One running cell.

    Attributes:
        refuse: answers a command instead of the executor when it returns a reply.
        inputs, outputs: everything that went into and came out of the supervisor.
    """

    def __init__(self, seed: int, onions: int, policy_name: str = "expert") -> None:
        self.config = reference()
        self.backend = SimBackend(self.config, seed, onions)
        self.backend.connect()
        self.detector = TruthDetector(self.backend)
        self.supervisor = supervisor(self.detector, policy_name)
        self.executor = Executor(
            Limits.from_config(self.config), self.config.arm.control_period, self.backend.read_joints().q
        )
        self.refuse: Callable[[Command], Reply | None] = lambda command: None
        self.inputs: list[Inputs] = []
        self.outputs: list[Outputs] = []
        self._replies: tuple[tuple[int, Reply], ...] = ()

    @property
    def texts(self) -> list[str]:
        """What the supervisor said."""
        return [event.text for outputs in self.outputs for event in outputs.events]

    def step(self) -> Outputs:
        """One supervisor tick and the control periods that follow it."""
        backend, executor = self.backend, self.executor
        status = replace(
            backend.read_status(),
            trajectory_id=executor.trajectory_id,
            progress=executor.progress,
            moving=executor.moving,
            stopped=executor.stopped or bool(executor.stop_reason),
            stop_reason=executor.stop_reason,
        )
        inputs = Inputs(
            backend.now(),
            backend.read_joints(),
            status,
            backend.read_gripper(),
            backend.read_belt(),
            tuple(backend.take_frames()),
            self._replies,
        )
        outputs = self.supervisor.tick(inputs)
        self.inputs.append(inputs)
        self.outputs.append(outputs)
        self._replies = tuple((c.ticket, self._obey(c)) for c in outputs.commands)
        for _ in range(self.config.supervisor.ticks_per_cycle):
            q, qd = executor.tick(backend.now())
            backend.command_joints(q, qd)
            backend.advance()
        return outputs

    def run(self, before: Callable[[], None] = lambda: None, limit: float = 120.0) -> Outputs:
        """Step until the round is over, calling `before` ahead of every tick."""
        while True:
            before()
            outputs = self.step()
            if outputs.done:
                return outputs
            assert self.backend.now() < limit, f"not done after {limit} s: {self.texts[-8:]}"

    def _obey(self, command: Command) -> Reply:
        reply = self.refuse(command)
        if reply is not None:
            return reply
        order = command.order
        try:
            if isinstance(order, Trajectory):
                self.executor.accept(order, self.backend.now(), self.backend.read_joints().q)
            elif isinstance(order, GripperCommand):
                self.backend.command_gripper(order.width, order.speed, order.force)
            elif isinstance(order, LightCommand):
                self.backend.command_light(order.signal)
            elif isinstance(order, Capture):
                self.backend.request_frame(command.camera)
        except RefusedError as error:
            return Reply(False, error.code, error.reason)
        return Reply(True)
