"""What `hil.backend.Backend` promises, held against every backend that there is.

A new backend joins by one line in `BACKENDS`. The kinematic stand-in of the node's tests is held
to the same promises, so that those tests mean something. The real arm's backend is held to them on an
emulated controller, with the simulated cell around it.

A backend with a clock of its own shares the machine with others: where a promise is a time, `slack`
says how much later it may be kept there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from cell.clock import perf_s
from cell.config import CellConfig, load
from cell.errors import CellError, ConfigError, RefusedError
from cell.frames import Array
from cell.wire.types import Frame, Trajectory
from hil.backend import Backend, NeedsArming, make_backend
from hil.executor import Executor
from tests.emulated import emulated_backend, end, patient
from tests.fake_backend import FakeBackend
from tests.test_limits import LIMITS, move

BACKENDS: dict[str, Callable[[CellConfig], Backend]] = {
    "sim": lambda config: make_backend("sim", config, seed=3, onions=1),
    "fake": FakeBackend,
    "fake with a cycle of its own": lambda config: FakeBackend(config, steppable=False),
    "ur3e": emulated_backend,
}
CONFIG = load()
PERIOD = CONFIG.arm.control_period
HOME = np.array(CONFIG.arm.home)
CLEAR = move(HOME, HOME + np.array([0.5, -0.2, 0.2, 0.3, 0.3, 0.6]), 1.0)
"""A brisk motion that touches nothing in the reference cell."""


@pytest.fixture(scope="module", autouse=True)
def none_left() -> Iterator[None]:
    yield
    end()


@pytest.fixture(scope="module", params=BACKENDS)
def shared(request: pytest.FixtureRequest) -> Iterator[Backend]:
    backend = BACKENDS[request.param](CONFIG)
    backend.connect()
    yield backend
    backend.close()


@pytest.fixture
def backend(shared: Backend) -> Backend:
    """Connected, ready to follow, the arm at rest at home, no frames under way."""
    make_ready(shared)
    joints = shared.read_joints()
    gap = HOME - joints.q
    if max(np.abs(gap).max(), np.abs(joints.qd).max()) > 2e-3:
        hold(shared, joints.q, 0.1)
        steps = int(np.ceil(np.abs(gap).max() / (0.5 * PERIOD)))
        for k in range(steps):
            shared.command_joints(joints.q + gap * (k + 1) / steps, gap / (steps * PERIOD))
            shared.advance()
        hold(shared, HOME, 0.3)
    shared.take_frames()
    return shared


def make_ready(backend: Backend) -> None:
    """After a stop of its own a device must be told to follow again."""
    while isinstance(backend, NeedsArming):
        try:
            backend.prepare()
            backend.enable()
            return
        except RefusedError as error:
            assert error.code == "busy", error
            backend.advance()


def real(backend: Backend) -> bool:
    """It has processes and a clock of its own, and may be held up by whatever else the machine does."""
    return backend.name == "ur3e"


def slack(backend: Backend, exact: float = 1e-9) -> float:
    """How much later than promised something may happen [s]."""
    return 2.0 if real(backend) else exact


@pytest.fixture(params=BACKENDS)
def fresh(request: pytest.FixtureRequest) -> Iterator[Backend]:
    """Not connected yet."""
    backend = BACKENDS[request.param](CONFIG)
    yield backend
    backend.close()


def hold(backend: Backend, q: Array, seconds: float) -> None:
    for _ in range(round(seconds / PERIOD)):
        backend.command_joints(q, np.zeros(6))
        backend.advance()


def frames_of(backend: Backend, ticks: int, camera: str, count: int) -> list[tuple[float, Frame]]:
    """(time of arrival, frame) of one camera's that arrive within so many periods.

    A picture that another process makes may come later; then until there are `count`.
    """
    out: list[tuple[float, Frame]] = []
    late = round(slack(backend, 0.0) / PERIOD)
    for k in range(ticks + late):
        hold(backend, HOME, PERIOD)
        out += [(backend.now(), frame) for frame in backend.take_frames() if frame.camera == camera]
        if late and k >= ticks and len(out) >= count:
            break
    return out


# -- life cycle ---------------------------------------------------------------------------------


def test_before_connect_everything_fails_with_words(fresh: Backend) -> None:
    assert fresh.name and isinstance(fresh.steppable, bool)
    for use in (fresh.now, fresh.read_joints, fresh.read_gripper, fresh.read_status):
        with pytest.raises(CellError, match="connect"):
            use()


def test_connect_and_close_may_be_repeated_and_close_leaves_the_arm_at_rest(fresh: Backend) -> None:
    fresh.close()
    fresh.connect()
    t = fresh.now()
    hold(fresh, fresh.read_joints().q, PERIOD)
    fresh.connect()  # connected already: nothing happens
    assert fresh.now() > t
    start = fresh.read_joints().q
    for k in range(20):
        fresh.command_joints(start + 0.3 * k * PERIOD, np.full(6, 0.3))
        fresh.advance()
    fresh.close()
    fresh.close()
    fresh.connect()
    assert np.abs(fresh.read_joints().qd).max() < 1e-3


def test_an_unknown_backend_is_answered_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"got 'magic'; legal values: .*sim"):
        make_backend("magic", CONFIG)


# -- time ---------------------------------------------------------------------------------------------


def test_time_advances_by_the_control_period(backend: Backend) -> None:
    begin, wall = backend.now(), perf_s()
    hold(backend, HOME, 50 * PERIOD)
    assert -1e-6 <= backend.now() - begin - 50 * PERIOD <= slack(backend)
    if not backend.steppable:
        assert perf_s() - wall >= 49 * PERIOD  # it waits for the real cycle


def test_measurements_carry_the_time_they_were_taken(backend: Backend) -> None:
    hold(backend, HOME, PERIOD)
    now = backend.now()
    for reading in (
        backend.read_joints(),
        backend.read_status(),
        backend.read_gripper(),
        backend.read_belt(),
    ):
        assert now - PERIOD - slack(backend) <= reading.t <= now + slack(backend, 0.0)


# -- arm -----------------------------------------------------------------------------------------------


def gap_within_the_lag(backend: Backend, order: Trajectory) -> float:
    """How far the measured joints are from the set-points of some time up to the lag before [rad]."""
    executor = Executor(LIMITS, PERIOD, order.q[0])
    executor.accept(order, 0.0, backend.read_joints().q)
    sent, measured = [order.q[0]], [backend.read_joints().q]
    settle = 60
    while executor.moving or settle:
        settle -= not executor.moving
        q, qd = executor.tick(0.0)
        backend.command_joints(q, qd)
        backend.advance()
        sent.append(q.copy())
        measured.append(backend.read_joints().q)
    s, m = np.array(sent), np.array(measured)
    assert np.abs(m[-1] - order.q[-1]).max() < 2e-3
    latest = int(np.ceil(CONFIG.arm.lag / PERIOD)) + (4 if real(backend) else 1)  # two processes more
    share = 0.98 if real(backend) else 1.0  # a busy machine delays a real cycle now and then
    gaps = (np.abs(m[k:] - s[: len(s) - k]).max(axis=1) for k in range(latest + 1))
    return min(float(np.quantile(gap, share)) for gap in gaps)


def test_set_points_are_followed_within_the_lag(backend: Backend) -> None:
    orders = [CLEAR]
    if real(backend):  # one that a busy machine kept from its cycles catches up slowly: it may try again
        orders += [move(CLEAR.q[-1], HOME, 1.0), CLEAR]
    assert any(gap_within_the_lag(backend, order) < 0.008 for order in orders)
    joints = backend.read_joints()
    assert np.abs(joints.qd).max() < 0.01
    for values in (joints.q, joints.qd, joints.effort):
        assert values.shape == (6,) and values.dtype == np.float64 and np.isfinite(values).all()


def test_it_stops_by_itself_when_set_points_stop_coming(backend: Backend) -> None:
    for k in range(40):
        backend.command_joints(HOME + 0.3 * (k + 1) * PERIOD, np.full(6, 0.3))
        backend.advance()
    last = HOME + 0.3 * 40 * PERIOD
    for _ in range(60):
        backend.advance()
    joints = backend.read_joints()
    assert np.abs(joints.qd).max() < 0.01
    # The driver notices it in a cycle of its own, which a busy machine may hold up for some of them.
    coasting = 0.3 * (patient(CONFIG).ur3e.patience + 0.05) if real(backend) else 0.0
    assert np.abs(joints.q - last).max() < 0.02 + coasting


def test_the_robot_reports_that_it_runs_and_leaves_the_rest_to_the_node(backend: Backend) -> None:
    status = backend.read_status()
    assert (status.robot_mode, status.safety_mode, status.speed_scaling) == (7, 1, 1.0)
    assert (status.trajectory_id, status.moving, status.stopped, status.lease) == (0, False, False, "")


# -- gripper and belt -------------------------------------------------------------------------------------


def test_the_gripper_goes_where_it_is_told(backend: Backend) -> None:
    g = CONFIG.gripper
    assert backend.command_gripper(0.03, 0.1, 40.0) == pytest.approx((0.03, 0.1, 40.0))
    hold(backend, HOME, (g.stroke / 0.1) + 0.3)
    state = backend.read_gripper()
    assert state.width == pytest.approx(0.03, abs=0.001) and state.target == pytest.approx(0.03)
    assert not state.moving and not state.holding


def test_the_gripper_says_what_it_was_clipped_to(backend: Backend) -> None:
    g = CONFIG.gripper
    assert backend.command_gripper(9.0, 9.0, 9e4) == pytest.approx((g.stroke, g.max_speed, g.max_force))
    assert backend.command_gripper(0.0, 0.0, 0.0) == pytest.approx((0.0, g.min_speed, g.min_force))
    backend.command_gripper(g.stroke, g.max_speed, g.min_force)
    hold(backend, HOME, 1.0)
    assert backend.read_gripper().width == pytest.approx(g.stroke, abs=0.001)


def test_the_belt_brings_a_batch_or_says_why_not(backend: Backend) -> None:
    batch = backend.read_belt().batch
    try:
        backend.command_belt(3, 1)
    except CellError as error:
        assert len(str(error)) > 10
        assert backend.read_belt().batch == batch
    else:
        assert backend.read_belt().batch == batch + 1


# -- cameras ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("camera", sorted(CONFIG.cameras))
def test_frames_arrive_after_the_latency_with_their_own_age(backend: Backend, camera: str) -> None:
    info, latency = backend.camera_info(camera), CONFIG.cameras[camera].latency
    exposed = backend.now()
    backend.request_frame(camera)
    assert backend.take_frames() == [] or latency == 0.0
    (arrival, frame), *others = frames_of(backend, int(np.ceil(latency / PERIOD)) + 3, camera, 1)
    assert not others or CONFIG.cameras[camera].rate > 0.0
    assert -1e-9 <= frame.t - exposed <= slack(backend)
    assert latency - 1e-6 <= arrival - frame.t <= latency + 2 * PERIOD + slack(backend)
    assert frame.rgb.shape == (info.height, info.width, 3) and frame.rgb.dtype == np.uint8
    assert frame.depth.shape == (info.height, info.width) and frame.depth.dtype == np.float32
    assert np.isfinite(frame.depth).all() and (frame.depth >= 0.0).all() and (frame.depth > 0.0).any()
    assert info.frame == f"camera_{camera}" and min(info.fx, info.fy, info.cx, info.cy) > 0.0


def test_frames_are_delivered_once_oldest_first_and_counted(backend: Backend) -> None:
    for _ in range(3):
        backend.request_frame("belt")
        hold(backend, HOME, 2 * PERIOD if not real(backend) else 0.5)
    early = [(backend.now(), frame) for frame in backend.take_frames() if frame.camera == "belt"]
    frames = [f for _, f in early + frames_of(backend, 20, "belt", 3 - len(early))]
    times, numbers = [f.t for f in frames], [f.seq for f in frames]
    assert len(frames) == 3 and times == sorted(times)
    assert np.diff(numbers).tolist() == [1, 1]
    assert backend.take_frames() == []


def test_an_unknown_camera_is_answered_with_those_there_are(backend: Backend) -> None:
    for use in (backend.camera_info, backend.request_frame):
        with pytest.raises(CellError, match=r"got 'moon'; legal values: .*belt"):
            use("moon")
