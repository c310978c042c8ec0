"""Waypoints to a path: which of them are passed in one go, and how round the corners are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from hil.emulator.kinematics import Kinematics
from hil.emulator.motion import Trouble
from hil.emulator.motion.geometry import JointCorner, JointLine, ToolArc, ToolCorner, ToolLine
from hil.emulator.motion.profile import Corner, Stretch, TimeLaw, for_duration
from hil.emulator.poses import Frame, Vector, frame_of

_SHORTEST = 1e-7
"""Shorter ways are none [rad], [m]."""


@dataclass(frozen=True)
class Leg:
    """One move of a program.

    Attributes:
        target: joint angles (6,) [rad]; of a tool move the pose of the TCP (6,).
        linear: a tool move.
        speed, acceleration: of the leading joint [rad/s], [rad/s^2], or of the TCP [m/s], [m/s^2].
        duration: if positive, it is to take this long [s], and the speed is not heeded.
        blend: radius of the corner at its end [m].
        via: a point (3,) [m] that a tool move passes on a circle; empty: straight.
    """

    target: tuple[float, ...]
    linear: bool
    speed: float
    acceleration: float
    duration: float = 0.0
    blend: float = 0.0
    via: tuple[float, ...] = ()


T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class Piece(Protocol[T_co]):
    """A line, a corner or an arc.

    Attributes:
        length: of path.
    """

    length: float

    def at(self, x: float) -> tuple[T_co, list[float]]:
        """The place at path length x from its start, and its change per path length, shape (6,)."""
        ...


@dataclass(frozen=True)
class Part(Generic[T_co]):
    """A piece of a run: where it begins on the run, where on itself, and the leg it belongs to."""

    start: float
    piece: Piece[T_co]
    offset: float
    leg: int


@dataclass(frozen=True)
class Run(Generic[T_co]):
    """Legs that are passed without stopping, in joint or in tool space.

    Attributes:
        parts: in order. law: when it is where. end: of the path.
        acceleration: of its last leg, of path.
    """

    parts: tuple[Part[T_co], ...]
    law: TimeLaw
    end: T_co
    acceleration: float


def group(legs: Sequence[Leg]) -> list[tuple[Leg, ...]]:
    """Legs passed in one go: a corner is rounded between moves of one kind, other waypoints are stops."""
    out: list[list[Leg]] = []
    for leg in legs:
        last = out[-1][-1] if out else None
        if last and last.blend > 0.0 and last.linear == leg.linear and not (last.via or leg.via):
            out[-1].append(leg)
        else:
            out.append([leg])
    return [tuple(run) for run in out]


def joint_run(
    kinematics: Kinematics, q: Sequence[float], legs: Sequence[Leg], tool: Frame
) -> Run[list[float]]:
    """Through joint angles, from q [rad]. Speeds are capped where a joint would be too fast.

    Raises:
        Trouble: a target lies outside the joint limits, or a speed is none.
    """
    lines: list[JointLine] = []
    for leg in legs:
        for i, (angle, limit) in enumerate(zip(leg.target, kinematics.q_max, strict=True)):
            if not abs(angle) <= limit + 1e-9:
                raise Trouble(
                    f"the move's target for joint {i + 1} is {angle:.3f} rad; the limit is {limit:.3f} rad"
                )
        lines.append(JointLine(q, leg.target))
        q = leg.target
    corners: list[JointCorner | None] = []
    for before, after, leg in zip(lines, lines[1:], legs, strict=False):
        cut = _joint_cut(kinematics, before, after, leg, tool)
        corners.append(JointCorner(before, after, cut) if cut > 0.0 else None)
    caps = [
        min((m / abs(r) for m, r in zip(kinematics.qd_max, line.rate, strict=True) if r), default=math.inf)
        for line in lines
    ]
    limits = [_limits(leg, line.length, cap) for leg, line, cap in zip(legs, lines, caps, strict=True)]
    return _joined(lines, corners, limits, [float(v) for v in q])


def tool_run(frame: Frame, legs: Sequence[Leg]) -> Run[Frame]:
    """Through poses of the TCP, from a frame.

    Raises:
        Trouble: an arc or a speed that is none.
    """
    lines: list[ToolLine | ToolArc] = []
    end = frame
    for leg in legs:
        end = frame_of(leg.target)
        if leg.via:
            via: Vector = (leg.via[0], leg.via[1], leg.via[2])
            try:
                lines.append(ToolArc(frame, via, end))
            except ValueError as reason:
                raise Trouble(f"circular move: {reason}") from None
        else:
            lines.append(ToolLine(frame, end))
        frame = end
    corners: list[ToolCorner | None] = []
    for before, after, leg in zip(lines, lines[1:], legs, strict=False):
        cut = min(leg.blend, 0.5 * before.length, 0.5 * after.length)
        if cut > _SHORTEST and isinstance(before, ToolLine) and isinstance(after, ToolLine):
            corners.append(ToolCorner(before, after, cut))
        else:
            corners.append(None)
    limits = [_limits(leg, line.length, math.inf) for leg, line in zip(legs, lines, strict=True)]
    return _joined(lines, corners, limits, end)


class _Corner(Piece[T_co], Protocol[T_co]):
    bend: float


def _joined(
    lines: Sequence[Piece[T]],
    corners: Sequence[_Corner[T] | None],
    limits: Sequence[tuple[float, float]],
    end: T,
) -> Run[T]:
    """One run of lines with rounded corners between them; `limits`: speed, acceleration of each line."""
    cuts = [0.0, *(c.length / 2 if c else 0.0 for c in corners), 0.0]
    stretches: list[Stretch] = []
    rounds: list[Corner] = []
    parts: list[Part[T]] = []
    start = 0.0
    for k, line in enumerate(lines):
        straight = line.length - cuts[k] - cuts[k + 1]
        stretches.append(Stretch(straight, *limits[k]))
        parts.append(Part(start, line, cuts[k], k))
        start += straight
        if k == len(corners):
            break
        corner = corners[k]
        if corner is None:
            rounds.append(Corner(0.0, 0.0))
            continue
        speed = min(limits[k][0], limits[k + 1][0])
        if corner.bend > 0.0:
            a = min(limits[k][1], limits[k + 1][1])
            speed = min(speed, math.sqrt(a * corner.length / corner.bend))
        rounds.append(Corner(corner.length, speed))
        parts.append(Part(start, corner, 0.0, k + 1))
        start += corner.length
    return Run(tuple(parts), TimeLaw(stretches, rounds), end, limits[-1][1])


def _limits(leg: Leg, length: float, cap: float) -> tuple[float, float]:
    """Speed and acceleration of path for one leg."""
    speed, acceleration = leg.speed, leg.acceleration
    if leg.duration > 0.0 and length > _SHORTEST:
        speed, acceleration = for_duration(length, acceleration, leg.duration)
    if not (0.0 < speed < math.inf and 0.0 < acceleration < math.inf):
        raise Trouble(f"a move needs a speed and an acceleration above 0, got {speed:g} and {acceleration:g}")
    return min(speed, cap), acceleration


def _joint_cut(kinematics: Kinematics, before: JointLine, after: JointLine, leg: Leg, tool: Frame) -> float:
    """Path length on both sides of a waypoint at which the TCP is `leg.blend` away from it."""
    longest = 0.5 * min(before.length, after.length)
    if leg.blend <= _SHORTEST or longest <= _SHORTEST:
        return 0.0
    corner = kinematics.tool(leg.target, tool)[0]
    cut = longest
    for line, sign in ((before, -1.0), (after, 1.0)):
        x = min(longest, 0.1)
        for _ in range(3):  # the way of the TCP is nearly straight on this scale
            q = [a + sign * x * r for a, r in zip(leg.target, line.rate, strict=True)]
            away = math.dist(kinematics.tool(q, tool)[0], corner)
            x = min(longest, x * leg.blend / away) if away > _SHORTEST else longest
        cut = min(cut, x)
    return cut
