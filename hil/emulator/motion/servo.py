"""servoj: following a streamed set-point one look-ahead time late."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cell.errors import one_of
from hil.emulator.motion import DT, SOFT, Step, Trouble
from hil.emulator.motion.stop import JointStop

ACCELERATION = 80.0
"""No joint is accelerated more [rad/s^2]; a far target is approached as fast as that permits."""
_PATIENCE = 1.5 * DT
_ROOM = 0.9


class Servo:
    """The controller's filter between `servoj` targets and the joints.

    A critically damped filter of second order whose time constant is half the look-ahead time, and
    a proportional follower with the given gain [1/s] behind it: a ramp comes out look-ahead time
    plus 1 / gain late, with steady speed. With the shortest look-ahead time, 30 ms, and the cycles
    in between, that is the lag measured on real arms (34 ms).

    Args:
        q, qd: where it starts from [rad], [rad/s].
    """

    checked = False

    def __init__(self, q: Sequence[float], qd: Sequence[float], qd_max: Sequence[float]) -> None:
        self._target, self._qd_max = list(q), qd_max
        self._ahead, self._gain = 0.03, 300.0
        self._q, self._qd = list(q), list(qd)
        self._v = list(qd)
        self._behind()
        self._age = self._time = 0.0
        self._stop: JointStop | None = None

    @property
    def target(self) -> list[float]:
        """The last one [rad]."""
        return self._target

    @property
    def running(self) -> bool:
        """Not braking yet because no command came in time."""
        return self._stop is None

    def command(self, q: Sequence[float], t: float, lookahead: float, gain: float) -> None:
        """A new target, for t [s].

        Raises:
            Trouble: the look-ahead time or the gain is out of range.
        """
        if not (0.03 - 1e-9 <= lookahead <= 0.2 + 1e-9 and 100.0 <= gain <= 2000.0):
            legal = ("lookahead_time 0.03..0.2 s", "gain 100..2000")
            raise Trouble(f"servoj: {one_of((lookahead, gain), legal)}")
        if gain != self._gain:
            self._gain = gain
            self._behind()
        self._target, self._time, self._ahead = [float(v) for v in q], t, lookahead
        self._age = 0.0

    def step(self, q: list[float], qd: list[float], scaling: float) -> Step:
        self._age += DT
        if self._stop is None and self._age > self._time + _PATIENCE:
            self._stop = JointStop(SOFT)
        if self._stop is not None:
            return self._stop.step(q, qd, scaling)
        w = 2.0 / self._ahead
        decay, most = math.exp(-w * DT), ACCELERATION * DT
        x, v, out = self._x, self._v, []
        for i, target in enumerate(self._target):
            e, now = x[i] - target, v[i]
            b = now + w * e
            wanted = (now - w * b * DT) * decay
            speed = min(max(wanted, now - most), now + most)
            fastest = min(self._qd_max[i], math.sqrt(2 * _ROOM * ACCELERATION * abs(e)) + most)
            if speed * e < 0.0 and abs(speed) > fastest:  # there must be room to brake before the target
                speed = math.copysign(max(fastest, abs(now) - most), speed)
            x[i] = target + (e + b * DT) * decay if speed == wanted else x[i] + 0.5 * DT * (now + speed)
            v[i] = speed
            out.append(q[i] + self._follow * (x[i] - q[i]))
        self._qd = [(a - b) / DT for a, b in zip(out, q, strict=True)]
        self._q = out
        return list(out), self._qd, True

    def _behind(self) -> None:
        """Put the first filter where it is when the follower behind it moves on as it does."""
        self._follow = 1.0 - math.exp(-self._gain * DT)
        lead = DT * (1.0 / self._follow - 1.0)
        self._x = [a + lead * b for a, b in zip(self._q, self._qd, strict=True)]
