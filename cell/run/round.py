"""One round from start to result."""

from __future__ import annotations

import itertools
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import NoReturn

import numpy as np

from cell.clock import perf_s
from cell.config import CellConfig
from cell.decision.belief import make_belief
from cell.decision.companion import Companion
from cell.decision.io import Inputs, Outputs
from cell.decision.policy import PolicyTable
from cell.decision.supervisor import Supervisor
from cell.errors import CellError
from cell.motion.planner import Planner
from cell.motion.reach import check_reachable
from cell.motion.views import InspectionViews
from cell.perception.detector import Detector
from cell.perception.person import PersonEye
from cell.record.hand_tap import HandTap
from cell.run.desk import Desk
from cell.run.link import Link, LiveLink, StepLink
from cell.run.measure import Meter
from cell.run.node_process import NodeProcess
from cell.run.recording import hand_tap, make_recorder, tapped
from cell.run.result import RoundResult, gesture_delay, judge, misplaced_by_human
from cell.run.tell import publish
from cell.version import code_version, commit
from cell.wire.session import Session
from cell.wire.types import Truth, TruthRequest
from cell.wire.vocabulary import Mode

HOLDER = "supervisor"
REAL_PERSON = "real"
_SETTLE_CYCLES = 25
_TRUTH_TIME = 6.0
"""The simulation may be drawing a picture when it is asked [s]."""
Watcher = Callable[[Inputs, Outputs], None]
"""Called after every tick; must be quick and must not raise."""
Judge = Callable[[Inputs, Outputs, Truth], None]
"""Called after every tick with the simulation's truth at that moment; for measuring only."""
After = Callable[[RoundResult, Link], None]
MakeCompanion = Callable[[CellConfig, Planner], Companion]
"""Makes what watches the person, in the place of the person camera and the configured belief."""


@dataclass(frozen=True)
class RoundOptions:
    """What to run.

    Attributes:
        backend: name of the node's backend.
        lock_step: simulated time moves only with the supervisor, as fast as the machine can.
        seed, onions: the batch.
        record: MCAP file to write, or None. record_lossless: with every pixel of the person camera.
        person: persona of the simulated person; "real" for a real one; empty for nobody.
        robot_ip, cameras: of the real arm; see `hil.backend.make_backend`.
    """

    backend: str = "sim"
    lock_step: bool = True
    seed: int = 0
    onions: int = 15
    record: Path | None = None
    record_lossless: bool = False
    person: str = ""
    robot_ip: str = ""
    cameras: str = ""

    @property
    def simulated(self) -> bool:
        """The surroundings are simulated: there is a truth to judge by."""
        return self.backend == "sim" or self.cameras == "sim"


def run_round(
    config: CellConfig,
    policy: PolicyTable,
    options: RoundOptions,
    watch: Watcher | None = None,
    judge_tick: Judge | None = None,
    make_companion: MakeCompanion | None = None,
    judge_every: int = 1,
    desk: Desk | None = None,
    after: After | None = None,
) -> RoundResult:
    """Start a node, sort one batch, judge it, and end everything that was started.

    Args:
        judge_every: ticks from one call of `judge_tick` to the next.
        desk: where an operator's orders arrive; made if None.
        after: called with the result while the node still serves.

    Raises:
        CellError: nothing could be run (bad configuration, port in use, missing weights, ...).
        KeyboardInterrupt: the user interrupted; the arm was stopped on its path first.
    """
    check_reachable(config)
    detector = Detector(Path(config.detector) if config.detector else None)
    with ExitStack() as stack:
        node = stack.enter_context(
            NodeProcess(
                config,
                backend=options.backend,
                lock_step=options.lock_step,
                seed=options.seed,
                onions=options.onions,
                person="" if options.person == REAL_PERSON else options.person,
                robot_ip=options.robot_ip,
                cameras=options.cameras,
            )
        )
        other = "" if make_companion is None else make_companion.__name__
        recorder = make_recorder(config, policy, options, HOLDER, other)
        if recorder is not None:
            stack.callback(recorder.close)
        # While the node builds its world, this process plans its inspection views.
        planner = Planner(config)
        views = InspectionViews(config)
        taps = options.record is not None and options.person and make_companion is None
        tap = hand_tap(config) if taps else None
        supervisor = Supervisor(
            config,
            policy,
            planner,
            views,
            detector,
            HOLDER,
            _companion(config, options, planner, make_companion, tap),
        )
        _warm_up(planner, detector, config)
        node.wait_ready()
        session = stack.enter_context(Session.connect(config, patient=options.lock_step))
        meter = Meter(session, config)
        if recorder is not None:
            recorder.begin()
            watch = tapped(recorder, tap, watch)
        link: Link = (StepLink if options.lock_step else LiveLink)(session, config, HOLDER)
        stack.callback(link.close)
        with _interruptible():
            if judge_tick is not None:
                watch = _with_truth(session, judge_tick, watch, judge_every)
            desk = desk or Desk(config)
            desk.open(session)
            result = _drive(config, supervisor, link, session, meter, options, policy, watch, desk)
            if after is not None:
                after(result, link)
            return result


def _with_truth(session: Session, judge_tick: Judge, watch: Watcher | None, every: int) -> Watcher:
    """A watcher that also asks for the truth."""
    ticks = itertools.count()

    def both(inputs: Inputs, outputs: Outputs) -> None:
        if watch is not None:
            watch(inputs, outputs)
        if next(ticks) % every:
            return
        truth = session.call(session.keys.sim_truth, TruthRequest(HOLDER), Truth, timeout=_TRUTH_TIME)
        judge_tick(inputs, outputs, truth)

    return both


def _companion(
    config: CellConfig,
    options: RoundOptions,
    planner: Planner,
    make: MakeCompanion | None,
    tap: HandTap | None,
) -> Companion | None:
    """What watches the person, if there is one."""
    if not options.person:
        return None
    if make is not None:
        return make(config, planner)
    return Companion(config, PersonEye(config, tap), make_belief(config.supervisor.belief), planner.collision)


def _drive(
    config: CellConfig,
    supervisor: Supervisor,
    link: Link,
    session: Session,
    meter: Meter,
    options: RoundOptions,
    policy: PolicyTable,
    watch: Watcher | None,
    desk: Desk,
) -> RoundResult:
    """The loop itself; stops the arm on its path whatever ends it early."""
    began, length = perf_s(), config.gripper.length
    try:
        inputs = link.exchange(())
        start = inputs.t
        while True:
            outputs = supervisor.tick(inputs)
            meter.note(inputs, outputs)
            publish(session, outputs, length)
            if watch is not None:
                watch(inputs, outputs)
            if outputs.done:
                break
            inputs = link.exchange(outputs.commands, supervisor.look)
            if orders := desk.take():
                inputs = replace(inputs, operator=orders)
    except (KeyboardInterrupt, CellError) as error:
        with suppress(CellError):  # the node itself may be gone; then it has stopped the arm
            link.stop("interrupted by the user" if isinstance(error, KeyboardInterrupt) else str(error))
        raise
    duration = inputs.t - start
    factor = duration / max(perf_s() - began, 1e-9)
    if options.simulated:
        for _ in range(_SETTLE_CYCLES):  # the last onion comes to rest before the round is judged
            inputs = link.exchange(())
    meter.wait_for(inputs.t)
    truth: Truth | None = None
    if options.simulated:
        truth = session.call(session.keys.sim_truth, TruthRequest(HOLDER), Truth, timeout=_TRUTH_TIME)
    by_human = outputs.state.by_human if truth is None else int(truth.by_human.sum())
    misplaced, dropped, misses = (None, None, ()) if truth is None else judge(truth)
    return RoundResult(
        backend=options.backend,
        policy=policy.name,
        seed=options.seed,
        person=options.person or "none",
        onions=options.onions,
        sorted=outputs.state.sorted + by_human,
        by_robot=outputs.state.sorted,
        by_human=None if truth is None else by_human,
        misplaced=misplaced,
        dropped=dropped,
        sort_time_s=round(duration, 6),
        mode_switches=meter.mode_switches,
        industrial_s=round(meter.time_in(Mode.INDUSTRIAL, inputs.t), 6),
        min_separation_m=meter.min_separation(),
        max_tcp_speed_m_s=meter.max_tcp_speed(),
        gesture_delay_s=None if truth is None else gesture_delay(truth),
        real_time_factor=round(factor, 3),
        commit=commit(),
        version=code_version(),
        failure=outputs.failure,
        arm_contacts=None if truth is None else truth.arm_contacts,
        joint_states_lost=meter.lost,
        joint_limits=meter.joint_limits(),
        sha256=meter.digests(),
        misses=misses,
        yields=outputs.state.yields,
        person_contacts=_person_contacts(truth),
        misplaced_by_human=None if truth is None else misplaced_by_human(truth),
    )


def _person_contacts(truth: Truth | None) -> int | None:
    if truth is None:
        return None
    return 0 if truth.person is None else truth.person.contacts


def _warm_up(planner: Planner, detector: Detector, config: CellConfig) -> None:
    """Do the first plan and the first detection now: later they would hold up the decision loop."""
    planner.prepare()
    home = np.array(config.arm.home)
    planner.plan_joints(home, home + 0.01, config.motion.collaborative_speed)
    camera = config.cameras["belt"]
    detector.detect(np.zeros((camera.height, camera.width, 3), np.uint8))


@contextmanager
def _interruptible() -> Iterator[None]:
    """SIGTERM ends a round like Ctrl-C does: arm stopped on its path, everything closed."""

    def interrupt(number: int, frame: FrameType | None) -> NoReturn:
        del number, frame
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
