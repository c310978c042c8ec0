"""The cell once more, beside the physics: a world whose bodies are put where the plant says they are.

The person lives here, and here the cameras look: both may take their time, which the controller's
loop cannot. Time is wall clock, that of the newest report.
"""

from __future__ import annotations

import numpy as np

from cell.clock import WallClock
from cell.config import CellConfig
from cell.errors import ConfigError
from cell.wire.types import BeltState
from hil.emulator.exchange import Ball, Batch, Hand, Snapshot
from hil.sim.backend import SimBackend
from hil.sim.person.persona import PERSONAS
from hil.sim.physics import bullet
from hil.sim.world import World

_MAX_ONIONS = 15
_CONTACTS_KEPT = 20


class Mirror(World):
    """A `World` that is moved by reports, and never by its own physics.

    Args:
        now: wall clock [s].
    """

    def __init__(
        self, config: CellConfig, seed: int, onions: int, person: str, now: float, *, reference_visuals: bool
    ) -> None:
        self._now = now
        super().__init__(config, seed, onions, reference_visuals=reference_visuals, person=person)

    @property
    def time(self) -> float:
        """Wall clock of the newest report [s]."""
        return self._now

    def follow(self, snapshot: Snapshot, with_onions: bool) -> None:
        """Put everything where the report says it is, and let the person live until then."""
        self._now = max(self._now, snapshot.t)
        self.arm.place(np.array(snapshot.q))
        self.gripper.place(snapshot.fingers, snapshot.holding)
        self.show(snapshot.signal)
        if not with_onions:
            return
        for body, pose in zip(self.onion_bodies, snapshot.onions, strict=False):
            bullet.resetBasePositionAndOrientation(body, pose[:3], pose[3:], physicsClientId=self.client)
        if self.person is not None:
            self.person.step(self.signal)

    def balls(self) -> tuple[Ball, ...]:
        """The onions as the physics needs them, where they lie now."""
        return tuple(
            Ball(onion.mass, onion.collision_radius, self._pose7(body))
            for onion, body in zip(self.onions, self.onion_bodies, strict=True)
        )

    def hand(self, batch: int) -> Hand:
        """What the person holds now."""
        held = None if self.person is None else self.person.agent.held
        if held is None:
            return Hand(self._now, batch, -1, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
        body = self.onion_bodies[held]
        velocity, _ = bullet.getBaseVelocity(body, physicsClientId=self.client)
        return Hand(self._now, batch, held, self._pose7(body), tuple(velocity))

    def _pose7(self, body: int) -> tuple[float, ...]:
        p, q = bullet.getBasePositionAndOrientation(body, physicsClientId=self.client)
        return (*p, *q)


class MirrorBackend(SimBackend):
    """What the simulation's backend does for cameras and truth, around a `Mirror`.

    Attributes:
        batch: number of the present batch, from 1.
    """

    name = "emulated"
    steppable = False

    def __init__(self, config: CellConfig, seed: int, onions: int, person: str) -> None:
        super().__init__(config, seed, onions, person)
        self._clock = WallClock()
        self._number = 0
        self._made = (seed, onions, person)

    @property
    def mirror(self) -> Mirror:
        world = self.world
        assert isinstance(world, Mirror)
        return world

    def renew(self, seed: int, onions: int, persona: str) -> Batch:
        """Build the cell anew with another batch and person; takes seconds.

        Raises:
            ConfigError: it cannot be; the cell is as it was at its beginning then.
        """
        check_surroundings(seed, onions, persona)
        try:
            self._build(seed, onions, persona)
        except ConfigError:
            self._build(*self._made)
            raise
        return self.batch()

    def batch(self) -> Batch:
        """The present batch, for the plant."""
        return Batch(self._number, self.mirror.balls())

    def live(self, snapshot: Snapshot) -> Hand:
        """Follow a report: the person acts, cameras whose time has come expose."""
        mirror = self.mirror
        mirror.follow(snapshot, with_onions=snapshot.batch == self._number)
        self._contact_ticks = snapshot.contacts
        self._expose_due()
        return mirror.hand(self._number)

    def note_contact(self, text: str) -> None:
        """A line for the truth's log of contacts."""
        if len(self._contacts) < _CONTACTS_KEPT:
            self._contacts.append(text)

    def read_belt(self) -> BeltState:
        return BeltState(self.now(), self._number, moving=False, speed=0.0)

    def reset(self, seed: int, onions: int) -> None:
        contacts = self._contacts
        super().reset(seed, onions)
        self._contacts = contacts  # the arm goes on, and so does its count
        self._number += 1

    def _expose_due(self) -> None:
        """A camera whose last picture is still being drawn leaves one out, or it would lag behind."""
        if not any(camera.busy for camera in self._cameras.values() if camera.config.rate > 0.0):
            super()._expose_due()

    def _build(self, seed: int, onions: int, persona: str) -> None:
        self._persona = persona
        self.reset(seed, onions)
        self._made = (seed, onions, persona)

    def _make_world(self, seed: int, onions: int, *, reference_visuals: bool) -> World:
        return Mirror(
            self._config, seed, onions, self._persona, self._clock.now(), reference_visuals=reference_visuals
        )


def check_surroundings(seed: int, onions: int, persona: str) -> None:
    """Raises `ConfigError` for an impossible batch or an unknown persona ("" is nobody)."""
    if not 0 <= seed < 2**63:
        raise ConfigError(f"seed must be from 0 to 2^63 - 1, got {seed}")
    if not 0 <= onions <= _MAX_ONIONS:
        raise ConfigError(f"onions must be from 0 to {_MAX_ONIONS}, got {onions}")
    if persona and persona not in PERSONAS:
        raise ConfigError(f"persona {persona!r} is unknown; legal values: none, {', '.join(PERSONAS)}")
