"""The motion commands of the emulated controller, and the set-points they make.

There is one motion at a time. Moves (movej, movel, movep, movec and paths of them) start at rest:
while another motion runs, it is braked first, and the move begins after it. Everything else takes
over at the present speed. Force mode lies on top of whatever runs.
"""

from __future__ import annotations

from collections.abc import Sequence

from hil.emulator.engine import Engine, Six, out_of_reach, positive, six
from hil.emulator.motion import SOFT, Trouble
from hil.emulator.motion.compliant import ForceTask, Freedrive
from hil.emulator.motion.path import Leg, group
from hil.emulator.motion.pursuit import Pursuit
from hil.emulator.motion.servo import Servo
from hil.emulator.motion.speed import JointSpeed, ToolSpeed
from hil.emulator.motion.spline import Spline
from hil.emulator.motion.stop import JointStop


class Mover(Engine):
    """The commands. Poses are those of the TCP.

    What cannot be done ends in `trouble`. Arguments that are no finite numbers raise `Trouble` at once.
    """

    # -- commands --------------------------------------------------------------------------------------

    def movej(self, q: Six, v: float, a: float, t: float = 0.0, r: float = 0.0) -> None:
        """To joint angles [rad]; v, a of the leading joint [rad/s], [rad/s^2]; see `Leg`."""
        self.path([Leg(six(q), False, v, a, t, r)])

    def movel(self, pose: Six, v: float, a: float, t: float = 0.0, r: float = 0.0) -> None:
        """Straight to a pose; v, a of the TCP [m/s], [m/s^2]."""
        self.path([Leg(six(pose), True, v, a, t, r)])

    def movec(self, via: Six, pose: Six, v: float, a: float) -> None:
        """On a circle through the position of `via` to a pose."""
        self.path([Leg(six(pose), True, v, a, via=six(via)[:3])])

    def path(self, legs: Sequence[Leg]) -> None:
        """One move after the other, with rounded corners where `Leg.blend` asks for them."""
        self._yield()
        self.trouble = ""
        self.leg = 0
        self._legs = tuple(legs)
        first = 0
        for run in group(legs):
            self._queue.append((first, run))
            first += len(run)
        self._update()

    def servoj(self, q: Six, t: float, lookahead: float, gain: float) -> None:
        """Follow a streamed target [rad] for t [s]."""
        target, servo = six(q), self._motion
        if not (isinstance(servo, Servo) and servo.running):
            servo = Servo(self._q, self._qd, self.kinematics.qd_max)
            self._start(servo)
        try:
            servo.command(target, t, lookahead, gain)
        except Trouble as reason:
            self._fail(str(reason))

    def servol(self, pose: Six, t: float, lookahead: float, gain: float) -> None:
        """`servoj` to a pose."""
        near = self._motion.target if isinstance(self._motion, Servo) else self._q
        q = self.ik(pose, near)
        if q is None:
            self._fail(out_of_reach(pose))
        else:
            self.servoj(q, t, lookahead, gain)

    def servoc(self, pose: Six, a: float, v: float) -> None:
        """At constant speed towards a pose that may be changed at any time."""
        target, a, v = six(pose), positive("the acceleration", a), positive("the speed", v)
        if not isinstance(self._motion, Pursuit):
            self._start(Pursuit(self.kinematics, self._tool))
        assert isinstance(self._motion, Pursuit)
        self._motion.command(target, a, v)

    def speedj(self, qd: Six, a: float, t: float = 0.0) -> None:
        """Joint speeds [rad/s] for t [s]; 0: until the next command."""
        target, a = six(qd), positive("the acceleration", a)
        if not isinstance(self._motion, JointSpeed):
            self._start(JointSpeed())
        assert isinstance(self._motion, JointSpeed)
        self._motion.command(target, a, t)

    def speedl(self, xd: Six, a: float, t: float = 0.0) -> None:
        """A twist of the TCP [m/s], [rad/s] for t [s]; 0: until the next command."""
        target, a = six(xd), positive("the acceleration", a)
        if not isinstance(self._motion, ToolSpeed):
            self._start(ToolSpeed(self.kinematics, self._tool))
        assert isinstance(self._motion, ToolSpeed)
        self._motion.command(target, a, t)

    def spline(self, q: Six, qd: Six, qdd: Six | None, t: float, last: bool) -> None:
        """Append a point to the joint spline, or begin one; see `Spline.append`."""
        if not isinstance(self._motion, Spline):
            self._start(Spline(self._q, self._qd))
        assert isinstance(self._motion, Spline)
        self._motion.append(six(q), six(qd), None if qdd is None else six(qdd), t, last)

    def freedrive(self, axes: Sequence[bool], feature: Six | None = None) -> None:
        """Follow the hand along the free axes of a feature (pose in B)."""
        self._start(Freedrive(self.kinematics, self._tool, axes, None if feature is None else six(feature)))

    def force_mode(self, task: ForceTask) -> None:
        """Give way along the compliant axes, until `end_force_mode`."""
        self.force.start(task)
        self._update()

    def end_force_mode(self) -> None:
        """No more; what the arm is doing stops."""
        if self.force.task is not None:
            self.force.end()
            self._start(JointStop(SOFT))

    # -- what runs ----------------------------------------------------------------------------------------

    def waypoint(self) -> list[float]:
        """Pose at which the move under way ends, or where the last one ended, or the set-point's."""
        if not self._legs:
            return self.pose()
        leg = self._legs[min(self.leg, len(self._legs) - 1)]
        if leg.linear:
            return list(leg.target)
        return self.kinematics.pose(leg.target, self.tcp)

    @property
    def reached(self) -> bool:
        """A commanded joint or tool speed is reached."""
        return not isinstance(self._motion, JointSpeed | ToolSpeed) or self._motion.reached

    @property
    def spline_left(self) -> float:
        """Time until the end of the spline that runs [s]; 0 without one."""
        return self._motion.left if isinstance(self._motion, Spline) else 0.0

    @property
    def goal(self) -> list[float]:
        """Joint angles at which a spline ends as far as it is known, or the set-point [rad]."""
        return list(self._motion.end if isinstance(self._motion, Spline) else self._q)
