"""The PyBullet client: imported and spoken to quietly, with bit-reproducible settings.

PyBullet prints a banner on import and warnings from C when it loads a URDF; both would end
up in the command line's JSON, so they are caught at file-descriptor level.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def quiet() -> Iterator[None]:
    """Send the process's stdout and stderr to the null device at descriptor level."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = [os.dup(1), os.dup(2)]
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 1)
        os.dup2(null, 2)
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for target, descriptor in zip((1, 2), saved, strict=True):
            os.dup2(descriptor, target)
            os.close(descriptor)
        os.close(null)


with quiet():
    import pybullet

bullet: Any = pybullet
"""The PyBullet module."""

_FRICTION_ERP = 0.05
"""Bullet's 0.2 pulls a held onion back into place within a step and jerks the wrist."""


def connect(time_step: float) -> int:
    """A fresh physics world with gravity and deterministic contact order; returns its client id.

    Args:
        time_step: physics step [s].
    """
    client: int = bullet.connect(bullet.DIRECT)
    bullet.setGravity(0, 0, -9.81, physicsClientId=client)
    bullet.setPhysicsEngineParameter(
        fixedTimeStep=time_step,
        numSolverIterations=50,
        numSubSteps=0,
        deterministicOverlappingPairs=1,
        frictionERP=_FRICTION_ERP,
        physicsClientId=client,
    )
    return client
