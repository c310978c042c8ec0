"""Runs a round in one process, without a wire: for tests and for timing the parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from cell.config import CellConfig, load
from cell.decision.belief import make_belief
from cell.decision.companion import Companion
from cell.decision.io import Inputs, Outputs
from cell.decision.policy import PolicyTable
from cell.decision.supervisor import Supervisor
from cell.errors import RefusedError
from cell.limits import Limits
from cell.motion.planner import Planner
from cell.motion.views import InspectionViews
from cell.perception.detector import Detector
from cell.perception.look import OnionDetector
from cell.perception.person import PersonEye
from cell.wire.types import Capture, GripperCommand, LightCommand, Reply, Trajectory
from hil.executor import Executor
from hil.sim.backend import SimBackend

Watch = Callable[[SimBackend, Inputs, Outputs], None]


def drive(
    seed: int,
    onions: int,
    policy: PolicyTable,
    *,
    config: CellConfig | None = None,
    detector: OnionDetector | None = None,
    watch: Watch | None = None,
    on_start: Callable[[type], None] | None = None,
    person: str = "",
) -> tuple[SimBackend, Outputs]:
    """Sort one batch; returns the backend (still connected) and the last outputs.

    Args:
        watch: called after every tick. on_start: called with the renderer's class when all is built.
        person: persona of who works beside the robot; empty: nobody.
    """
    config = config or load()
    backend = SimBackend(config, seed, onions, person)
    backend.connect()
    planner, companion = Planner(config), None
    if person:
        belief = make_belief(config.supervisor.belief)
        companion = Companion(config, PersonEye(config), belief, planner.collision)
    supervisor = Supervisor(
        config, policy, planner, InspectionViews(config), detector or Detector(), "test", companion
    )
    executor = Executor(Limits.from_config(config), config.arm.control_period, backend.read_joints().q)
    if on_start is not None:
        on_start(type(backend._renderer))
    replies: tuple[tuple[int, Reply], ...] = ()
    while True:
        status = replace(
            backend.read_status(),
            trajectory_id=executor.trajectory_id,
            moving=executor.moving,
            stopped=executor.stopped,
            stop_reason=executor.stop_reason,
        )
        inputs = Inputs(
            backend.now(),
            backend.read_joints(),
            status,
            backend.read_gripper(),
            backend.read_belt(),
            tuple(backend.take_frames()),
            replies,
        )
        outputs = supervisor.tick(inputs)
        if watch is not None:
            watch(backend, inputs, outputs)
        if outputs.done:
            return backend, outputs
        replies = tuple((c.ticket, _obey(backend, executor, c.order, c.camera)) for c in outputs.commands)
        for _ in range(config.supervisor.ticks_per_cycle):
            q, qd = executor.tick(backend.now())
            backend.command_joints(q, qd)
            backend.advance()


def _obey(backend: SimBackend, executor: Executor, order: object, camera: str) -> Reply:
    try:
        if isinstance(order, Trajectory):
            executor.accept(order, backend.now(), backend.read_joints().q)
        elif isinstance(order, GripperCommand):
            backend.command_gripper(order.width, order.speed, order.force)
        elif isinstance(order, LightCommand):
            backend.command_light(order.signal)
        elif isinstance(order, Capture):
            backend.request_frame(camera)
    except RefusedError as error:
        return Reply(False, error.code, error.reason)
    return Reply(True)
