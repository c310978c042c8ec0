"""Executes timed trajectories: interpolation, seams, and stopping on the path. Pure, no I/O.

The running trajectory is followed by a path clock tau that normally keeps real time. A stop, or
a lower speed scaling of the controller, slows that clock down: position stays on the path
(q = q(tau)), speed is rate * q'(tau), and each tick takes the rate nearest to the wanted one
whose change of joint speeds the acceleration limits allow. A seam is a place on the path, not
a time of day: a replacement announced before the path clock was slowed is met all the same.
"""

from __future__ import annotations

import math

import numpy as np

from cell.errors import RefusedError
from cell.frames import Array
from cell.limits import Limits, RefusalCode, check_trajectory, hermite
from cell.wire.types import Trajectory

_START_TOLERANCE = 0.02
"""A motion from rest may start this far from set-point and measured joints [rad]."""
_SEAM_POSITION, _SEAM_SPEED = 1e-3, 1e-2
"""How well a replacement must match the running trajectory [rad], [rad/s]."""
_REST_SPEED = 0.05
"""Slower joints count as resting when the set-point is put where they are [rad/s]."""
_CANDIDATES = 33
_MAX_RATE_CHANGE = 25.0
"""Fastest change of the path clock's rate [1/s]."""
_SAME_TIME = 1e-9
"""Times nearer than this are one [s]."""


class Executor:
    """One arm's trajectory execution.

    Args:
        limits: of the arm. period: of the control loop [s]. q: joint angles at rest (6,) [rad].

    Attributes:
        q, qd: present set-point, shape (6,) [rad], [rad/s].
        trajectory_id: of the running trajectory, or of the last one; 0 before the first.
        progress: 0..1 along it, in time.
        stopped: a stop is latched and the arm has come to rest on its path.
        stop_reason: why; set as soon as the stop begins, empty after `resume`.
    """

    def __init__(self, limits: Limits, period: float, q: Array) -> None:
        self._limits, self._period = limits, period
        self._running: Trajectory | None = None
        self._next: Trajectory | None = None
        self._seam = 0.0
        self._tau = 0.0
        self._rate = 1.0
        self._last_id = 0
        self._stopping = False
        self.q, self.qd = np.array(q, float), np.zeros(6)
        self.trajectory_id = 0
        self.stopped = False
        self.stop_reason = ""
        self.progress = 0.0

    @property
    def moving(self) -> bool:
        """A trajectory is being executed or braked."""
        return self._running is not None

    def accept(self, trajectory: Trajectory, now: float, q: Array) -> None:
        """Take a trajectory: at once from rest (start 0), or as a replacement at a seam.

        A second replacement takes the place of the first one that still waits. Measured speed is
        not asked for: the joints follow a resting set-point with a lag, and still move a little
        when the next motion may begin.

        Args:
            now: node time [s]. q: measured joints (6,) [rad].

        Raises:
            RefusedError: it is late, breaks a limit, does not fit what the arm does, or a stop
                is latched.
        """
        if self.stop_reason:
            raise _refused(RefusalCode.STOPPED, f"{self.stop_reason}; send resume first")
        if not (math.isfinite(trajectory.start) and math.isfinite(trajectory.expires)):
            raise _refused(RefusalCode.NOT_FINITE, "start and expiry must be finite times")
        if now > trajectory.expires:
            raise _refused(RefusalCode.STALE, f"it expired {now - trajectory.expires:.3f} s ago")
        if trajectory.id <= self._last_id:
            raise _refused(
                RefusalCode.STALE, f"id {trajectory.id} is not above the last one, {self._last_id}"
            )
        check_trajectory(trajectory, self._limits)
        if trajectory.start != 0.0:
            seam = self._check_seam(trajectory, now)
            self._next, self._seam = trajectory, seam
        else:
            self._check_start(trajectory, q)
            self._running, self._tau, self._rate = trajectory, 0.0, 1.0
            self.trajectory_id, self.progress = trajectory.id, 0.0
        self._last_id = trajectory.id

    def stop(self, reason: str) -> None:
        """Brake on the path and latch; when a stop is latched already its reason stands."""
        if not self.stop_reason:
            self.stop_reason = reason or "stopped"
            self._next = None
            self._stopping = self.moving
            self.stopped = not self.moving

    def resume(self, q: Array, qd: Array) -> None:
        """Lift a latched stop; the set-point becomes the measured joints. Starts no motion.

        Args:
            q, qd: measured joints, shape (6,) [rad], [rad/s].

        Raises:
            RefusedError: the arm is still braking, or its joints have not come to rest yet.
        """
        if self._stopping:
            raise _refused(RefusalCode.STOPPED, "the arm is still braking")
        if not self.stopped:
            return
        fastest = float(np.abs(qd).max())
        if fastest > _REST_SPEED:
            raise _refused(RefusalCode.STOPPED, f"the joints still move at {fastest:.3f} rad/s")
        self.stopped, self.stop_reason = False, ""
        self.q, self.qd = np.array(q, float), np.zeros(6)
        self.trajectory_id, self.progress = 0, 0.0

    def forget_ids(self) -> None:
        """Another commander takes over: its ids rise from where it likes."""
        self._last_id = 0

    def tick(self, now: float, speed_scaling: float = 1.0) -> tuple[Array, Array]:
        """Set-point q [rad], qd [rad/s] for the end of the period that starts at `now` [s].

        Args:
            speed_scaling: the controller's own ratio 0..1; the path clock follows it.
        """
        del now  # the path clock counts periods, so that it stands still when the loop does
        if self._running is not None:
            scaling = float(np.clip(speed_scaling, 0.0, 1.0)) if math.isfinite(speed_scaling) else 0.0
            self._advance(self._running, 0.0 if self._stopping else scaling)
        return self.q, self.qd

    # -- internals ------------------------------------------------------------------------------

    def _advance(self, running: Trajectory, target: float) -> None:
        if self._rate == target == 1.0:
            self._tau += self._period
            self.q, self.qd = self._path(running, self._tau)
        else:
            self._rate, self._tau, self.q, self.qd = self._change_rate(running, target)
        if self._next is not None and self._tau >= self._seam - _SAME_TIME:
            running = self._running = self._next
            self._tau, self._next = max(0.0, self._tau - self._seam), None
            self.trajectory_id = running.id
        duration = float(running.times[-1])
        self.progress = min(1.0, self._tau / duration)
        if self._tau >= duration - _SAME_TIME and self._next is None:
            self.q, self.progress = running.q[-1].copy(), 1.0
            self._end()
        elif self._stopping and self._rate == 0.0:
            self._end()

    def _end(self) -> None:
        self._running = None
        self.qd = np.zeros(6)
        if self._stopping:
            self._stopping, self.stopped = False, True

    def _path(self, running: Trajectory, tau: float) -> tuple[Array, Array]:
        """q [rad] and dq/dtau [rad/s] at path time tau [s], beyond a seam that waits too."""
        if self._next is not None and tau >= self._seam - _SAME_TIME:
            running, tau = self._next, max(0.0, tau - self._seam)
        q, slope, _ = hermite(running.times, running.q, running.qd, tau)
        return q, slope

    def _change_rate(self, running: Trajectory, target: float) -> tuple[float, float, Array, Array]:
        """The rate nearest to `target` whose change of joint speeds the limits allow."""
        step = _MAX_RATE_CHANGE * self._period
        wanted = float(np.clip(target, self._rate - step, self._rate + step))
        best: tuple[float, tuple[float, float, Array, Array]] | None = None
        for share in np.linspace(0.0, 1.0, _CANDIDATES):
            rate = float(wanted + share * (self._rate - wanted))
            rate = 0.0 if rate < 1e-3 and target == 0.0 else rate
            tau = self._tau + 0.5 * (self._rate + rate) * self._period
            q, slope = self._path(running, tau)
            qd = rate * slope
            excess = self._excess(q, qd)
            choice = (rate, tau, q, qd)
            if excess <= 1.0:
                return choice
            if best is None or excess < best[0]:
                best = (excess, choice)
        assert best is not None
        return best[1]

    def _excess(self, q: Array, qd: Array) -> float:
        """Acceleration needed to get from the present set-point to this one, as share of the limit.

        The speeds alone do not say it: where the path switches from accelerating to braking within
        the period, the way between them must fit, too.
        """
        rise = np.abs(qd - self.qd) / self._period
        skew = np.abs((q - self.q) / self._period - 0.5 * (self.qd + qd)) / self._period
        needed = 2 * skew + np.sqrt(4 * skew**2 + rise**2)
        return float((needed / self._limits.qdd_max).max())

    def _check_start(self, trajectory: Trajectory, q: Array) -> None:
        """A motion from rest must begin where the arm is, and at rest."""
        if self.moving:
            raise _refused(RefusalCode.SEAM, "the arm is moving; give the start time of a seam")
        for what, at in (("set-point", self.q), ("measured position", q)):
            gap = float(np.abs(trajectory.q[0] - at).max())
            if not gap <= _START_TOLERANCE:
                raise _refused(RefusalCode.SEAM, f"it starts {gap:.3f} rad away from the arm's {what}")
        if np.abs(trajectory.qd[0]).max() > 1e-6:
            raise _refused(RefusalCode.SEAM, "a motion from rest must start at rest")

    def _check_seam(self, trajectory: Trajectory, now: float) -> float:
        """Path time of the seam: where the running trajectory will be when the new one starts."""
        if self._running is None:
            raise _refused(RefusalCode.SEAM, "nothing is running; a motion from rest has start 0")
        if self._rate != 1.0:
            raise _refused(RefusalCode.SEAM, "the path clock is slowed down; no seam can be met")
        if trajectory.start < now:
            raise _refused(RefusalCode.STALE, f"its start lies {now - trajectory.start:.3f} s in the past")
        tau = self._tau + trajectory.start - now
        q, qd, _ = hermite(self._running.times, self._running.q, self._running.qd, tau)
        gap = float(np.abs(trajectory.q[0] - q).max())
        jump = float(np.abs(trajectory.qd[0] - qd).max())
        if gap > _SEAM_POSITION or jump > _SEAM_SPEED:
            raise _refused(
                RefusalCode.SEAM,
                f"at its start it is {gap:.4f} rad and {jump:.4f} rad/s off the running trajectory; "
                f"at most {_SEAM_POSITION} rad and {_SEAM_SPEED} rad/s are allowed",
            )
        return tau


def _refused(code: RefusalCode, reason: str) -> RefusedError:
    return RefusedError(code.value, reason)
