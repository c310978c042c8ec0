"""One calibration from start to result: node, arm, pictures, solution, record."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from cell.calibrate.board import Board
from cell.calibrate.check import check_solution, check_views
from cell.calibrate.collect import Collector, Tell
from cell.calibrate.model import Guess
from cell.calibrate.poses import Pose, PoseSearch
from cell.calibrate.solve import Solution, View, solve
from cell.calibrate.truth import Error, error
from cell.cameras import camera_pinhole, camera_pose
from cell.clock import WallClock
from cell.config import CellConfig
from cell.frames import angle_of, inverse, quaternion
from cell.motion.planner import Planner
from cell.run.link import Link, LiveLink, StepLink
from cell.run.node_process import NodeProcess
from cell.settings import CalibrationConfig, CameraConfig
from cell.version import code_version, commit
from cell.wire.session import Session

HOLDER = "calibration"
_RESERVE = 7
"""Poses more than wanted, for those to which no free way leads."""
Ask = Callable[[str], Callable[[], bool]]
"""Asks a person to do something; what it returns says whether it is done."""


@dataclass(frozen=True)
class Options:
    """What to calibrate.

    Attributes:
        backend, robot_ip, cameras: see `hil.backend.make_backend`. names: of the cameras.
        views: wanted of each. seed: of the poses, and of a simulated cell.
    """

    backend: str
    names: tuple[str, ...]
    views: int
    seed: int
    robot_ip: str = ""
    cameras: str = ""

    @property
    def simulated(self) -> bool:
        """The pictures are drawn: the board is in the gripper already, and there is a truth."""
        return self.backend == "sim" or self.cameras == "sim"


@dataclass(frozen=True)
class Found:
    """The result for one camera.

    Attributes:
        record: for the configuration. solution: with what it rests on.
        moved: from what was configured, by so much [m], [rad]. error: from the truth, where there is one.
    """

    name: str
    record: CalibrationConfig
    solution: Solution
    moved: tuple[float, float]
    error: Error | None


def calibrate(config: CellConfig, options: Options, tell: Tell, ask: Ask) -> list[Found]:
    """Take views of the board with every camera asked for and solve them.

    Args:
        config: the cell; a simulated one with the board mounted (see `cell.calibrate.truth`).

    Raises:
        CalibrationError: a set of views is refused, with the reason. CellError: nothing could be run.
    """
    views = _collect(config, options, tell, ask)
    return [_solved(config, options, name, views[name]) for name in options.names]


def _collect(config: CellConfig, options: Options, tell: Tell, ask: Ask) -> dict[str, list[View]]:
    board = Board(config.board)
    planner, carrying = Planner(config), Planner(config, carried=board.spheres())
    lock_step = options.backend == "sim"
    with ExitStack() as stack:
        node = stack.enter_context(
            NodeProcess(
                config, backend=options.backend, lock_step=lock_step, seed=options.seed, onions=0,
                robot_ip=options.robot_ip, cameras=options.cameras,
            )
        )  # fmt: skip
        poses: dict[str, list[Pose]] = {}
        for name in options.names:
            search = PoseSearch(config, board, planner, carrying, known(config, board, name), options.seed)
            poses[name] = search.best(options.views + _RESERVE)
        tell("arm poses chosen")
        planner.prepare()
        carrying.prepare()
        node.wait_ready()
        session = stack.enter_context(Session.connect(config, patient=lock_step))
        link: Link = (StepLink if lock_step else LiveLink)(session, config, HOLDER)
        stack.callback(link.close)
        try:
            arm = Collector(config, link, planner, carrying, board, HOLDER, live=not lock_step)
            start = arm.reach(poses[options.names[0]])
            if not options.simulated:
                arm.wait(ask(_PUT_IN))
            arm.grip()
            views = {name: arm.views(name, poses[name], options.views, tell) for name in options.names}
            if not arm.back(start):
                tell("no free way leads back to where the board was put in; the arm stays here")
            if not options.simulated:
                arm.wait(ask(_TAKE_OUT))
            if not arm.home():
                tell("no free way leads home; the arm stays here")
        except KeyboardInterrupt:
            link.stop("interrupted by the user")
            raise
        return views


_PUT_IN = (
    "Hold the board's lower edge between the finger pads, upright, its pattern along the plate's long side "
    "facing away from either pad; the fingers close on it. Stand clear, then press Enter."
)
_TAKE_OUT = "Take the board; the fingers stay closed until it is held. Stand clear, then press Enter."


def known(config: CellConfig, board: Board, name: str) -> Guess:
    """What the configuration says of a camera and of the board."""
    camera = config.cameras[name]
    return Guess(camera_pose(camera), board.X_TB, camera_pinhole(camera))


def _solved(config: CellConfig, options: Options, name: str, views: list[View]) -> Found:
    board, camera = Board(config.board), config.cameras[name]
    before = known(config, board, name)
    solution = solve(check_views(views), board, before)
    check_solution(solution, before.pinhole)
    X = inverse(before.X_WC) @ solution.guess.X_WC
    return Found(
        name=name,
        record=record(camera, solution, "sim" if options.backend == "sim" else options.robot_ip),
        solution=solution,
        moved=(float(np.linalg.norm(X[:3, 3])), angle_of(X[:3, :3])),
        error=error(camera, solution.guess) if options.simulated and camera.simulated else None,
    )


def record(camera: CameraConfig, solution: Solution, robot: str) -> CalibrationConfig:
    """What goes into the configuration."""
    guess = solution.guess
    p, k = guess.pinhole, guess.X_WC[:3, 3]
    x, y, z, w = (float(v) for v in quaternion(guess.X_WC[:3, :3]))
    return CalibrationConfig(
        position=(float(k[0]), float(k[1]), float(k[2])),
        quaternion=(x, y, z, w),
        focal=(float(p.fx), float(p.fy)),
        centre=(float(p.cx), float(p.cy)),
        measured_at=(camera.width, camera.height, camera.hfov),
        views=solution.views,
        residual=solution.residual,
        uncertainty=(solution.sd_position, solution.sd_rotation),
        date=datetime.fromtimestamp(WallClock().now(), UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        made_by=f"cell {code_version()} ({commit()}), robot {robot}",
    )
