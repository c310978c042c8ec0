"""The simulated cell: grasping by friction alone, the arm's lag, and exact repeatability."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from functools import cache

import msgspec
import numpy as np
import pytest

from cell.config import CellConfig, load
from cell.errors import BackendError, ConfigError
from cell.frames import Array, pose, rot_x
from cell.motion.kinematics import Kinematics
from cell.motion.planner import drop_place
from hil.backend import make_backend
from hil.sim.backend import SimBackend
from hil.sim.physics import bullet
from hil.sim.world import ONION_LABEL
from urdf import FINGER_JOINT_NAMES

CONFIG = load()
PERIOD = CONFIG.arm.control_period


@cache
def kinematics() -> Kinematics:
    return Kinematics(CONFIG)


class Hand:
    """Moves the arm and the fingers of a backend like the node would, without planning."""

    def __init__(self, backend: SimBackend) -> None:
        self.backend = backend
        self.q = np.array(CONFIG.arm.home)

    def place(self, X_WT: Array) -> None:
        """Put the arm there at once."""
        self.q = kinematics().ik_near(X_WT, np.array(CONFIG.arm.home))
        self.backend.world.arm.place(self.q)
        self.wait(0.1)

    def move(self, X_WT: Array, duration: float = 0.8) -> None:
        """Swing there and come to rest."""
        start, goal = self.q, kinematics().ik_near(X_WT, self.q)
        for s in np.linspace(0.0, 1.0, round(duration / PERIOD) + 1)[1:]:
            blend, rate = 3 * s**2 - 2 * s**3, (6 * s - 6 * s**2) / duration
            self.backend.command_joints(start + blend * (goal - start), rate * (goal - start))
            self.backend.advance()
        self.q = goal
        self.wait(0.15)

    def grip(self, width: float, force: float = CONFIG.gripper.grip_force) -> None:
        self.backend.command_gripper(width, CONFIG.gripper.grip_speed, force)
        self.wait(0.05)
        for _ in range(400):
            if not self.backend.read_gripper().moving:
                return
            self.wait(PERIOD)

    def wait(self, duration: float) -> None:
        for _ in range(round(duration / PERIOD)):
            self.backend.command_joints(self.q, np.zeros(6))
            self.backend.advance()


def downward(p: Array, up: float = 0.0) -> Array:
    return pose(rot_x(np.pi), p + np.array([0.0, 0.0, up]))


@pytest.fixture
def backend() -> Iterator[SimBackend]:
    one = SimBackend(CONFIG, seed=1, onions=1)
    one.connect()
    yield one
    one.close()


def over_onion(backend: SimBackend) -> tuple[Hand, Array]:
    """The open hand round the onion, ready to close."""
    p_WO = backend.world.onion_pose(0)[:3, 3]
    p_WO[2] = max(p_WO[2], CONFIG.belt.top_z + 0.017)
    hand = Hand(backend)
    hand.place(downward(p_WO, 0.10))
    hand.move(downward(p_WO))
    return hand, p_WO


def onion_in_hand(backend: SimBackend) -> Array:
    """Place of the onion in the tool's frame (3,) [m]."""
    X_WT = kinematics().X_WT(backend.read_joints().q)
    return X_WT[:3, :3].T @ (backend.world.onion_pose(0)[:3, 3] - X_WT[:3, 3])


# -- grasping ---------------------------------------------------------------------------------------


def test_an_onion_is_lifted_swung_and_put_back_by_friction_alone(backend: SimBackend) -> None:
    hand, p_WO = over_onion(backend)
    start = backend.world.onion_pose(0)[:3, 3]
    assert backend.read_gripper().width == pytest.approx(CONFIG.gripper.stroke, abs=1e-3)
    hand.grip(0.0)
    gripper = backend.read_gripper()
    assert gripper.holding and not gripper.moving
    assert gripper.width == pytest.approx(2 * backend.world.onions[0].radius, abs=0.008)
    before = onion_in_hand(backend)
    slip = 0.0
    for up in (0.15, 0.02, 0.15):
        hand.move(downward(p_WO, up), duration=0.5)
        slip = max(slip, float(np.linalg.norm(onion_in_hand(backend) - before)))
        assert backend.read_gripper().holding
    assert backend.truth().place == ("held",)
    assert slip < 0.001
    hand.move(downward(p_WO, 0.002))
    hand.grip(CONFIG.gripper.stroke)
    hand.move(downward(p_WO, 0.10))
    hand.wait(1.0)
    truth = backend.truth()
    assert truth.place == ("belt",)
    assert np.linalg.norm(truth.p_WO[0] - start) < 0.02
    assert truth.arm_contacts == 0 and truth.contact_log == ()
    assert bullet.getNumConstraints(physicsClientId=backend.world.client) == 1  # the fingers' gear only


def test_an_open_hand_lets_go(backend: SimBackend) -> None:
    hand, p_WO = over_onion(backend)
    hand.grip(0.0)
    hand.move(downward(p_WO, 0.10))
    hand.grip(CONFIG.gripper.stroke)
    hand.wait(0.6)
    assert not backend.read_gripper().holding
    assert backend.truth().place == ("belt",)


def test_a_weak_grip_with_slippery_pads_drops_it(backend: SimBackend) -> None:
    """Nothing glues the onion to the hand: friction is what holds it, and here there is none to speak of."""
    world = backend.world
    parts = [(world.robot, world.joints[name], 0.02) for name in FINGER_JOINT_NAMES]
    for body, link, friction in [*parts, (world.onion_bodies[0], -1, 0.1)]:
        bullet.changeDynamics(
            body, link, lateralFriction=friction, frictionAnchor=0, physicsClientId=world.client
        )
    hand, p_WO = over_onion(backend)
    hand.grip(0.0, force=CONFIG.gripper.min_force)
    hand.move(downward(p_WO, 0.15), duration=0.5)
    hand.wait(0.3)
    assert backend.truth().place == ("belt",)
    gripper = backend.read_gripper()
    assert not gripper.holding or gripper.width < 0.5 * CONFIG.onions.diameter[0]


def test_closing_on_nothing_holds_nothing(backend: SimBackend) -> None:
    hand = Hand(backend)
    hand.place(downward(np.array([0.34, 0.0, 0.05])))
    hand.grip(0.0)
    gripper = backend.read_gripper()
    assert gripper.width < 0.002 and not gripper.holding and not gripper.moving


def test_gripper_commands_are_clipped_to_the_device(backend: SimBackend) -> None:
    g = CONFIG.gripper
    assert backend.command_gripper(0.5, 9.0, 9999.0) == (g.stroke, g.max_speed, g.max_force)
    assert backend.command_gripper(0.0, 0.0, 0.0) == (0.0, g.min_speed, g.min_force)


def test_touching_the_belt_is_noticed(backend: SimBackend) -> None:
    hand = Hand(backend)
    p = np.array([0.34, -0.2, CONFIG.belt.top_z + 0.02])
    hand.place(downward(p, 0.05))
    assert backend.truth().arm_contacts == 0
    hand.move(downward(p, -0.02))
    truth = backend.truth()
    assert truth.arm_contacts > 0 and "robot touches belt" in truth.contact_log[0]


# -- the arm ------------------------------------------------------------------------------------------


def test_the_arm_follows_with_the_configured_lag(backend: SimBackend) -> None:
    """A sine of each joint in turn: the delay that fits best is `arm.lag`."""
    home, omega, amplitude = np.array(CONFIG.arm.home), 2 * np.pi * 0.5, 0.15
    n = round(2.5 / PERIOD)
    times = np.array([backend.now() + (k + 1) * PERIOD for k in range(n)])
    start = backend.now()

    def target(t: Array) -> tuple[Array, Array]:
        """Starts smoothly at rest."""
        x = omega * (np.asarray(t) - start)
        return amplitude * (1 - np.cos(x)), amplitude * omega * np.sin(x)

    shape = np.array([1.0, -0.5, 0.5, 1.0, -1.0, 1.0])
    measured = []
    for t in times:
        q, qd = target(t)
        backend.command_joints(home + q * shape, qd * shape)
        backend.advance()
        measured.append(backend.read_joints().q - home)
    lags = np.arange(0.0, 0.08, 0.001)
    fit = [
        np.abs(np.array(measured)[60:] - np.outer(target(times - lag)[0][60:], shape)).max() for lag in lags
    ]
    assert lags[int(np.argmin(fit))] == pytest.approx(CONFIG.arm.lag, abs=0.008)
    assert min(fit) < 0.004


def test_without_commands_it_holds_still(backend: SimBackend) -> None:
    for _ in range(125):
        backend.advance()
    joints = backend.read_joints()
    np.testing.assert_allclose(joints.q, CONFIG.arm.home, atol=2e-3)
    assert np.abs(joints.qd).max() < 1e-3


# -- repeatability ------------------------------------------------------------------------------------

SCRIPT = """
import hashlib, sys
import numpy as np
from tests.test_sim import CONFIG, Hand, SimBackend, downward, over_onion
digest = [hashlib.sha256(), hashlib.sha256()]
backend = SimBackend(CONFIG, seed=int(sys.argv[1]), onions=3)
backend.connect()
hand, p_WO = over_onion(backend)
hand.grip(0.0)
for up in (0.1, 0.0, 0.1):
    hand.move(downward(p_WO, up), 0.4)
    joints = backend.read_joints()
    for part in (joints.q, joints.qd, joints.effort, backend.truth().p_WO):
        digest[0].update(np.ascontiguousarray(part).tobytes())
    backend.request_frame("belt")
    hand.wait(0.06)
    (frame,) = backend.take_frames()
    digest[1].update(frame.rgb.tobytes() + frame.depth.tobytes())
print(*(d.hexdigest() for d in digest))
"""


def test_the_same_seed_and_commands_give_the_same_bits_in_another_process() -> None:
    runs = [
        subprocess.Popen([sys.executable, "-c", SCRIPT, seed], stdout=subprocess.PIPE, text=True)
        for seed in ("4", "4", "5")
    ]
    first, second, other = ((run.communicate(timeout=60)[0] or "").split() for run in runs)
    assert len(first) == 2 and first == second
    assert first[0] != other[0] and first[1] != other[1]


def test_a_reset_is_a_fresh_start(backend: SimBackend) -> None:
    before = backend.truth()
    hand, _ = over_onion(backend)
    hand.grip(0.0)
    backend.reset(1, 1)
    after = backend.truth()
    assert backend.now() == after.t == before.t == 0.0
    np.testing.assert_array_equal(before.p_WO, after.p_WO)


# -- the belt, cameras, renderers -----------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 2**40])
def test_fifteen_onions_lie_apart_in_the_pick_window_at_rest(seed: int) -> None:
    from hil.sim.world import World

    world = World(CONFIG, seed, 15)
    try:
        p = np.array([world.onion_pose(i)[:3, 3] for i in range(15)])
        assert {world.place_of(i) for i in range(15)} == {"belt"}
        b = CONFIG.belt
        for axis, (low, high) in ((0, b.pick_x), (1, b.pick_y)):
            assert p[:, axis].min() > low - 0.03 and p[:, axis].max() < high + 0.03
        gaps = np.linalg.norm(p[:, None] - p[None], axis=2) + np.eye(15)
        assert gaps.min() > CONFIG.onions.diameter[0]
        for _ in range(50):
            world.step()
        moved = np.array([world.onion_pose(i)[:3, 3] for i in range(15)]) - p
        assert np.abs(moved).max() < 0.004
    finally:
        world.close()


def test_a_whole_batch_lies_in_the_bin_and_not_one_upon_the_other() -> None:
    from hil.sim.world import World

    world = World(CONFIG, 3, 15)
    try:
        world.arm.place(np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0]))  # upright, out of the way
        for i in range(15):
            world.set_onion_pose(i, pose(p=drop_place(CONFIG.bin, i)))
            bullet.changeDynamics(
                world.onion_bodies[i], -1, activationState=bullet.ACTIVATION_STATE_WAKE_UP,
                physicsClientId=world.client,
            )  # fmt: skip
            for _ in range(100):
                world.step()
        assert {world.place_of(i) for i in range(15)} == {"bin"}
        heights = np.array([world.onion_pose(i)[2, 3] for i in range(15)])
        floor = CONFIG.bin.center[2] - CONFIG.bin.size[2]
        assert heights.max() < floor + 2.2 * CONFIG.onions.diameter[1]  # two layers
    finally:
        world.close()


def test_too_many_onions_are_refused_with_advice() -> None:
    from hil.sim.world import World

    with pytest.raises(ConfigError, match="60 onions do not fit"):
        World(CONFIG, 1, 60)


def test_frames_arrive_after_the_latency_and_show_the_onion(backend: SimBackend) -> None:
    asked = backend.now()
    backend.request_frame("belt")
    assert backend.take_frames() == []
    while not (frames := backend.take_frames()):
        backend.advance()
    assert backend.now() - asked == pytest.approx(CONFIG.cameras["belt"].latency, abs=PERIOD)
    frame = frames[0]
    assert (frame.camera, frame.seq, frame.t) == ("belt", 1, asked)
    assert frame.rgb.shape == (480, 640, 3) and frame.depth.shape == (480, 640)
    with pytest.raises(BackendError, match="legal values: belt"):
        backend.request_frame("ceiling")


def with_renderer(name: str) -> CellConfig:
    return msgspec.structs.replace(CONFIG, renderer=name)


def test_the_fallback_renderer_sees_the_same_cell() -> None:
    pytest.importorskip("moderngl")
    images = {}
    for name in ("tiny", "auto"):
        backend = SimBackend(with_renderer(name), seed=2, onions=3)
        backend.connect()
        camera = backend._cameras["belt"]
        assert backend._renderer is not None
        images[name] = backend._renderer.render(camera.X_WC, camera.pinhole, camera.near, camera.far)
        backend.close()
    for i in range(3):
        masks = [images[name].labels == ONION_LABEL + i for name in ("tiny", "auto")]
        assert masks[0].sum() > 500
        assert (masks[0] & masks[1]).sum() / (masks[0] | masks[1]).sum() > 0.93
    both = (images["tiny"].depth > 0) & (images["auto"].depth > 0)
    assert np.median(np.abs(images["tiny"].depth - images["auto"].depth)[both]) < 0.003


# -- the interface --------------------------------------------------------------------------------------


def test_unknown_backends_are_refused_by_name() -> None:
    with pytest.raises(ConfigError, match=r"'kuka'.*legal values: sim"):
        make_backend("kuka", CONFIG)


def test_a_backend_that_is_not_connected_says_so_and_closes_quietly() -> None:
    backend = make_backend("sim", CONFIG, seed=1, onions=1)
    backend.close()
    with pytest.raises(BackendError, match="connect"):
        backend.now()
    backend.connect()
    backend.close()
    backend.close()
