"""What makes a set of views worthless, said before and after solving it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cell.calibrate.solve import Solution, View
from cell.errors import CalibrationError
from cell.frames import Array, Pinhole, angle_of

LEAST_VIEWS = 8
LEAST_CORNERS = 6
"""Corners from which a picture counts as a view of the board."""
LARGEST_EDGE = 6.0
"""Width of an edge from which a picture counts as blurred [px]."""
LARGEST_SPEED, LARGEST_DRIFT = 0.005, 0.001
"""Joint speed [rad/s] and change of a joint [rad] round an exposure above which the arm moved."""
LEAST_TURN = np.deg2rad(8.0)
"""Root mean square turn of the board about the second most turned axis, at least [rad]."""
LARGEST_RESIDUAL = 0.6
"""[px]"""
LARGEST_FOCAL = 0.05
"""Share by which fx and fy may differ from the configured ones."""
LARGEST_SD = (0.0015, 0.0025)
"""Standard deviation of the camera's pose by the residuals, at most [m], [rad]."""


@dataclass(frozen=True)
class Rejected:
    """A picture that is no use, and why."""

    view: View
    why: str


def usable(views: Sequence[View]) -> tuple[list[View], list[Rejected]]:
    """Views that show the board, sharp, from an arm at rest; and the others."""
    good: list[View] = []
    bad: list[Rejected] = []
    for view in views:
        why = _fault(view)
        if why:
            bad.append(Rejected(view, why))
        else:
            good.append(view)
    return good, bad


def _fault(view: View) -> str:
    count = len(view.corners.ids)
    if view.speed > LARGEST_SPEED or view.drift > LARGEST_DRIFT:
        return "the arm was not at rest"
    if count < LEAST_CORNERS:
        return "the board is hardly seen"
    if view.corners.edge > LARGEST_EDGE:
        return "the picture is blurred"
    return ""


def check_views(views: Sequence[View]) -> list[View]:
    """The usable views of a set.

    Raises:
        CalibrationError: they are too few, or the board was turned too little between them.
    """
    good, bad = usable(views)
    if len(good) < LEAST_VIEWS:
        reasons = Counter(r.why for r in bad)
        left_out = "; ".join(f"{n} left out, because {why}" for why, n in reasons.most_common())
        raise CalibrationError(
            f"{len(good)} usable views, at least {LEAST_VIEWS} are needed" + (f" ({left_out})" if bad else "")
        )
    turn = second_turn(np.array([v.X_WT for v in good]))
    if turn < LEAST_TURN:
        raise CalibrationError(
            f"the poses are nearly parallel: about a second axis the board turns by {np.rad2deg(turn):.1f} "
            f"degrees (root mean square), {np.rad2deg(LEAST_TURN):.0f} are needed; tilt it both ways"
        )
    return good


def second_turn(X_WT: Array) -> float:
    """How much poses (V, 4, 4) turn about the second of their main axes, root mean square [rad].

    Turns about one axis only leave the positions along that axis unknown, however many there are.
    """
    R0 = X_WT[len(X_WT) // 2, :3, :3]
    vectors = np.array([_vector(R0.T @ X[:3, :3]) for X in X_WT])
    vectors = vectors - vectors.mean(axis=0)
    return float(np.linalg.svd(vectors, compute_uv=False)[1] / np.sqrt(len(vectors)))


def check_solution(solution: Solution, configured: Pinhole) -> None:
    """Raise `CalibrationError` when the views contradict each other or leave the pose open.

    Args:
        configured: intrinsics that the pictures should have.
    """
    if solution.residual > LARGEST_RESIDUAL:
        raise CalibrationError(
            f"the corners lie {solution.residual:.2f} px from where one camera pose puts them (worst view "
            f"{solution.worst:.2f} px), at most {LARGEST_RESIDUAL} is right: the board moved in the gripper "
            "or bends, its squares are not 'board.square' long, or the joint angles are not those of the "
            "pictures"
        )
    found = solution.guess.pinhole
    off = max(abs(found.fx / configured.fx - 1), abs(found.fy / configured.fy - 1))
    if off > LARGEST_FOCAL:
        raise CalibrationError(
            f"the focal length is {off * 100:.1f} % from the configured one, at most "
            f"{LARGEST_FOCAL * 100:.0f} % is right: these are pictures of another camera, or width, height "
            "or hfov are not the camera's"
        )
    if solution.sd_position > LARGEST_SD[0] or solution.sd_rotation > LARGEST_SD[1]:
        raise CalibrationError(
            f"the views leave the pose open by {solution.sd_position * 1e3:.1f} mm and "
            f"{solution.sd_rotation * 1e3:.1f} mrad (standard deviation), at most "
            f"{LARGEST_SD[0] * 1e3:.1f} mm and {LARGEST_SD[1] * 1e3:.1f} mrad are right: take more views, "
            "farther apart and more tilted"
        )


def _vector(R: Array) -> Array:
    """Rotation vector (3,) [rad] of R (3, 3)."""
    angle = angle_of(R)
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    length = float(np.linalg.norm(axis))
    if length > 1e-9:
        return angle * axis / length
    if angle < 1.0:
        return np.zeros(3)
    column = np.linalg.eigh((R + R.T) / 2)[1][:, 2]  # half a turn: the axis is the fixed direction
    return np.asarray(angle * column)
