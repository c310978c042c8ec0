"""What the emulated controller moves: an arm without physics, or the arm of the simulated cell.

`WorldPlant` is the PyBullet world of the `sim` backend without a person and with the arm's own lag
set to 0; it does one physics step per cycle. The person, the produce's looks, the cameras and the
truth live in a process of their own (`hil.emulator.eyes`), which is told every control period where
everything is, and says what the person's hand holds.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np

from cell.clock import Clock, WallClock
from cell.config import CellConfig
from cell.errors import ConfigError
from cell.frames import Array
from hil.emulator.exchange import Ball, Batch, Exchange, Hand, Snapshot, Touch
from hil.emulator.grippers import IdealGripper, WorldGripper
from hil.emulator.interfaces import PERIOD, ZERO6, Measured
from hil.emulator.wrench import ToolForce
from hil.sim.onions import onion_body
from hil.sim.physics import bullet
from hil.sim.world import World
from hil.ur3e.lamp import lamp_signal

_AHEAD = 0.05
"""An onion in a hand that is not heard of moves on for this long [s]."""
_CONTACTS_KEPT = 20


class IdealPlant:
    """Joints that are at the set-point one cycle later, without weight and without surroundings.

    Args:
        config: home position and gripper.

    Attributes:
        gripper: moves in the plant's time.
    """

    def __init__(self, config: CellConfig) -> None:
        self.gripper = IdealGripper(config.gripper)
        self._q, self._qd = np.array(config.arm.home), np.zeros(6)

    def step(self, q: Array, qd: Array) -> None:
        self._q, self._qd = np.array(q, float), np.array(qd, float)
        self.gripper.advance(PERIOD)

    def measure(self) -> Measured:
        return Measured(self._q, self._qd, ZERO6, ZERO6)

    def payload(self, mass: float) -> None:
        del mass

    def outputs(self, digital_out: int) -> None:
        del digital_out

    def close(self) -> None:
        pass


class WorldPlant:
    """Arm, gripper and onions of the simulated cell.

    Args:
        config: the cell; `arm.control_period` must be a multiple of the controller's cycle.
        exchange: end of the link to the surroundings; None: there are none, and onions come by `bring`.
        clock: wall time, for the reports.

    Attributes:
        gripper: the fingers. world: the physics. batch: number of the batch that lies there, 0: none.

    Raises:
        ConfigError: the control period does not fit.
    """

    def __init__(
        self, config: CellConfig, exchange: Exchange | None = None, clock: Clock | None = None
    ) -> None:
        self._cycles = round(config.arm.control_period / PERIOD)
        if not np.isclose(self._cycles * PERIOD, config.arm.control_period) or self._cycles < 1:
            raise ConfigError(
                f"arm.control_period must be a multiple of the controller's cycle, {PERIOD:g} s, "
                f"got {config.arm.control_period:g}"
            )
        arm = msgspec.structs.replace(config.arm, lag=0.0, physics_substeps=self._cycles)
        self.world = World(msgspec.structs.replace(config, arm=arm), seed=0, onions=0)
        self.gripper = WorldGripper(config.gripper, self.world.gripper)
        self.batch = 0
        self._period = config.arm.control_period
        self._exchange, self._clock = exchange, clock or WallClock()
        self._bodies: list[int] = []
        self._masses: dict[int, float] = {}
        self._swap: Iterator[None] | None = None
        self._hand: Hand | None = None
        self._signal = "off"
        self._force = ToolForce(self.world)
        self._wrench = ZERO6
        self._tick = self._contacts = self._told = 0

    # -- hil.emulator.interfaces.Plant ----------------------------------------------------------------

    def step(self, q: Array, qd: Array) -> None:
        world, part = self.world, self._tick % self._cycles
        if part == 0:  # what belongs to the control period is spread over its cycles
            self._listen()
            self.gripper.drive(self._period)
        if self._swap is not None and next(self._swap, "done") == "done":
            self._swap = None
        world.arm.command(world.time + world.time_step, q, qd)
        world.substep()
        if part == min(1, self._cycles - 1):
            self._feel()
        if part == self._cycles - 1:
            self._report()
        self._tick += 1

    def measure(self) -> Measured:
        return Measured(*self.world.arm.measure(), self._wrench)

    def payload(self, mass: float) -> None:
        del mass  # the arm's motors are ideal, and the force sensor knows the gripper's weight

    def outputs(self, digital_out: int) -> None:
        self._signal = lamp_signal(digital_out)

    def close(self) -> None:
        self.world.close()

    # -- produce ------------------------------------------------------------------------------------------

    def bring(self, batch: Batch) -> None:
        """Put a new batch in the place of the old one, an onion per cycle; the arm stays as it is."""
        self._swap = self._swapping(batch)

    def _swapping(self, batch: Batch) -> Iterator[None]:
        client = self.world.client
        self._hand, self.batch, self._masses = None, 0, {}
        for body in self._bodies:
            bullet.removeBody(body, physicsClientId=client)
        self._bodies = []
        for ball in batch.balls:
            yield
            body = onion_body(client, ball.mass, ball.radius)
            place(client, body, ball)
            self._bodies.append(body)
            self._masses[body] = ball.mass
        self.batch = batch.number

    # -- the surroundings -----------------------------------------------------------------------------------

    def _listen(self) -> None:
        """Take in what the surroundings say, and move what the person holds."""
        if self._exchange is not None:
            for message in self._exchange.receive():
                if isinstance(message, Batch):
                    self.bring(message)
                elif isinstance(message, Hand):
                    self._grasp(message)
        if self._hand is not None:
            self._carry(self._hand)

    def _grasp(self, hand: Hand) -> None:
        if hand.batch != self.batch or hand.onion >= len(self._bodies):
            return
        if self._hand is not None and hand.onion != self._hand.onion:
            body, c = self._bodies[self._hand.onion], self.world.client
            bullet.resetBaseVelocity(body, [0, 0, 0], [0, 0, 0], physicsClientId=c)
            bullet.changeDynamics(
                body, -1, activationState=bullet.ACTIVATION_STATE_WAKE_UP, physicsClientId=c
            )
        self._hand = hand if hand.onion >= 0 else None

    def _carry(self, hand: Hand) -> None:
        """The onion is where the hand was, and as far on as it moved since."""
        body, c = self._bodies[hand.onion], self.world.client
        late = min(max(self._clock.now() - hand.t, 0.0), _AHEAD)
        p = [x + late * v for x, v in zip(hand.pose[:3], hand.velocity, strict=True)]
        bullet.resetBasePositionAndOrientation(body, p, hand.pose[3:], physicsClientId=c)
        bullet.resetBaseVelocity(body, hand.velocity, [0, 0, 0], physicsClientId=c)

    def _feel(self) -> None:
        """Measure the tool's force, and notice contacts that must not be."""
        world = self.world
        points = bullet.getContactPoints(world.robot, physicsClientId=world.client)
        self._wrench = self._force.measure(points, self._masses)
        groups = {world.fixed.get(point[2], "") for point in points if point[8] < 0.0}
        touched = sorted(groups - {"", "pedestal"})
        if not touched:
            return
        self._contacts += 1
        if self._exchange is not None and self._told < _CONTACTS_KEPT:
            self._told += 1
            self._exchange.send(Touch(f"{world.time:.3f} s: robot touches {', '.join(touched)}"))

    def _report(self) -> None:
        if self._exchange is None:
            return
        c = self.world.client
        poses = (bullet.getBasePositionAndOrientation(body, physicsClientId=c) for body in self._bodies)
        q, fingers = self.world.arm.angles(), self.world.gripper.fingers()
        self._exchange.send(
            Snapshot(
                self._clock.now(), self.batch, self._signal, self.world.gripper.holding, self._contacts,
                q, fingers, tuple(p + r for p, r in poses),
            )
        )  # fmt: skip


def place(client: int, body: int, ball: Ball) -> None:
    """Put a body where a ball is, at rest."""
    bullet.resetBasePositionAndOrientation(body, ball.pose[:3], ball.pose[3:], physicsClientId=client)
