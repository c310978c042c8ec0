"""The node over the wire: lease, expiry, refusals, stops, lock-step and real time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cell.clock import WallClock, perf_s
from cell.config import CellConfig, load
from cell.errors import BackendError, CellError, WireError
from cell.run.link import Heart
from cell.wire import types as T
from cell.wire.session import Session
from hil.lease import Lease
from hil.node import Node
from tests.fake_backend import FakeBackend
from tests.test_executor import LIMITS, PERIOD, smooth
from tests.wire_helpers import own_port, pause, until


class Cell:
    """A node with the kinematic backend in a thread, and a client."""

    def __init__(self, *, lock_step: bool, steppable: bool = True) -> None:
        self.config: CellConfig = own_port()
        self.backend = FakeBackend(self.config, steppable=steppable)
        self.backend.connect()
        self.server = Session.listen(self.config, patient=lock_step)
        self.node = Node(self.config, self.backend, self.server, lock_step=lock_step)
        self.failure = ""
        self.client = Session.connect(self.config, patient=lock_step)
        self.keys = self.client.keys
        self.arm = self.client.latest(self.keys.arm_status, T.ArmStatus)
        self.joints = self.client.latest(self.keys.joint_states, T.JointState)
        self.events = self.client.latest(self.keys.events, T.Event)
        pause(0.1)  # the subscriptions reach the node
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        try:
            self.node.run()
        except CellError as error:
            self.failure = str(error)

    def close(self) -> None:
        self.node.end()
        self.thread.join(10.0)
        self.client.close()
        self.server.close()
        assert not self.thread.is_alive()

    def call(self, key: str, request: Any) -> T.Reply:
        return self.client.call(key, request, T.Reply, timeout=5.0)

    def step(self, ticks: int = 1, holder: str = "sup") -> T.StepReply:
        return self.client.call(self.keys.sim_step, T.StepRequest(holder, ticks), T.StepReply, timeout=10.0)

    def run_to(self, done: Callable[[T.ArmStatus], bool], limit: int = 1000) -> list[T.JointState]:
        """Single steps until the status says so."""
        seen = []
        for _ in range(limit):
            reply = self.step()
            seen.append(reply.joint_state)
            if done(reply.arm_status):
                return seen
        raise AssertionError(f"not after {limit} steps: {reply.arm_status}")

    def status(self, seconds: float = 3.0, **wanted: Any) -> T.ArmStatus:
        """The arm's status, once it has these values."""

        def there() -> bool:
            status = self.arm.peek()
            return status is not None and all(getattr(status, k) == v for k, v in wanted.items())

        until(there, seconds)
        status = self.arm.peek()
        assert status is not None
        return status

    def order(self, seed: int = 1, number: int = 1, holder: str = "sup") -> T.Trajectory:
        return replace(smooth(seed, number=number), holder=holder, expires=60.0)

    def said(self) -> list[str]:
        return [event.text for event in self.events.take_all()]


@pytest.fixture
def stepped() -> Iterator[Cell]:
    cell = Cell(lock_step=True)
    yield cell
    cell.close()


@pytest.fixture
def live() -> Iterator[Cell]:
    cell = Cell(lock_step=False)
    yield cell
    cell.close()


@pytest.fixture
def hearts() -> Iterator[Callable[[Cell, str], Heart]]:
    """Starts hearts that beat whatever their loop does, and ends them."""
    started: list[Heart] = []

    def start(cell: Cell, holder: str = "sup") -> Heart:
        heart = Heart(cell.client, holder, cell.config.supervisor.heartbeat_deadline)
        heart.loop_lives = lambda: None  # type: ignore[method-assign]
        heart._loop_deadline = 1e9
        started.append(heart)
        until(lambda: (s := cell.arm.peek()) is not None and s.lease != "")
        return heart

    yield start
    for heart in started:
        heart.close()


# -- lock-step --------------------------------------------------------------------------------------


def test_a_step_advances_exactly_and_its_reply_carries_everything(stepped: Cell) -> None:
    reply = stepped.step(7)
    assert reply.joint_state.t == reply.arm_status.t == 7 * PERIOD
    assert reply.gripper_state.t == reply.belt_state.t == 7 * PERIOD
    assert reply.arm_status.lease == "sup" and reply.frames == ()
    pause(0.15)
    assert stepped.backend.advanced == 7  # time does not move by itself
    assert [j.t for j in stepped.joints.take_all()] == pytest.approx([k * PERIOD for k in range(1, 8)])


def test_commands_take_effect_at_the_next_tick_and_are_followed_exactly(stepped: Cell) -> None:
    stepped.step()
    order = stepped.order()
    assert stepped.call(stepped.keys.trajectory, order) == T.Reply(True)
    seen = stepped.run_to(lambda s: not s.moving)
    np.testing.assert_allclose([j.q for j in seen], order.q[1:], atol=1e-9)
    assert seen[0].t == 2 * PERIOD
    last = stepped.step().arm_status
    assert (last.trajectory_id, last.progress, last.stopped) == (1, 1.0, False)


def test_the_same_commands_give_the_same_bits() -> None:
    def run() -> list[bytes]:
        cell = Cell(lock_step=True)
        try:
            cell.step()
            cell.call(cell.keys.trajectory, cell.order())
            out = [cell.step(10).joint_state]
            cell.call(cell.keys.stop, T.Stop("x", "test"))
            out += [cell.step(5).joint_state for _ in range(10)]
            return [j.q.tobytes() + j.qd.tobytes() for j in out]
        finally:
            cell.close()

    assert run() == run()


def test_frames_come_with_the_step_in_which_they_fall_due(stepped: Cell) -> None:
    stepped.step(3)
    assert stepped.call(stepped.keys.camera("belt", "capture"), T.Capture("sup")).accepted
    latency = stepped.config.cameras["belt"].latency
    early = int(latency / PERIOD)
    assert stepped.step(early).frames == ()
    frame = stepped.step(1).frames[0]
    assert (frame.camera, frame.seq, frame.t) == ("belt", 1, pytest.approx(3 * PERIOD))
    assert frame.rgb.shape == (16, 16, 3) and frame.depth.dtype == np.float32


def test_only_the_lease_holder_may_step_or_command(stepped: Cell) -> None:
    order = stepped.order()
    nobody = stepped.call(stepped.keys.trajectory, order)
    assert (nobody.code, nobody.accepted) == ("lease", False) and "nobody holds it" in nobody.reason
    stepped.step()
    with pytest.raises(WireError, match=r"lease: 'thief' does not hold the lease; 'sup' holds it"):
        stepped.step(1, "thief")
    k = stepped.keys
    commands: list[tuple[str, Any]] = [
        (k.trajectory, replace(order, holder="thief")),
        (k.resume, T.Resume("thief")),
        (k.gripper_command, T.GripperCommand("thief", 10.0, 0.05, 0.1, 30.0)),
        (k.belt_command, T.BeltCommand("thief", 5, 1)),
        (k.camera("belt", "capture"), T.Capture("thief")),
    ]
    for key, command in commands:
        reply = stepped.call(key, command)
        assert (reply.code, reply.accepted) == ("lease", False) and "'sup' holds it" in reply.reason
    assert stepped.call(k.stop, T.Stop("thief", "anyone may")).accepted
    assert stepped.step().arm_status.stop_reason == "anyone may"


@pytest.mark.parametrize("ticks", [0, -1, 1001])
def test_impossible_steps_are_refused(stepped: Cell, ticks: int) -> None:
    with pytest.raises(WireError, match=f"range: ticks must be 1..1000, got {ticks}"):
        stepped.step(ticks)


def test_reset_starts_a_new_world(stepped: Cell) -> None:
    stepped.step(5)
    stepped.call(stepped.keys.trajectory, stepped.order())
    stepped.step(5)
    reset = T.ResetRequest("sup", 3, 4)
    reply = stepped.client.call(stepped.keys.sim_reset, reset, T.StepReply)
    assert (reply.joint_state.t, reply.arm_status.moving, reply.arm_status.lease) == (0.0, False, "sup")
    assert stepped.backend.batches == [(4, 3)]
    stepped.call(stepped.keys.trajectory, stepped.order())  # the same id: nothing was before
    assert stepped.step(2).arm_status.moving
    for bad in (T.ResetRequest("sup", 3, 0), T.ResetRequest("sup", -1, 3), T.ResetRequest("sup", 0, 500)):
        with pytest.raises(WireError, match="refused"):
            stepped.client.call(stepped.keys.sim_reset, bad, T.StepReply)
    assert stepped.step().arm_status.last_refusal.startswith("backend: so many onions")


def test_a_failing_backend_ends_the_node_with_an_event() -> None:
    cell = Cell(lock_step=True)
    try:
        cell.step()
        cell.backend.fail = RuntimeError("the cable is out")
        with pytest.raises(WireError, match="backend fake failed: RuntimeError: the cable is out"):
            cell.step()
        cell.thread.join(5.0)
        assert cell.failure == "backend fake failed: RuntimeError: the cable is out"
        until(lambda: any(t.startswith("backend fake failed") for t in cell.said()))
    finally:
        cell.close()


def test_hardware_cannot_be_stepped() -> None:
    config = own_port()
    with Session.listen(config) as session, pytest.raises(BackendError, match="cannot run in lock-step"):
        Node(config, FakeBackend(config, steppable=False), session, lock_step=True)


# -- refusals ---------------------------------------------------------------------------------------------


def test_refusals_are_answered_reported_and_said(stepped: Cell) -> None:
    stepped.step(100)
    order = stepped.order()
    fast = replace(order, times=order.times / 3, qd=order.qd * 3)
    nan = replace(order, q=np.where(np.arange(6) == 2, np.nan, order.q))
    cases = [
        (replace(order, expires=0.5), "stale", "it expired 0.300 s ago"),
        (replace(order, q=order.q + 0.1), "seam", "away from the arm's set-point"),
        (fast, "acceleration_limit", "the limit is"),
        (replace(order, qd=order.qd + 0.1), "not_at_rest", "the last point must be at rest"),
    ]
    for bad, code, reason in cases:
        reply = stepped.call(stepped.keys.trajectory, bad)
        assert not reply.accepted and reply.code == code and reason in reply.reason
        assert stepped.step().arm_status.last_refusal == f"{reply.code}: {reply.reason}"
    garbled = stepped.call(stepped.keys.trajectory, nan)
    assert (garbled.accepted, garbled.code) == (False, "decode") and "contains NaN" in garbled.reason
    said = stepped.said()
    assert sum(text.startswith("refused: ") for text in said) == 4
    assert not stepped.step().arm_status.moving


def test_gripper_commands_are_checked_and_clipping_is_told(stepped: Cell) -> None:
    stepped.step()
    key = stepped.keys.gripper_command

    def command(
        width: float = 0.05, speed: float = 0.1, force: float = 30.0, expires: float = 9.0
    ) -> T.Reply:
        return stepped.call(key, T.GripperCommand("sup", expires, width, speed, force))

    assert command() == T.Reply(True)
    assert stepped.step().gripper_state.target == 0.05
    wide = command(width=0.2, force=1.0)
    assert wide.accepted and wide.code == "clipped"
    assert wide.reason == "the device's range: width 0.2 -> 0.085 m, force 1 -> 20 N"
    assert command(width=-0.01).code == "range"
    assert command(expires=0.0).code == "stale"
    stepped.call(stepped.keys.stop, T.Stop("x", "hands off"))
    assert command().code == "stopped"


def test_belt_commands_are_checked(stepped: Cell) -> None:
    stepped.step()
    assert stepped.call(stepped.keys.belt_command, T.BeltCommand("sup", 12, 5)).accepted
    assert stepped.backend.batches == [(12, 5)]
    for onions, seed in ((0, 1), (-3, 1), (1001, 1), (5, -1)):
        reply = stepped.call(stepped.keys.belt_command, T.BeltCommand("sup", onions, seed))
        assert (reply.accepted, reply.code) == (False, "range")


def test_the_robots_own_stop_ends_the_motion_and_is_named(stepped: Cell) -> None:
    stepped.step()
    stepped.call(stepped.keys.trajectory, stepped.order())
    stepped.step(20)
    stepped.backend.robot = T.ArmStatus(0.0, safety_mode=3)
    stopped = stepped.step(200).arm_status
    assert stopped.stopped and not stopped.moving
    assert stopped.stop_reason == "the robot's safety mode is 3 (protective stop)"
    refused = stepped.call(stepped.keys.resume, T.Resume("sup"))
    assert refused.code == "stopped" and "protective stop" in refused.reason
    stepped.backend.robot = T.ArmStatus(0.0)
    assert stepped.step(10).arm_status.stopped  # unlocking the robot starts nothing
    assert stepped.call(stepped.keys.resume, T.Resume("sup")).accepted
    assert not stepped.step().arm_status.stopped
    stepped.backend.robot = T.ArmStatus(0.0, robot_mode=3)
    assert "robot mode 3" in stepped.step().arm_status.stop_reason


def test_the_controllers_slider_slows_the_arm_on_its_path(stepped: Cell) -> None:
    stepped.step()
    order = stepped.order()
    stepped.backend.robot = T.ArmStatus(0.0, speed_scaling=0.5)
    stepped.call(stepped.keys.trajectory, order)
    seen = stepped.run_to(lambda s: not s.moving, limit=2000)
    assert len(seen) * PERIOD == pytest.approx(2 * order.times[-1], rel=0.03)


# -- stops --------------------------------------------------------------------------------------------------


def test_after_a_stop_nothing_moves_without_resume_and_a_fresh_plan(stepped: Cell) -> None:
    stepped.step()
    order = stepped.order()
    stepped.call(stepped.keys.trajectory, order)
    stepped.step(40)
    stepped.call(stepped.keys.stop, T.Stop("operator", "look out"))
    assert stepped.call(stepped.keys.resume, T.Resume("sup")).code == "stopped"  # still braking
    seen = stepped.run_to(lambda s: s.stopped and not s.moving)
    rest = seen[-1].q
    assert (stepped.step(50).joint_state.q == rest).all()
    again = stepped.call(stepped.keys.trajectory, replace(order, id=2))
    assert again.code == "stopped" and again.reason == "look out; send resume first"
    assert stepped.call(stepped.keys.resume, T.Resume("sup")).accepted
    assert (stepped.step(50).joint_state.q == rest).all()  # resume starts nothing
    old = stepped.call(stepped.keys.trajectory, replace(order, id=2))
    assert old.code == "seam"
    fresh = replace(order, id=3, q=order.q - order.q[0] + rest)
    assert stepped.call(stepped.keys.trajectory, fresh).accepted
    assert stepped.step(5).arm_status.moving
    assert "stop: look out" in (said := stepped.said()) and "'sup' lifted the stop" in said


def test_ending_the_node_brakes_on_the_path() -> None:
    cell = Cell(lock_step=True)
    try:
        cell.step()
        cell.call(cell.keys.trajectory, cell.order())
        cell.step(60)
        moving = float(np.abs(cell.backend.qd).max())
    finally:
        cell.close()
    assert moving > 0.05 and not cell.backend.qd.any()
    qd = np.array([qd for _, qd in cell.backend.commanded])
    assert (np.abs(np.diff(qd, axis=0)) <= 1.01 * PERIOD * LIMITS.qdd_max).all()


# -- real time ----------------------------------------------------------------------------------------------


def test_no_heart_no_stop_and_the_first_to_beat_holds_the_lease(live: Cell, hearts: Any) -> None:
    pause(0.3)
    assert not live.status(lease="").stopped
    hearts(live, "sup")
    hearts(live, "other")
    pause(0.4)
    assert not live.status(lease="sup").stopped
    reply = live.call(live.keys.trajectory, live.order(holder="other"))
    assert reply.code == "lease" and "'sup' holds it" in reply.reason


def test_a_lost_heartbeat_stops_on_the_path_and_frees_the_lease(live: Cell, hearts: Any) -> None:
    heart = hearts(live, "sup")
    order = live.order(seed=2)
    live.joints.take_all()
    assert live.call(live.keys.trajectory, order).accepted
    live.status(moving=True)
    pause(0.3)
    heart.close()
    silent = perf_s()
    stopped = live.status(stopped=True, moving=False)
    assert perf_s() - silent < 0.1 + 0.3 + 0.2  # deadline, braking, and a busy machine
    assert stopped.stop_reason == "heartbeat lost: nothing from 'sup' for 100 ms"
    assert stopped.lease == "" and 0.0 < stopped.progress < 1.0
    # Every set-point lies on the path.
    from cell.limits import hermite

    fine = hermite(order.times, order.q, order.qd, np.linspace(0, order.times[-1], 20001))[0]
    for q, _ in live.backend.commanded[::7]:
        assert np.abs(fine - q).max(axis=1).min() < 1e-3
    # Another supervisor takes over, deliberately, with ids of its own, from where the arm is.
    hearts(live, "next")
    assert live.status(lease="next").stopped
    assert live.call(live.keys.trajectory, replace(order, holder="next")).code == "stopped"
    assert live.call(live.keys.resume, T.Resume("next")).accepted
    start = live.backend.q
    fresh = replace(order, holder="next", q=order.q - order.q[0] + start)
    assert live.call(live.keys.trajectory, fresh).accepted
    live.status(moving=True, stopped=False)


def test_a_heart_that_stops_at_rest_latches_too(live: Cell, hearts: Any) -> None:
    hearts(live, "sup").close()
    assert "heartbeat lost" in live.status(stopped=True).stop_reason


def test_simulated_time_keeps_up_with_wall_time_after_late_cycles(live: Cell) -> None:
    live.joints.wait(1.0)
    begin, wall = live.joints.wait(1.0).t, perf_s()
    for _ in range(4):
        live.backend.delay = 0.06
        pause(0.12)
    end = live.joints.wait(1.0).t
    assert end - begin == pytest.approx(perf_s() - wall, abs=0.05)
    assert live.joints.lost == 0
    live.backend.delay = 0.6  # beyond the bound: given up, and said
    pause(0.9)
    assert any("ms late" in text for text in live.said())
    assert live.joints.wait(1.0).t - begin < perf_s() - wall - 0.2


def test_a_deaf_simulation_does_not_blame_the_heart_but_a_real_arms_loop_does() -> None:
    deadline = load().supervisor.heartbeat_deadline
    for seconds, deaf, lost in [(0.11, 0.05, ""), (0.16, 0.05, "sup"), (0.11, 0.0, "sup"), (0.2, 9.0, "")]:
        lease = Lease(deadline)
        lease.beat("sup", 10.0)
        lease.excuse(deaf, 10.0 + seconds)
        assert lease.lost(10.0 + seconds) == lost
        assert lease.lost(10.0 + seconds + 1.01 * deadline) == ("" if lost else "sup")  # only ever delayed


def test_a_backend_with_its_own_cycle_sets_the_pace() -> None:
    cell = Cell(lock_step=False, steppable=False)
    try:
        begin, ticks = perf_s(), cell.backend.advanced
        cell.backend.delay = 0.1
        pause(0.5)
        expected = (perf_s() - begin - 0.1) / PERIOD
        done = cell.backend.advanced - ticks
        assert 0.4 * expected < done < expected + 3  # never a burst to catch up
        with pytest.raises(WireError, match="nobody answers"):
            cell.client.call(cell.keys.sim_truth, T.TruthRequest("x"), T.Truth, timeout=1.0)
    finally:
        cell.close()


def test_handlers_cannot_end_the_loop_and_one_thread_drives_the_backend(live: Cell, hearts: Any) -> None:
    hearts(live, "sup")
    before = live.backend.command_gripper

    def broken(width: float, speed: float, force: float) -> tuple[float, float, float]:
        raise ZeroDivisionError("oops")

    live.backend.command_gripper = broken  # type: ignore[method-assign]
    command = T.GripperCommand("sup", 1e6, 0.05, 0.1, 30.0)
    reply = live.call(live.keys.gripper_command, command)
    assert (reply.code, reply.reason) == ("backend", "ZeroDivisionError: oops")
    live.backend.command_gripper = before  # type: ignore[method-assign]
    assert live.call(live.keys.gripper_command, command).accepted
    assert live.backend.threads <= {live.thread.ident, threading.get_ident()}  # ours only built it
    live.backend.threads.clear()
    callers = [
        threading.Thread(target=live.call, args=(live.keys.stop, T.Stop(str(i), "again"))) for i in range(8)
    ]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert live.backend.threads == {live.thread.ident}


def test_a_failing_backend_ends_the_real_time_loop(live: Cell) -> None:
    live.joints.wait(1.0)
    live.backend.fail = BackendError("no set-point was taken for 1 s")
    live.thread.join(5.0)
    assert live.failure == "backend fake failed: no set-point was taken for 1 s"


def test_clock_and_states_are_published(live: Cell) -> None:
    clock = live.client.latest(live.keys.clock, T.ClockTick)
    gripper = live.client.latest(live.keys.gripper_state, T.GripperState)
    belt = live.client.latest(live.keys.belt_state, T.BeltState)
    info = live.client.latest(live.keys.camera("belt", "camera_info"), T.CameraInfo)
    frames = live.client.latest_frame("belt")
    for reader in (clock, gripper, belt):
        reader.wait(2.0)
    begin, wall, count = clock.wait(1.0).t, WallClock(), len(clock.take_all())
    end = wall.now() + 0.5
    while wall.now() < end:
        count += len(clock.take_all())
        pause(0.01)
    assert 8 <= count <= 16  # 25 Hz
    assert clock.wait(1.0).t > begin
    with Session.connect(live.config) as other:
        heart = Heart(other, "sup", 0.1)
        until(lambda: live.status().lease == "sup")
        assert live.call(live.keys.camera("belt", "capture"), T.Capture("sup")).accepted
        frame = frames.wait(2.0)
        assert info.wait(2.0).t == frame.t
        heart.close()
