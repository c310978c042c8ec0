"""The motion commands of the emulated controller, and the set-points they make.

There is one motion at a time. Moves (movej, movel, movep, movec and paths of them) start at rest:
while another motion runs, it is braked first, and the move begins after it. Everything else takes
over at the present speed. Force mode lies on top of whatever runs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cell.frames import Array
from hil.emulator.interfaces import ZERO6, Measured, MoverLike
from hil.emulator.kinematics import Kinematics
from hil.emulator.models import Model
from hil.emulator.motion import DT, HARD, SOFT, Motion, Trouble, advance
from hil.emulator.motion.compliant import ForceMode, ForceTask, Freedrive
from hil.emulator.motion.contact import Memory
from hil.emulator.motion.move import JointMove, ToolMove
from hil.emulator.motion.path import Leg, group, joint_run, tool_run
from hil.emulator.motion.pursuit import Pursuit
from hil.emulator.motion.servo import Servo
from hil.emulator.motion.speed import JointSpeed, ToolSpeed
from hil.emulator.motion.spline import Spline
from hil.emulator.motion.stop import JointStop, ToolStop
from hil.emulator.poses import IDENTITY, Frame, frame_of

_SPEED_TOLERANCE = 1.001
Six = Sequence[float] | Array


class Mover(MoverLike):
    """Fulfils `MoverLike` for one arm.

    Commands raise nothing: what cannot be done ends in `trouble`. Poses are those of the TCP.

    Attributes:
        kinematics: of the arm.
        memory: of what was measured.
        force: force mode.
        leg: number of the move under way of the path that was commanded last.
    """

    def __init__(self, model: Model) -> None:
        self.kinematics = Kinematics(model)
        self.memory = Memory()
        self.force = ForceMode()
        self.q: Array = ZERO6
        self.qd: Array = ZERO6
        self.qdd: Array = ZERO6
        self.moving = False
        self.trouble = ""
        self.leg = 0
        self._motion: Motion | None = None
        self._queue: list[tuple[int, tuple[Leg, ...]]] = []
        self._q, self._qd = [0.0] * 6, [0.0] * 6
        self._own, self._own_speed = self._q, self._qd
        """Where the motion would have the arm; the same unless in force mode."""
        self._tcp: Array | None = None
        self._tool: Frame = IDENTITY

    # -- the controller's side ------------------------------------------------------------------------

    def tick(self, scaling: float, measured: Measured) -> None:
        self.memory.add(measured)
        try:
            own, own_speed, going = self._next(scaling)
            q, qd = own, own_speed
            if self.force.task is not None:
                q, qd = self._compliant(own)
            self._check(q, qd)
        except Trouble as reason:
            self._fail(str(reason))
            q, qd, going = JointStop(HARD).step(self._q, self._qd, scaling)
            own, own_speed = q, qd
        self._finish(going, own_speed)
        self._own, self._own_speed = (own, own_speed) if self._motion is not None else (q, own_speed)
        self._set(q, qd)

    def halt(self) -> None:
        self._queue.clear()
        self.force.end()
        if isinstance(self._motion, JointMove | ToolMove):
            self._motion.brake(None)
        elif self._motion is not None or any(self._qd):
            self._motion = JointStop(HARD)
        self._update()

    def reset(self, q: Array) -> None:
        self._own, self._own_speed = [float(v) for v in q], [0.0] * 6
        self._qd = self._own_speed
        self._set(self._own, self._own_speed)
        self._motion, self.trouble, self.leg = None, "", 0
        self._queue.clear()
        self.force.end()
        self._update()

    # -- commands --------------------------------------------------------------------------------------

    def use(self, tcp: Array) -> None:
        """Offset of the TCP in the flange, position and axis-angle (6,), for what is commanded next."""
        if tcp is not self._tcp:
            self._tcp, self._tool = tcp, frame_of(tcp.tolist())

    def pose(self) -> list[float]:
        """Pose of the TCP at the set-point."""
        return self.kinematics.pose(self._q, ZERO6.tolist() if self._tcp is None else self._tcp.tolist())

    def ik(self, pose: Six, near: Six | None = None) -> list[float] | None:
        """Joint angles for a pose, nearest to `near` [rad] or to the set-point; None: out of reach."""
        seed = self._q if near is None else [float(v) for v in near]
        tcp = ZERO6.tolist() if self._tcp is None else self._tcp.tolist()
        return self.kinematics.ik([float(v) for v in pose], tcp, seed)

    def movej(self, q: Six, v: float, a: float, t: float = 0.0, r: float = 0.0) -> None:
        """To joint angles [rad]; v, a of the leading joint [rad/s], [rad/s^2]; see `Leg`."""
        self.path([Leg(_six(q), False, v, a, t, r)])

    def movel(self, pose: Six, v: float, a: float, t: float = 0.0, r: float = 0.0) -> None:
        """Straight to a pose; v, a of the TCP [m/s], [m/s^2]."""
        self.path([Leg(_six(pose), True, v, a, t, r)])

    def movec(self, via: Six, pose: Six, v: float, a: float) -> None:
        """On a circle through the position of `via` to a pose."""
        self.path([Leg(_six(pose), True, v, a, via=_six(via)[:3])])

    def path(self, legs: Sequence[Leg]) -> None:
        """One move after the other, with rounded corners where `Leg.blend` asks for them."""
        self._yield()
        self.trouble = ""
        self.leg = 0
        first = 0
        for run in group(legs):
            self._queue.append((first, run))
            first += len(run)
        self._update()

    def servoj(self, q: Six, t: float, lookahead: float, gain: float) -> None:
        """Follow a streamed target [rad] for t [s]."""
        servo = self._motion
        if not (isinstance(servo, Servo) and servo.running):
            servo = Servo(self._q, self._qd, self.kinematics.qd_max)
            self._start(servo)
        try:
            servo.command(_six(q), t, lookahead, gain)
        except Trouble as reason:
            self._fail(str(reason))

    def servol(self, pose: Six, t: float, lookahead: float, gain: float) -> None:
        """`servoj` to a pose."""
        near = self._motion.target if isinstance(self._motion, Servo) else self._q
        q = self.ik(pose, near)
        if q is None:
            self._fail(_out_of_reach(pose))
        else:
            self.servoj(q, t, lookahead, gain)

    def servoc(self, pose: Six, a: float, v: float) -> None:
        """At constant speed towards a pose that may be changed at any time."""
        if not isinstance(self._motion, Pursuit):
            self._start(Pursuit(self.kinematics, self._tool))
        assert isinstance(self._motion, Pursuit)
        self._motion.command(_six(pose), a, v)

    def speedj(self, qd: Six, a: float, t: float = 0.0) -> None:
        """Joint speeds [rad/s] for t [s]; 0: until the next command."""
        if not isinstance(self._motion, JointSpeed):
            self._start(JointSpeed())
        assert isinstance(self._motion, JointSpeed)
        self._motion.command(_six(qd), a, t)

    def speedl(self, xd: Six, a: float, t: float = 0.0) -> None:
        """A twist of the TCP [m/s], [rad/s] for t [s]; 0: until the next command."""
        if not isinstance(self._motion, ToolSpeed):
            self._start(ToolSpeed(self.kinematics, self._tool))
        assert isinstance(self._motion, ToolSpeed)
        self._motion.command(_six(xd), a, t)

    def spline(self, q: Six, qd: Six, qdd: Six | None, t: float, last: bool) -> None:
        """Append a point to the joint spline, or begin one from rest; see `Spline.append`."""
        if not isinstance(self._motion, Spline):
            self._start(Spline(self._q))
        assert isinstance(self._motion, Spline)
        self._motion.append(_six(q), _six(qd), None if qdd is None else _six(qdd), t, last)

    def freedrive(self, axes: Sequence[bool], feature: Six | None = None) -> None:
        """Follow the hand along the free axes of a feature (pose in B)."""
        self._start(Freedrive(self.kinematics, self._tool, axes, None if feature is None else _six(feature)))

    def force_mode(self, task: ForceTask) -> None:
        """Give way along the compliant axes, until `end_force_mode`."""
        self.force.start(task)
        self._update()

    def end_force_mode(self) -> None:
        """No more; what the arm is doing stops."""
        if self.force.task is not None:
            self.force.end()
            self._start(JointStop(SOFT))

    def stopj(self, a: float) -> None:
        """Brake; a of the leading joint [rad/s^2]."""
        self._stop(a, linear=False)

    def stopl(self, a: float) -> None:
        """Brake; a of the TCP [m/s^2]."""
        self._stop(a, linear=True)

    # -- what runs ----------------------------------------------------------------------------------------

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

    def _next(self, scaling: float) -> tuple[list[float], list[float], bool]:
        if self._motion is None and self._queue:
            self._begin()
        if self._motion is None:
            return self._own, [0.0] * 6, False
        if isinstance(self._motion, Freedrive):
            self._motion.wrench = self.memory.wrench()
        out = self._motion.step(self._own, self._own_speed, scaling)
        if isinstance(self._motion, JointMove | ToolMove):
            self.leg = self._first + self._motion.leg
        return out

    def _begin(self) -> None:
        """The next run of the path; the arm is at rest."""
        self._first, legs = self._queue.pop(0)
        k = self.kinematics
        if not legs[0].linear:
            self._motion = JointMove(k, joint_run(k, self._q, legs, self._tool), self._tool)
            return
        for leg in legs:
            if self.ik(leg.target) is None:
                raise Trouble(_out_of_reach(leg.target))
        self._motion = ToolMove(k, tool_run(k.tool(self._q, self._tool), legs), self._tool)

    def _finish(self, going: bool, qd: Sequence[float]) -> None:
        if not going and self._motion is not None:
            self._motion = JointStop(SOFT) if any(qd) else None
        self._update()

    def _compliant(self, own: list[float]) -> tuple[list[float], list[float]]:
        speed = [(a - b) / DT for a, b in zip(own, self._own, strict=True)]
        speed = self.force.blend(self.kinematics, self._tool, self._q, speed, self.memory.wrench())
        return advance(self._q, speed, speed), speed

    def _set(self, q: list[float], qd: list[float]) -> None:
        new = np.array(qd)
        self.qdd = (new - self.qd) / DT
        self._q, self._qd = q, qd
        self.q, self.qd = np.array(q), new

    def _check(self, q: Sequence[float], qd: Sequence[float]) -> None:
        checked = self._motion is not None and self._motion.checked and self.force.task is None
        for i in range(6):
            speed, limit = qd[i], self.kinematics.qd_max[i]
            if not abs(speed) <= limit * _SPEED_TOLERANCE:
                raise Trouble(
                    f"joint {i + 1} would turn at {speed:.2f} rad/s; the limit is {limit:.2f} rad/s"
                )
            ahead = q[i] + speed * abs(speed) / (2 * HARD)
            if not checked and abs(ahead) > self.kinematics.q_max[i] and ahead * speed > 0.0:
                raise Trouble(f"joint {i + 1} would pass its limit of {self.kinematics.q_max[i]:.3f} rad")

    def _fail(self, reason: str) -> None:
        self._queue.clear()
        self.force.end()
        self._motion = JointStop(HARD)
        self.trouble = self.trouble or reason
        self._update()

    def _start(self, motion: Motion) -> None:
        """Take over at the present speed."""
        self._queue.clear()
        self.trouble = ""
        self._motion = motion
        self._own, self._own_speed = self._q, self._qd
        self._update()

    def _yield(self) -> None:
        """Brake for a move that is to come."""
        self._queue.clear()
        if isinstance(self._motion, JointMove | ToolMove):
            self._motion.brake(self._motion.acceleration)
        elif any(self._qd):
            self._motion = JointStop(SOFT)
        else:
            self._motion = None

    def _stop(self, a: float, linear: bool) -> None:
        self._queue.clear()
        motion = self._motion
        if isinstance(motion, JointMove | ToolMove):
            try:
                motion.brake(a / max(motion.per_length(self._q, linear), 1e-6))
            except Trouble:
                motion.brake(None)
        elif motion is not None or any(self._qd):
            self._motion = ToolStop(self.kinematics, self._tool, a) if linear else JointStop(a)
        self._update()

    def _update(self) -> None:
        self.moving = self._motion is not None or bool(self._queue) or self.force.task is not None


def _six(values: Six) -> tuple[float, ...]:
    out = tuple(float(v) for v in values)
    if len(out) != 6:
        raise ValueError(f"6 numbers are needed, got {len(out)}")
    return out


def _out_of_reach(pose: Six) -> str:
    x, y, z = (float(v) for v in pose[:3])
    return f"the pose at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of reach"
