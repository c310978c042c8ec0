"""What the arm may do: limits, forward kinematics, interpolation, and the check of a trajectory.

The node refuses by these rules and the planner plans by them, so both use this module. The
kinematics is that of the published Denavit-Hartenberg parameters (urdf/SOURCES.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from cell.config import CellConfig
from cell.errors import RefusedError
from cell.frames import Array
from cell.wire.types import Trajectory

DH_A = np.array([0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0])
DH_D = np.array([0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921])
DH_ALPHA = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0])
"""Denavit-Hartenberg parameters of the UR3e: a [m], d [m], alpha [rad], shape (6,)."""

Q_MAX = np.array([2 * np.pi, 2 * np.pi, np.pi, 2 * np.pi, 2 * np.pi, 2 * np.pi])
"""Largest joint angle either way [rad], shape (6,)."""
QD_MAX = np.array([np.pi, np.pi, np.pi, 2 * np.pi, 2 * np.pi, 2 * np.pi])
"""Largest joint speed [rad/s], shape (6,)."""

MAX_POINTS = 20_000
"""Most points of one trajectory."""
MAX_DURATION = 120.0
"""Longest trajectory [s]."""
_SPEED_TOLERANCE = 1.02
_ACCELERATION_TOLERANCE = 1.02
"""For rounding on the wire; plans keep 5 % below the limits."""
_SHORT = 2.5
"""Segments up to this many control periods are followed by one or two set-points."""


class RefusalCode(StrEnum):
    """Why the node refuses a command."""

    DECODE = "decode"
    STALE = "stale"
    LEASE = "lease"
    STOPPED = "stopped"
    SEAM = "seam"
    SHAPE = "shape"
    NOT_FINITE = "not_finite"
    NOT_AT_REST = "not_at_rest"
    JOINT_LIMIT = "joint_limit"
    VELOCITY_LIMIT = "velocity_limit"
    ACCELERATION_LIMIT = "acceleration_limit"
    TCP_SPEED = "tcp_speed"
    RANGE = "range"
    BUSY = "busy"
    UNSUPPORTED = "unsupported"
    BACKEND = "backend"


@dataclass(frozen=True)
class Limits:
    """Limits of one cell's arm.

    Attributes:
        q_max, qd_max, qdd_max: shape (6,) [rad], [rad/s], [rad/s^2].
        tcp_speed: largest TCP speed in any mode [m/s].
        gripper_length: flange to TCP [m].
        control_period: of the node's executor [s].
    """

    q_max: Array
    qd_max: Array
    qdd_max: Array
    tcp_speed: float
    gripper_length: float
    control_period: float = 0.008

    @classmethod
    def from_config(cls, config: CellConfig) -> Limits:
        """Limits of the cell that `config` describes."""
        return cls(
            q_max=Q_MAX.copy(),
            qd_max=QD_MAX.copy(),
            qdd_max=np.full(6, config.arm.max_acceleration),
            tcp_speed=config.motion.industrial_speed,
            gripper_length=config.gripper.length,
            control_period=config.arm.control_period,
        )


def link_frames(q: Array) -> Array:
    """DH frames 1..6 in the world, shape (N, 6, 4, 4), for joint angles q (N, 6) [rad]."""
    q = np.atleast_2d(np.asarray(q, dtype=float))
    X = np.zeros((len(q), 4, 4))
    X[:, 0, 0] = X[:, 1, 1] = -1.0  # X_WB: the controller's base is turned by pi about z
    X[:, 2, 2] = X[:, 3, 3] = 1.0
    out = np.empty((len(q), 6, 4, 4))
    for i in range(6):
        c, s = np.cos(q[:, i]), np.sin(q[:, i])
        ca, sa = np.cos(DH_ALPHA[i]), np.sin(DH_ALPHA[i])
        A = np.zeros((len(q), 4, 4))
        A[:, 0, 0], A[:, 0, 1], A[:, 0, 2], A[:, 0, 3] = c, -s * ca, s * sa, DH_A[i] * c
        A[:, 1, 0], A[:, 1, 1], A[:, 1, 2], A[:, 1, 3] = s, c * ca, -c * sa, DH_A[i] * s
        A[:, 2, 1], A[:, 2, 2], A[:, 2, 3] = sa, ca, DH_D[i]
        A[:, 3, 3] = 1.0
        X = X @ A
        out[:, i] = X
    return out


def fk_flange(q: Array) -> Array:
    """X_WE, pose of the flange, shape (4, 4), for one set of joint angles (6,) [rad]."""
    X_WE: Array = link_frames(q)[0, 5]
    return X_WE


def tcp_positions(q: Array, gripper_length: float) -> Array:
    """p_WT [m], shape (N, 3), for joint angles (N, 6) [rad]."""
    X_WE = link_frames(q)[:, 5]
    p: Array = X_WE[:, :3, 3] + gripper_length * X_WE[:, :3, 2]
    return p


def tcp_jacobian(q: Array, gripper_length: float) -> Array:
    """dp_WT/dq, shape (N, 3, 6) [m/rad], for joint angles (N, 6) [rad]."""
    frames = link_frames(q)
    n = len(frames)
    p_WT = frames[:, 5, :3, 3] + gripper_length * frames[:, 5, :3, 2]
    origins = np.concatenate([np.zeros((n, 1, 3)), frames[:, :5, :3, 3]], axis=1)
    axes = np.concatenate([np.tile([[[0.0, 0.0, 1.0]]], (n, 1, 1)), frames[:, :5, :3, 2]], axis=1)
    J: Array = np.cross(axes, p_WT[:, None, :] - origins).transpose(0, 2, 1)
    return J


def hermite(times: Array, q: Array, qd: Array, t: float | Array) -> tuple[Array, Array, Array]:
    """Cubic Hermite interpolation of a trajectory, held beyond its ends.

    Args:
        times: shape (N,) [s], rising. q, qd: shape (N, 6) [rad], [rad/s].
        t: one time, or times of shape (M,) [s].

    Returns:
        q [rad], qd [rad/s], qdd [rad/s^2], each shape (6,), or (M, 6) for M times. Beyond the
        ends q is that of the end, qd and qdd are 0.
    """
    at = np.asarray(t, dtype=float)
    i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    h = np.asarray(times[i + 1] - times[i])[..., None]
    s = np.clip((at - times[i])[..., None] / h, 0.0, 1.0)
    q0, v0, v1 = q[i], qd[i] * h, qd[i + 1] * h
    d = q[i + 1] - q0
    # q(s) = q0 + v0 s + (3d - 2 v0 - v1) s^2 + (v0 + v1 - 2d) s^3
    b, c = 3 * d - 2 * v0 - v1, v0 + v1 - 2 * d
    inside = ((at >= times[0]) & (at <= times[-1]))[..., None]
    position: Array = q0 + s * (v0 + s * (b + s * c))
    return (
        position,
        np.where(inside, (v0 + s * (2 * b + 3 * s * c)) / h, 0.0),
        np.where(inside, (2 * b + 6 * s * c) / (h * h), 0.0),
    )


def needed_acceleration(times: Array, q: Array, qd: Array, *, short: float) -> Array:
    """Joint acceleration that each segment of a trajectory asks for, shape (N - 1, 6) [rad/s^2].

    For segments longer than `short` [s], the peak of the cubic Hermite interpolation. For shorter
    ones, the least bound within which some motion joins both ends, since set-points sample such
    a segment too coarsely to show the cubic's shape (which overshoots a switch from full
    acceleration to full braking by half).
    """
    h = np.diff(times)[:, None]
    rise = np.abs(np.diff(qd, axis=0)) / h
    skew = np.abs(np.diff(q, axis=0) / h - 0.5 * (qd[:-1] + qd[1:])) / h
    # Full acceleration A, then full braking, moves the mean speed by (A h^2 - dv^2 / A) / 4h.
    least = 2 * skew + np.sqrt(4 * skew**2 + rise**2)
    out: Array = np.where(h > short, rise + 6 * skew, least)
    return out


def check_trajectory(trajectory: Trajectory, limits: Limits) -> None:
    """Refuse a trajectory that breaks a limit anywhere, between its points too.

    Raises:
        RefusedError: with the code and a sentence naming the joint, the value and the limit.
    """
    times, q, qd = trajectory.times, trajectory.q, trajectory.qd
    n = len(times)
    if not 2 <= n <= MAX_POINTS or times.shape != (n,) or q.shape != (n, 6) or qd.shape != (n, 6):
        raise _refused(
            RefusalCode.SHAPE,
            f"needs 2..{MAX_POINTS} points of 6 joints, got {times.shape}, {q.shape}, {qd.shape}",
        )
    if not (np.isfinite(times).all() and np.isfinite(q).all() and np.isfinite(qd).all()):
        raise _refused(RefusalCode.NOT_FINITE, "times, positions and velocities must be finite numbers")
    if times[0] != 0.0 or (np.diff(times) <= 0).any():
        raise _refused(RefusalCode.SHAPE, "times must start at 0 and rise strictly")
    if times[-1] > MAX_DURATION:
        raise _refused(
            RefusalCode.RANGE, f"lasts {times[-1]:.1f} s; at most {MAX_DURATION:.0f} s are accepted"
        )
    if np.abs(qd[-1]).max() > 1e-6:
        raise _refused(RefusalCode.NOT_AT_REST, "the last point must be at rest")
    short = _SHORT * limits.control_period
    _within(RefusalCode.JOINT_LIMIT, "angle", "rad", np.abs(q), limits.q_max)
    _within(RefusalCode.VELOCITY_LIMIT, "speed", "rad/s", np.abs(qd), limits.qd_max * _SPEED_TOLERANCE)
    with np.errstate(over="ignore", invalid="ignore"):
        acceleration = np.nan_to_num(needed_acceleration(times, q, qd, short=short), nan=np.inf)
    allowed = limits.qdd_max * _ACCELERATION_TOLERANCE
    _within(RefusalCode.ACCELERATION_LIMIT, "acceleration", "rad/s^2", acceleration, allowed)
    if (fine := _between(times, short)) is not None:
        q, qd, _ = hermite(times, q, qd, fine)
        _within(RefusalCode.JOINT_LIMIT, "angle", "rad", np.abs(q), limits.q_max)
        _within(RefusalCode.VELOCITY_LIMIT, "speed", "rad/s", np.abs(qd), limits.qd_max * _SPEED_TOLERANCE)
    p = np.einsum("nij,nj->ni", tcp_jacobian(q, limits.gripper_length), qd)
    fastest = float(np.linalg.norm(p, axis=1).max())
    if fastest > limits.tcp_speed * _SPEED_TOLERANCE:
        raise _refused(
            RefusalCode.TCP_SPEED,
            f"the tool would move at {fastest:.3f} m/s; the limit is {limits.tcp_speed:.3f} m/s",
        )


def _between(times: Array, short: float) -> Array | None:
    """Times at most `short` apart that include the given ones; None if these are that dense."""
    parts = np.ceil(np.diff(times) / short).astype(int)
    if parts.max() <= 1:
        return None
    pieces = [np.linspace(a, b, k, endpoint=False) for a, b, k in zip(times, times[1:], parts, strict=False)]
    return np.concatenate([*pieces, times[-1:]])


def _within(code: RefusalCode, what: str, unit: str, values: Array, limit: Array) -> None:
    excess = values - limit
    if (excess > 1e-9).any():
        row, joint = np.unravel_index(int(np.argmax(excess / limit)), excess.shape)
        raise _refused(
            code,
            f"joint {joint + 1} would reach {what} {values[row, joint]:.3f} {unit}; "
            f"the limit is {limit[joint]:.3f} {unit}",
        )


def _refused(code: RefusalCode, reason: str) -> RefusedError:
    return RefusedError(code.value, reason)
