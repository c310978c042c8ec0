"""Runs a round in one process, without a wire: for tests and for timing the parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from cell.config import CellConfig, load
from cell.decision.io import Inputs, Outputs
from cell.decision.policy import PolicyTable
from cell.decision.supervisor import Supervisor
from cell.errors import RefusedError
from cell.limits import Limits
from cell.motion.planner import Planner
from cell.motion.views import InspectionViews
from cell.perception.detector import Detector
from cell.perception.look import OnionDetector
from cell.wire.types import Capture, GripperCommand, Reply, Trajectory
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
) -> tuple[SimBackend, Outputs]:
    """Sort one batch; returns the backend (still connected) and the last outputs.

    Args:
        watch: called after every tick. on_start: called with the renderer's class when all is built.
    """
    config = config or load()
    backend = SimBackend(config, seed, onions)
    backend.connect()
    supervisor = Supervisor(
        config, policy, Planner(config), InspectionViews(config), detector or Detector(), "test"
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
        elif isinstance(order, Capture):
            backend.request_frame(camera)
    except RefusedError as error:
        return Reply(False, error.code, error.reason)
    return Reply(True)
