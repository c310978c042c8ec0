"""The trajectory interface of external control: forwarded points, run one after the other."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

from hil.emulator.interfaces import PERIOD
from hil.emulator.motion.path import Leg
from hil.emulator.urscript.external_state import MULTIPLIER, STOP, Result, Session, scaled
from hil.emulator.urscript.moves import Targets, optimovej, optimovel
from hil.emulator.urscript.robot import Wait, settle, stop
from hil.emulator.urscript.values import Pose, Value

STREAMED = 2**31 - 1
"""Points left while nobody has said yet how many there are."""
_INTEGERS = 21
_PATIENCE = 0.5
"""A point that does not come within this time is missing [s]."""
_NO_WAY = 0.01
"""A first point with time 0 may be this far away [rad]."""
_SPLINE, _CUBIC, _QUINTIC = 51, 1, 2


@dataclass(frozen=True)
class Point:
    """One message.

    Attributes:
        first, second, third: six numbers each; what they mean depends on the kind.
        time: [s]. blend: radius [m]. variant: 1 cubic, 2 quintic. kind: of motion.
    """

    first: list[float]
    second: list[float]
    third: list[float]
    time: float
    blend: float
    variant: int
    kind: int

    @classmethod
    def of(cls, raw: Sequence[int]) -> Point:
        return cls(
            scaled(raw[0:6]), scaled(raw[6:12]), scaled(raw[12:18]),
            raw[18] / MULTIPLIER, raw[19] / MULTIPLIER, raw[19], raw[20],
        )  # fmt: skip

    @property
    def speeds(self) -> tuple[float, float]:
        """Velocity and acceleration of a move."""
        return self.third[0], self.third[1]


def _joints(p: Point, to: Targets, blend: float, pose: bool) -> Leg:
    near = p.second if pose and p.third[2] else None
    return Leg(to.joints((p.first, pose), near), False, *p.speeds, p.time, blend)


def _line(p: Point, to: Targets, blend: float, pose: bool) -> Leg:
    return Leg(to.pose((p.first, pose)), True, *p.speeds, p.time, blend)


def _process(p: Point, to: Targets, blend: float, pose: bool) -> Leg:
    return Leg(to.pose((p.first, pose)), True, *p.speeds, blend=blend)


def _circle(p: Point, to: Targets, via_pose: bool, pose: bool) -> Leg:
    via = to.pose((p.second, via_pose))[:3]
    return Leg(to.pose((p.first, pose)), True, *p.speeds, via=via)


def _swift(p: Point, to: Targets, blend: float, pose: bool, linear: bool) -> Leg:
    v, a = p.speeds
    target: Value = Pose(p.first) if pose else list(p.first)
    if linear:
        return optimovel(to, target, a, v, blend)
    if pose and p.third[2]:
        target = list(to.joints((p.first, True), p.second))
    return optimovej(to, target, a, v, blend)


_MOVES: dict[int, Callable[[Point, Targets, float], Leg]] = {
    0: lambda p, to, r: _joints(p, to, r, False),
    1: lambda p, to, r: _line(p, to, r, True),
    2: lambda p, to, r: _process(p, to, r, True),
    3: lambda p, to, r: _circle(p, to, True, True),
    4: lambda p, to, r: _swift(p, to, r, pose=False, linear=False),
    5: lambda p, to, r: _swift(p, to, r, pose=True, linear=True),
    6: lambda p, to, r: _joints(p, to, r, True),
    7: lambda p, to, r: _line(p, to, r, False),
    8: lambda p, to, r: _process(p, to, r, False),
    9: lambda p, to, r: _circle(p, to, False, False),
    10: lambda p, to, r: _circle(p, to, True, False),
    11: lambda p, to, r: _circle(p, to, False, True),
    12: lambda p, to, r: _swift(p, to, r, pose=True, linear=False),
    13: lambda p, to, r: _swift(p, to, r, pose=False, linear=True),
}
"""By motion type. Names of arcs say the target first: 10, joints and pose, has its via point as a pose."""


def run(s: Session) -> Wait:
    """All points of a trajectory; sends the result at the end."""
    result = yield from _points(s)
    yield from stop(s.mover, STOP, linear=False)
    s.trajectory.send_integer(result)
    s.robot.message(f"Trajectory finished with result {result.name}")


def clear(s: Session) -> Wait:
    """Read what a trajectory that was given up has left in the socket."""
    since = s.robot.now
    while s.left > 0:
        if s.trajectory.integers(_INTEGERS) is not None:
            s.left -= 1
            since = s.robot.now
            continue
        if s.trajectory.lost or s.robot.now - since > _PATIENCE:
            s.left = 0
            return
        yield


def _points(s: Session) -> Generator[None, None, Result]:
    streamed, first = s.streaming, True
    while s.left > 0:
        moving = s.mover.spline_left > 0.0
        point = yield from _next(s, PERIOD if moving else _PATIENCE)
        s.left -= 1
        if point is None:
            if streamed and not s.streaming and s.left < 0:
                s.left = 0  # the end was announced after the last point had been run
                return Result.SUCCESS
            s.robot.message("Receiving trajectory point failed!", 1)
            return Result.FAILURE
        if point.kind == _SPLINE:
            result = yield from _spline(s, point, first)
        else:
            result = yield from _moves(s, point)
        if result is not Result.SUCCESS:
            return result
        first = False
    return Result.SUCCESS


def _next(s: Session, patience: float) -> Generator[None, None, Point | None]:
    since = s.robot.now
    while True:
        raw = s.trajectory.integers(_INTEGERS)
        if raw is not None:
            return Point.of(raw)
        if s.trajectory.lost or s.robot.now - since > patience:
            return None
        if s.streaming is False and s.left <= 0:
            return None
        yield


def _moves(s: Session, point: Point) -> Generator[None, None, Result]:
    """A move, and those after it that it is blended with."""
    to = Targets(s.robot)
    legs: list[Leg] = []
    while True:
        make = _MOVES.get(point.kind)
        if make is None:
            s.robot.message(f"Trajectory point of motion type {point.kind}: not emulated", 1)
            return Result.FAILURE
        blend = point.blend if s.left > 0 else 0.0
        legs.append(make(point, to, blend))
        if blend <= 0.0:
            break
        following = yield from _next(s, _PATIENCE)
        s.left -= 1
        if following is None:
            s.robot.message("Receiving trajectory point failed!", 1)
            return Result.FAILURE
        if following.kind == _SPLINE:
            s.robot.message("A spline after a blended move: not emulated", 1)
            return Result.FAILURE
        point = following
    s.mover.path(legs)
    yield
    yield from settle(s.mover)
    return Result.SUCCESS


def _spline(s: Session, point: Point, first: bool) -> Generator[None, None, Result]:
    if point.variant not in (_CUBIC, _QUINTIC):
        s.robot.message(f"Unknown spline type given: {point.variant}", 1)
        return Result.FAILURE
    mover = s.mover
    if point.time <= 0.0:
        if first and point.time == 0.0 and math.dist(point.first, mover.goal) < _NO_WAY:
            return Result.SUCCESS
        s.robot.message("Spline time shouldn't be zero as it would require infinite velocity", 1)
        return Result.CANCELED
    if not s.feasible(mover.goal, point.first, point.time):
        return Result.CANCELED
    bend = point.third if point.variant == _QUINTIC else None
    last = s.left == 0
    mover.spline(point.first, point.second, bend, point.time, last)
    yield
    while mover.busy and (last or mover.spline_left > PERIOD):
        yield
    return Result.SUCCESS
