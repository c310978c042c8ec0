"""The watch over the belt camera's place: warns of a moved camera, once, and of nothing else."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from cell.cameras import camera_pose
from cell.config import CellConfig, load
from cell.decision import policy
from cell.frames import Array, pose, rotation
from cell.perception.drift import VOTES, WINDOW, DriftWatch
from cell.settings import MisplacedConfig
from cell.wire.types import Frame
from hil.sim.backend import SimBackend
from hil.sim.camera import sense_depth

from .in_process import drive
from .rig import TruthDetector

CONFIG = load()
BELT = CONFIG.cameras["belt"]


@pytest.fixture(scope="module")
def backend() -> Iterator[SimBackend]:
    """A cell with a full belt and the arm at home."""
    made = SimBackend(CONFIG, 5, 15)
    made.connect()
    yield made
    made.close()


def frame(backend: SimBackend, moved: Array, seed: int) -> Frame:
    """A noisy frame of the belt camera, moved in its own frame."""
    camera, renderer = backend._cameras["belt"], backend._renderer
    assert renderer is not None
    image = renderer.render(camera_pose(BELT) @ moved, camera.pinhole, camera.near, camera.far)
    depth = sense_depth(image.depth, BELT, np.random.default_rng(seed))
    return Frame("belt", seed, 0.0, image.rgb, depth)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_camera_moved_by_10_mm_or_1_degree_is_told_of_once(
    backend: SimBackend, axis: int, sign: float
) -> None:
    direction = sign * np.eye(3)[axis]
    for moved in (pose(p=0.010 * direction), pose(rotation(np.deg2rad(1.0) * direction))):
        watch = DriftWatch(CONFIG, "belt")
        said = [watch.look(frame(backend, moved, k)) for k in range(VOTES + 2)]
        assert [bool(text) for text in said] == [False] * (VOTES - 1) + [True, False, False]
        assert "camera belt" in said[VOTES - 1] and "cell calibrate" in said[VOTES - 1]


def test_a_camera_in_its_place_is_not_told_of(backend: SimBackend) -> None:
    rng = np.random.default_rng(0)
    watch = DriftWatch(CONFIG, "belt")
    for k in range(2 * WINDOW):
        # as far off as a calibration may be
        shift, turn = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        moved = pose(rotation(0.002 * turn), 0.001 * shift) if k % 2 else np.eye(4)
        assert not watch.look(frame(backend, moved, k))
    assert not watch.warned


def test_single_frames_do_not_warn(backend: SimBackend) -> None:
    watch = DriftWatch(CONFIG, "belt")
    for k in range(12):
        moved = pose(p=(0.0, 0.0, 0.010)) if k % 4 == 0 else np.eye(4)
        assert not watch.look(frame(backend, moved, k))


@pytest.mark.parametrize("depth", [0.0, 0.4])
def test_a_blind_or_covered_camera_says_nothing_about_its_place(depth: float) -> None:
    watch = DriftWatch(CONFIG, "belt")
    pixels = np.full((BELT.height, BELT.width), depth, np.float32)
    picture = np.zeros((BELT.height, BELT.width, 3), np.uint8)
    for k in range(WINDOW):
        assert not watch.look(Frame("belt", k, 0.0, picture, pixels))


def test_the_supervisor_warns_once_and_sorts_on() -> None:
    moved = msgspec.structs.replace(BELT, simulated=MisplacedConfig(shift=(0.0, 0.0, 0.010)))
    config: CellConfig = msgspec.structs.replace(CONFIG, cameras={**CONFIG.cameras, "belt": moved})
    warnings: list[str] = []

    class Late:
        """A detector that is told of the world once there is one."""

        of: TruthDetector | None = None

        def detect(self, rgb: np.ndarray) -> object:
            assert self.of is not None
            return self.of.detect(rgb)

    detector = Late()

    def watch(backend: SimBackend, inputs: object, outputs: object) -> None:
        detector.of = detector.of or TruthDetector(backend)
        warnings.extend(e.text for e in outputs.events if "camera belt" in e.text)  # type: ignore[attr-defined]

    backend, outputs = drive(4, 3, policy.load("expert"), config=config, detector=detector, watch=watch)  # type: ignore[arg-type]
    backend.close()
    assert outputs.done and outputs.state.sorted + outputs.state.remaining == 3
    assert len(warnings) == 1
