"""Runs motions: one at a time, moves one after the other, force mode on top, limits always checked."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cell.frames import Array
from hil.emulator.interfaces import ZERO6, Measured, MoverLike
from hil.emulator.kinematics import Kinematics, tool_speed
from hil.emulator.models import Model
from hil.emulator.motion import DT, HARD, SOFT, Motion, Trouble, advance
from hil.emulator.motion.compliant import ForceMode, Freedrive
from hil.emulator.motion.contact import Memory
from hil.emulator.motion.move import JointMove, ToolMove
from hil.emulator.motion.path import Leg, joint_run, tool_run
from hil.emulator.motion.stop import JointStop, ToolStop
from hil.emulator.poses import IDENTITY, Frame, frame_of

_SPEED_TOLERANCE = 1.001
Six = Sequence[float] | Array


class Engine(MoverLike):
    """Fulfils `MoverLike` for one arm, without any commands but stops.

    Attributes:
        kinematics: of the arm.
        memory: of what was measured.
        force: force mode.
        tcp: offset of the TCP in the flange, see `use`.
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
        self._legs: tuple[Leg, ...] = ()
        self._q, self._qd = [0.0] * 6, [0.0] * 6
        self._own, self._own_speed = self._q, self._qd
        """Where the motion would have the arm; the same unless in force mode."""
        self.tcp = [0.0] * 6
        self._offset: Array | None = None
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

    # -- the tool ---------------------------------------------------------------------------------

    def use(self, tcp: Array) -> None:
        """Offset of the TCP in the flange, position and axis-angle (6,), for what is commanded next."""
        if tcp is not self._offset:
            self._offset, self.tcp, self._tool = tcp, tcp.tolist(), frame_of(tcp.tolist())

    def pose(self) -> list[float]:
        """Pose of the TCP at the set-point."""
        return self.kinematics.pose(self._q, self.tcp)

    def ik(self, pose: Six, near: Six | None = None) -> list[float] | None:
        """Joint angles for a pose, nearest to `near` [rad] or to the set-point; None: out of reach."""
        seed = self._q if near is None else [float(v) for v in near]
        if not all(map(math.isfinite, (*pose, *seed))):
            return None
        return self.kinematics.ik([float(v) for v in pose], self.tcp, seed)

    def tool_velocity(self, measured: Measured) -> list[float]:
        """Measured twist of the TCP, axes of B [m/s], [rad/s]."""
        _, J = self.kinematics.jacobian(measured.q.tolist(), self._tool)
        return tool_speed(J, measured.qd.tolist())

    # -- stops ------------------------------------------------------------------------------------

    def stopj(self, a: float) -> None:
        """Brake; a of the leading joint [rad/s^2]."""
        self._stop(positive("the deceleration", a), linear=False)

    def stopl(self, a: float) -> None:
        """Brake; a of the TCP [m/s^2]."""
        self._stop(positive("the deceleration", a), linear=True)

    @property
    def busy(self) -> bool:
        """A motion is under way or to come; force mode alone is none."""
        return self._motion is not None or bool(self._queue)

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
                raise Trouble(out_of_reach(leg.target))
        self._motion = ToolMove(k, tool_run(k.tool(self._q, self._tool), legs), self._tool)

    def _finish(self, going: bool, qd: Sequence[float]) -> None:
        if not going and self._motion is not None:
            self._motion = JointStop(SOFT) if any(qd) else None
        self._update()

    def _compliant(self, own: list[float]) -> tuple[list[float], list[float]]:
        own_speed = [(a - b) / DT for a, b in zip(own, self._own, strict=True)]
        middle = [0.5 * (a + b) for a, b in zip(own, self._own, strict=True)]
        wrench = self.memory.wrench()
        speed = self.force.blend(self.kinematics, self._tool, self._q, (middle, own_speed), wrench)
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
        self.moving = self.busy or self.force.task is not None


def six(values: Six) -> tuple[float, ...]:
    """Six finite numbers, or `Trouble`."""
    out = tuple(float(v) for v in values)
    if len(out) != 6 or not all(map(math.isfinite, out)):
        raise Trouble(f"6 finite numbers are needed, got {out!r:.100}")
    return out


def positive(what: str, value: float) -> float:
    """A finite number above 0, or `Trouble`."""
    if not 0.0 < value < math.inf:
        raise Trouble(f"{what} must be a number above 0, got {value:g}")
    return value


def out_of_reach(pose: Six) -> str:
    """The sentence for it."""
    x, y, z = (float(v) for v in pose[:3])
    return f"the pose at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of reach"
