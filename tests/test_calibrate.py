"""Calibration: what is found is near the truth, bad sets are refused with their reason, files load."""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
import yaml

from cell.calibrate import check, overlay, truth
from cell.calibrate.board import Board, Corners
from cell.calibrate.collect import Collector
from cell.calibrate.flow import Found, known, record
from cell.calibrate.model import Guess
from cell.calibrate.poses import Pose, PoseSearch
from cell.calibrate.solve import View, closed_form, solve
from cell.cameras import true_pinhole, true_pose
from cell.config import CellConfig, load
from cell.decision.io import Command, Inputs
from cell.errors import CalibrationError, ConfigError, PlanError
from cell.frames import angle_of, inverse, pose, rotation
from cell.limits import Limits
from cell.motion.planner import Planner
from cell.settings import BoardConfig
from cell.wire.types import Capture, GripperCommand, Reply, Trajectory
from hil.executor import Executor
from hil.sim.backend import SimBackend

CONFIG = load()
BOARD = Board(CONFIG.board)
NAMES = ("belt", "person")


@cache
def planners() -> tuple[Planner, Planner]:
    return Planner(CONFIG, thorough=False), Planner(CONFIG, thorough=False, carried=BOARD.spheres())


@cache
def poses(name: str) -> tuple[Pose, ...]:
    """Fifteen poses for a camera and some more."""
    return tuple(PoseSearch(CONFIG, BOARD, *planners(), known(CONFIG, BOARD, name), 0).best(20))


@cache
def simulated(seed: int) -> tuple[CellConfig, SimBackend]:
    config = truth.misplaced(CONFIG, seed)
    backend = SimBackend(config, seed, 0)
    backend.connect()
    return config, backend


def true_guess(config: CellConfig, name: str) -> Guess:
    camera, board = config.cameras[name], config.board
    X_TB = BOARD.X_TB @ pose(rotation(board.turn), board.shift)
    return Guess(true_pose(camera), X_TB, true_pinhole(camera))


def pictured(backend: SimBackend, name: str, q: np.ndarray) -> View:
    """The rendered, noisy view of the board at joint angles q."""
    backend.world.arm.place(q)
    backend.advance()
    backend.request_frame(name)
    frames = backend.take_frames()
    while not frames:
        backend.advance()
        frames = backend.take_frames()
    measured = backend.read_joints().q
    X_WT = planners()[0].kinematics.X_WT(measured)
    return View(measured, X_WT, BOARD.find(frames[0].rgb))


def made(name: str = "belt", count: int = 15, noise: float = 0.1, seed: int = 0) -> list[View]:
    """Views computed from the truth of seed 1, with noise on the corners [px]."""
    guess = true_guess(truth.misplaced(CONFIG, 1), name)
    rng = np.random.default_rng(seed)
    out = []
    for p in poses(name)[:count]:
        uv = guess.corners(p.X_WT[None], BOARD.points_B)[0]
        uv = uv + rng.normal(0, noise, uv.shape)
        out.append(View(p.q, p.X_WT, Corners(np.arange(len(uv)), uv, 2.5)))
    return out


def solved(views: list[View], name: str = "belt", board: Board = BOARD) -> None:
    before = known(CONFIG, board, name)
    check.check_solution(solve(check.check_views(views), board, before), before.pinhole)


# -- the figures --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_fifteen_noisy_pictures_give_pose_and_intrinsics(name: str) -> None:
    config, backend = simulated(3)
    before = known(CONFIG, BOARD, name)
    off = truth.error(config.cameras[name], before)
    assert off.position > 0.003 and off.rotation > 0.004, (
        "the configured pose must be wrong for this to say anything"
    )
    views = []
    for p in poses(name):
        view = pictured(backend, name, p.q)
        if not check.usable([view])[1]:
            views.append(view)
        if len(views) == 15:
            break
    solution = solve(check.check_views(views), BOARD, before)
    check.check_solution(solution, before.pinhole)
    error = truth.error(config.cameras[name], solution.guess)
    assert error.position <= 0.002 and error.rotation <= 0.003
    assert error.focal <= 0.003 and error.centre <= 0.003
    assert error.position < 4 * solution.sd_position and error.rotation < 4 * solution.sd_rotation


def test_corners_are_found_where_the_board_is() -> None:
    config, backend = simulated(3)
    guess = true_guess(config, "belt")
    view = pictured(backend, "belt", poses("belt")[-1].q)
    off = view.corners.uv - guess.corners(view.X_WT[None], BOARD.points_B)[0][view.corners.ids]
    assert len(view.corners.ids) >= 6 and np.abs(off).max() < 1.0 and np.sqrt((off**2).mean()) < 0.3


def test_without_noise_the_closed_form_is_exact() -> None:
    guess = true_guess(truth.misplaced(CONFIG, 1), "belt")
    X_WC, X_TB = closed_form(made(noise=0.0), BOARD, guess.pinhole)
    for found, true in ((X_WC, guess.X_WC), (X_TB, guess.X_TB)):
        X = inverse(true) @ found
        assert np.linalg.norm(X[:3, 3]) < 1e-5 and angle_of(X[:3, :3]) < 1e-5


def test_a_camera_configured_far_off_is_found_too() -> None:
    """15 cm and 10 degrees: the closed form leads the adjustment there."""
    config = truth.misplaced(CONFIG, 1)
    right = known(CONFIG, BOARD, "belt")
    far = replace(right, X_WC=right.X_WC @ pose(rotation([0.0, 0.17, 0.0]), [0.0, 0.15, 0.0]))
    error = truth.error(config.cameras["belt"], solve(made(), BOARD, far).guess)
    assert error.position < 0.002 and error.rotation < 0.003


# -- bad sets -----------------------------------------------------------------------------------------------


def test_too_few_views_are_refused() -> None:
    with pytest.raises(CalibrationError, match=r"7 usable views, at least 8 are needed"):
        solved(made(count=7))


def test_parallel_poses_are_refused() -> None:
    views = made()
    R = views[0].X_WT[:3, :3]
    flat = [
        replace(v, X_WT=pose(R @ rotation([0.0, 0.0, 0.1 * k]), v.X_WT[:3, 3])) for k, v in enumerate(views)
    ]
    with pytest.raises(CalibrationError, match=r"nearly parallel.*tilt it both ways"):
        solved(flat)


def test_a_board_hardly_seen_is_refused() -> None:
    few = [replace(v, corners=Corners(v.corners.ids[:4], v.corners.uv[:4], 2.5)) for v in made()]
    with pytest.raises(
        CalibrationError, match=r"0 usable views.*15 left out, because the board is hardly seen"
    ):
        solved(few)


def test_a_moving_arm_is_refused() -> None:
    moving = [replace(v, speed=0.05) if k < 9 else v for k, v in enumerate(made())]
    with pytest.raises(
        CalibrationError, match=r"6 usable views.*9 left out, because the arm was not at rest"
    ):
        solved(moving)


def test_blurred_pictures_are_refused() -> None:
    _, backend = simulated(3)
    sharp = pictured(backend, "belt", poses("belt")[0].q)
    assert not check.usable([sharp])[1]
    backend.request_frame("belt")
    while not (frames := backend.take_frames()):
        backend.advance()
    smeared = cv2.GaussianBlur(frames[0].rgb, (0, 0), 4.0)
    view = replace(sharp, corners=BOARD.find(np.asarray(smeared, np.uint8)))
    (rejected,) = check.usable([view])[1]
    assert rejected.why in ("the picture is blurred", "the board is hardly seen")


def test_a_board_of_another_size_is_refused() -> None:
    printed_smaller = Board(msgspec.structs.replace(CONFIG.board, square=0.043))
    with pytest.raises(CalibrationError, match=r"px from where.*board\.square"):
        solved(made(), board=printed_smaller)


def test_joint_angles_of_other_moments_are_refused() -> None:
    views = made()
    mixed = [replace(v, X_WT=w.X_WT) for v, w in zip(views, [*views[1:], views[0]], strict=True)]
    with pytest.raises(CalibrationError, match="px from where"):
        solved(mixed)


def test_pictures_of_another_camera_are_refused() -> None:
    wide = known(CONFIG, BOARD, "belt")
    wide = replace(wide, pinhole=replace(wide.pinhole, fx=500.0, fy=500.0))
    solution = solve(check.check_views(made()), BOARD, wide)
    with pytest.raises(CalibrationError, match=r"focal length is .* % from the configured"):
        check.check_solution(replace(solution, residual=0.1), wide.pinhole)


def test_a_camera_that_the_arm_cannot_show_the_board_to_is_named() -> None:
    away = known(CONFIG, BOARD, "belt")
    away = replace(away, X_WC=pose(p=(3.0, 3.0, 3.0)) @ away.X_WC)
    with pytest.raises(CalibrationError, match=r"only 0 arm poses in reach"):
        PoseSearch(CONFIG, BOARD, *planners(), away, 0).best(8)


# -- the arm ------------------------------------------------------------------------------------------------


class Together:
    """A link to a node in this process."""

    def __init__(self, backend: SimBackend) -> None:
        self.backend = backend
        self._executor = Executor(
            Limits.from_config(CONFIG), CONFIG.arm.control_period, backend.read_joints().q
        )

    def exchange(self, commands: tuple[Command, ...]) -> Inputs:
        b, executor = self.backend, self._executor
        replies = tuple((c.ticket, self._obey(c)) for c in commands)
        for _ in range(CONFIG.supervisor.ticks_per_cycle):
            b.command_joints(*executor.tick(b.now()))
            b.advance()
        status = replace(b.read_status(), trajectory_id=executor.trajectory_id, moving=executor.moving)
        return Inputs(
            b.now(), b.read_joints(), status, b.read_gripper(), b.read_belt(), tuple(b.take_frames()), replies
        )

    def _obey(self, command: Command) -> Reply:
        order = command.order
        if isinstance(order, Trajectory):
            self._executor.accept(order, self.backend.now(), self.backend.read_joints().q)
        elif isinstance(order, GripperCommand):
            self.backend.command_gripper(order.width, order.speed, order.force)
        elif isinstance(order, Capture):
            self.backend.request_frame(command.camera)
        return Reply(True)


@pytest.mark.parametrize("live", [False, True])
def test_the_arm_goes_from_pose_to_pose_and_rests_for_every_picture(live: bool) -> None:
    config = truth.misplaced(CONFIG, 2)
    backend = SimBackend(config, 2, 0)
    backend.connect()
    told: list[str] = []
    try:
        arm = Collector(CONFIG, Together(backend), *planners(), BOARD, "test", live=live)  # type: ignore[arg-type]
        arm.wait(iter([False, False, True]).__next__)
        start = arm.reach(list(poses("belt")))
        arm.grip()
        views = arm.views("belt", list(poses("belt")), 3, told.append)
        arm.back(start)
        assert arm.home()
        q = backend.read_joints().q
    finally:
        backend.close()
    good, _ = check.usable(views)
    assert len(good) == 3 and all(v.speed < check.LARGEST_SPEED for v in views)
    assert sum("view" in text for text in told) == len(views)
    assert np.abs(q - CONFIG.arm.home).max() < 0.01
    assert backend is not None and not backend._contacts


def test_a_carried_board_keeps_the_arm_from_where_it_would_touch() -> None:
    bare, carrying = planners()
    q = np.array([CONFIG.arm.home])  # the tool points down, over the belt: the board would be in it
    assert bare.collision.clearance(q)[0] > 0 > carrying.collision.clearance(q)[0]
    assert "board" in carrying.collision.nearest(q)[1]
    with pytest.raises(PlanError):
        carrying.plan_joints(poses("belt")[0].q, q[0], 0.25)


# -- files --------------------------------------------------------------------------------------------------


def found(config: CellConfig) -> Found:
    before = known(CONFIG, BOARD, "belt")
    solution = solve(made(), BOARD, before)
    camera = config.cameras["belt"]
    return Found(
        "belt", record(camera, solution, "sim"), solution, (0.01, 0.02), truth.error(camera, solution.guess)
    )


def test_what_is_written_loads_and_holds(tmp_path: Path) -> None:
    config = truth.misplaced(CONFIG, 1)
    base, out = tmp_path / "mine.yaml", tmp_path / "calibrated.yaml"
    base.write_text("port: 7999\ncameras: {belt: {rate: 5.0}}\n")
    one = found(config)
    overlay.write(out, base, config, [one])
    loaded = load(out)
    belt = loaded.cameras["belt"]
    assert (loaded.port, belt.rate, belt.calibration) == (7999, 5.0, one.record)
    assert belt.calibration is not None and belt.calibration.date.endswith("Z")
    again = known(loaded, BOARD, "belt")
    assert np.allclose(again.X_WC, one.solution.guess.X_WC) and again.pinhole == one.solution.guess.pinhole
    assert truth.error(belt, again).position < 0.002, "the file describes the simulated cell, too"
    row = overlay.figures([one])["belt"]
    assert row["error_mm"] <= 2.0 and row["error_mrad"] <= 3.0 and row["views"] == 15


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("cameras: {belt: {hfov: 1.0}}", "calibrate again"),
        ("cameras: {belt: {calibration: {quaternion: [0, 0, 0, 2]}}}", "quaternion"),
        ("cameras: {belt: {calibration: {colour: red}}}", "colour"),
        ("cameras: {belt: {simulated: {colour: red}}}", "colour"),
        ("board: {dictionary: 4X4_7}", "board.dictionary"),
        ("board: {squares: 4}", "squares"),
    ],
)
def test_what_does_not_belong_there_is_refused(tmp_path: Path, text: str, words: str) -> None:
    out = tmp_path / "calibrated.yaml"
    overlay.write(out, None, CONFIG, [found(CONFIG)])
    both = tmp_path / "both.yaml"
    both.write_text(yaml.safe_dump(merged(yaml.safe_load(out.read_text()), yaml.safe_load(text))))
    with pytest.raises(ConfigError, match=words):
        load(both)


def merged(base: dict[str, Any], top: dict[str, Any]) -> dict[str, Any]:
    """`top` laid over `base`, whatever the keys are."""
    both = {k: merged(base[k], v) if isinstance(base.get(k), dict) else v for k, v in top.items()}
    return {**base, **both}


def test_the_printed_board_has_its_true_size(tmp_path: Path) -> None:
    overlay.write_board(tmp_path / "board.svg", CONFIG)
    root = ET.parse(tmp_path / "board.svg").getroot()
    assert (root.get("width"), root.get("height")) == ("292.500mm", "202.500mm")
    board = Board(BoardConfig())
    picture = np.pad(board.picture(64), 16, constant_values=255)
    corners = board.find(np.dstack([picture] * 3))
    assert len(corners.ids) == len(board.points_B)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--views", "3"], "--views must be from 8"),
        (["--camera", "wrist"], "belt, person, both"),
        (["--backend", "ur3e"], "--robot-ip"),
        (["--cameras", "real"], "--backend ur3e"),
        (["--out", "/nowhere/x.yaml"], "does not exist"),
    ],
)
def test_bad_input_is_one_line(options: list[str], words: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "cell.cli", "calibrate", *options], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2 and words in done.stderr and done.stderr.count("\n") == 1, done.stderr
