"""Hand networks: their files, the regions they are given, decoding, tracking and depth."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.frames import Pinhole
from cell.perception.hands.depth import isolate, locate_palm
from cell.perception.hands.fetch import fetch, main
from cell.perception.hands.gesture import classify
from cell.perception.hands.landmarks import Hand, roi_from
from cell.perception.hands.models import MODELS, PALM, HandModelError, cache_dir, read_model
from cell.perception.hands.palm import ANCHORS, Palm, PalmDetector, decode, letterbox, suppress
from cell.perception.hands.roi import Roi, cut, rotation, upright_angle
from cell.perception.hands.tracker import HandTracker, TrackerConfig

try:
    for _model in MODELS:
        read_model(_model)
    _missing = ""
except HandModelError as error:
    _missing = str(error)
needs_models = pytest.mark.skipif(bool(_missing), reason=_missing or "hand networks are there")

DATA = Path(__file__).resolve().parent / "data"
angles = st.floats(-3.1, 3.1)


# -- files ---------------------------------------------------------------------------------------


def test_missing_file_names_the_command(tmp_path: Path) -> None:
    with pytest.raises(HandModelError, match=r"palm_detection_full.*missing.*hands\.fetch.*gestures"):
        PalmDetector(tmp_path)


def test_altered_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / PALM.name).write_bytes(bytes(PALM.size))
    with pytest.raises(HandModelError, match="SHA-256"):
        read_model(PALM, tmp_path)
    (tmp_path / PALM.name).write_bytes(b"short")
    with pytest.raises(HandModelError, match=f"{PALM.size} bytes, got 5"):
        read_model(PALM, tmp_path)
    (tmp_path / PALM.name).write_bytes(bytes(PALM.size + 100))
    with pytest.raises(HandModelError, match="got more"):
        read_model(PALM, tmp_path)


def test_cache_follows_xdg(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_dir() == tmp_path / "sorting-cell" / "hands"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative/is/ignored")
    assert cache_dir() == Path.home() / ".cache" / "sorting-cell" / "hands"


@pytest.mark.parametrize("content", [b"", b"no zip at all", b"PK\x05\x06" + bytes(18)])
def test_a_broken_wheel_is_refused(
    tmp_path: Path, content: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    wheel = tmp_path / "m.whl"
    wheel.write_bytes(content)
    assert main(["--wheel", str(wheel), "--into", str(tmp_path / "out")]) == 2
    assert "mediapipe==0.10.21" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_wheel_with_other_content_is_refused(tmp_path: Path) -> None:
    wheel = tmp_path / "m.whl"
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(PALM.member, bytes(300_000_000))  # a bomb: 0.3 GB from 0.3 MB
        archive.writestr("../../escape", b"x")
    with pytest.raises(HandModelError, match="got more"):
        fetch(tmp_path / "out", wheel)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["m.whl"]


@needs_models
def test_what_is_there_is_not_fetched_again(tmp_path: Path) -> None:
    for model in MODELS:
        (tmp_path / model.name).write_bytes(read_model(model))
    assert fetch(tmp_path, tmp_path / "no-such-wheel") == tmp_path


# -- regions -------------------------------------------------------------------------------------


def test_letterbox_is_centred_without_half_pixel_shift() -> None:
    box = letterbox(640, 480)
    # tensor = (image - (W - S) / 2) * 192 / S, S = 640: image (0, 0) lies at (0, 24)
    assert np.allclose(box.to_image(np.array([[0.0, 24.0], [192.0, 168.0]]), 192), [[0, 0], [640, 480]])


def test_cut_samples_where_it_says() -> None:
    v, u = np.mgrid[0:120, 0:160].astype(np.float32)
    rgb = np.stack([u, v, u + v], axis=-1).astype(np.uint8)[..., :3]
    roi = Roi(70.0, 60.0, 48.0, 0.6)
    out = cut(rgb, roi, 96, replicate=True)
    j, i = np.mgrid[0:96:7, 0:96:5]
    expected = roi.to_image(np.stack([i, j], axis=-1).astype(float), 96)
    assert np.abs(out[j, i, 0] - expected[..., 0]).max() <= 1.0
    assert np.abs(out[j, i, 1] - expected[..., 1]).max() <= 1.0


def test_cut_survives_absurd_regions() -> None:
    rgb = np.full((20, 20, 3), 9, np.uint8)
    assert (cut(rgb, Roi(1e7, -1e7, 1e6, 1.0), 16, replicate=True) == 9).all()
    assert (cut(rgb, Roi(1e7, -1e7, 1e6, 1.0), 16, replicate=False) == 0).all()


def test_borders() -> None:
    rgb = np.full((20, 20, 3), 200, np.uint8)
    roi = Roi(0.0, 0.0, 40.0)
    assert cut(rgb, roi, 40, replicate=False)[5, 5].tolist() == [0, 0, 0]
    assert cut(rgb, roi, 40, replicate=True)[5, 5].tolist() == [200, 200, 200]


def test_iou() -> None:
    a = Roi(0, 0, 2)
    assert a.iou(a) == pytest.approx(1.0)
    assert a.iou(Roi(1, 0, 2)) == pytest.approx(1 / 3)
    assert a.iou(Roi(2.5, 0, 2)) == 0.0
    assert a.iou(Roi(0, 0, 1)) == pytest.approx(0.25)


@settings(deadline=None, max_examples=40)
@given(angles)
def test_upright_angle_turns_image_up_into_the_direction(angle: float) -> None:
    direction = rotation(angle) @ [0.0, -1.0]
    assert upright_angle(np.zeros(2), direction) == pytest.approx(angle, abs=1e-9)


# -- palm detector -------------------------------------------------------------------------------


def test_anchors() -> None:
    assert ANCHORS.shape == (2016, 2)
    assert np.allclose(ANCHORS[:4] * 24, [[0.5, 0.5], [0.5, 0.5], [1.5, 0.5], [1.5, 0.5]])
    assert np.allclose(ANCHORS[48] * 24, [0.5, 1.5])
    assert np.allclose(ANCHORS[1152:1158] * 12, 0.5)
    assert np.allclose(ANCHORS[-1] * 12, 11.5)


def test_decode_reads_offsets_from_the_anchor() -> None:
    raw, logits = np.zeros((2016, 18), np.float32), np.full((2016, 1), -200, np.float32)
    raw[100] = [6, -3, 20, 30, *range(14)]
    logits[100] = 2.0
    (palm,) = decode(raw, logits, 0.3)
    x, y = ANCHORS[100] * 192
    assert palm.score == pytest.approx(1 / (1 + np.exp(-2)))
    assert np.allclose(palm.box, [x + 6 - 10, y - 3 - 15, x + 6 + 10, y - 3 + 15])
    assert np.allclose(palm.keypoints[2], [x + 4, y + 5])


def test_suppression_averages_by_score() -> None:
    def at(x: float, score: float) -> Palm:
        return Palm(np.array([x, 0, x + 10, 10]), np.full((7, 2), x), score)

    out = suppress((at(0, 0.9), at(1, 0.3), at(50, 0.5)))
    assert [p.score for p in out] == [0.9, 0.5]
    assert out[0].box[0] == pytest.approx(0.25)
    assert out[0].keypoints[0, 0] == pytest.approx(0.25)


def test_palm_roi_reaches_towards_the_fingers() -> None:
    keypoints = np.zeros((7, 2))
    keypoints[0], keypoints[2] = (50, 60), (50, 40)  # fingers up
    roi = Palm(np.array([40.0, 40, 60, 70]), keypoints, 1.0).roi()
    assert (roi.u, roi.v, roi.side, roi.angle) == pytest.approx((50, 55 - 15, 78, 0))
    keypoints[2] = (70, 60)  # fingers to the right
    roi = Palm(np.array([40.0, 40, 60, 70]), keypoints, 1.0).roi()
    assert (roi.u, roi.v, roi.angle) == pytest.approx((50 + 15, 55, np.pi / 2))


# -- landmarks -----------------------------------------------------------------------------------


def make_landmarks() -> np.ndarray:
    """An open right hand seen from its back, fingers up, (21, 2) [px]."""
    points = [(0.0, 0.0), (-20, -15), (-35, -35), (-45, -50), (-52, -65)]
    for x, y in ((-20, -60), (-2, -64), (14, -60), (28, -52)):
        points += [(x, y), (x, y - 25), (x, y - 40), (x, y - 52)]
    return np.array(points)


@settings(deadline=None, max_examples=40)
@given(angles, st.floats(0.3, 3.0), st.floats(-50, 500), st.floats(-50, 500))
def test_tracking_roi_moves_with_the_hand(angle: float, scale: float, u: float, v: float) -> None:
    base = make_landmarks()
    first = roi_from(base)
    straight = np.delete(base, [4, 7, 8, 11, 12, 15, 16, 19, 20], axis=0) @ rotation(first.angle)
    assert first.side == pytest.approx(2.0 * np.ptp(straight, axis=0).max())
    moved = roi_from(base @ rotation(angle).T * scale + (u, v))
    centre = rotation(angle) @ (first.u, first.v) * scale + (u, v)
    assert (moved.u, moved.v) == pytest.approx(tuple(centre), abs=1e-6)
    assert moved.side == pytest.approx(first.side * scale)
    assert np.cos(moved.angle - first.angle - angle) == pytest.approx(1.0)


# -- depth ---------------------------------------------------------------------------------------


def make_hand(z: float, pinhole: Pinhole, size: float = 1.0) -> Hand:
    """A flat hand of `size` times the assumed size at distance z [m], facing the camera."""
    plane = make_landmarks() * 1e-3 * 1.4
    world = np.column_stack([plane - plane.mean(axis=0), np.zeros(21)])
    pixels = plane * size * pinhole.fx / z + (320, 260)
    return Hand(pixels, world, 1.0, 0.5, 1.0, Roi(320, 240, 200))


PINHOLE = Pinhole.from_hfov(640, 480, 1.2)


@settings(deadline=None, max_examples=40)
@given(st.floats(0.4, 1.4), st.floats(0.75, 1.3), st.integers(0, 1000))
def test_palm_point_from_depth(z: float, size: float, seed: int) -> None:
    hand = make_hand(z + 0.012, PINHOLE, size)
    rng = np.random.default_rng(seed)
    depth = np.full((480, 640), 2.5, np.float32)
    hull = cv2.convexHull(np.rint(hand.landmarks).astype(np.int32))
    cv2.fillConvexPoly(depth, hull, z)
    depth += rng.normal(0, 0.004, depth.shape).astype(np.float32)
    depth[rng.random(depth.shape) < 0.3] = 0.0
    palm = locate_palm(hand, depth, PINHOLE)
    assert palm is not None and palm.plausible
    assert palm.p_CP[2] == pytest.approx(z + 0.012, abs=0.006)
    assert np.allclose(PINHOLE.project(palm.p_CP), hand.landmarks[[0, 1, 5, 9, 13, 17]].mean(axis=0))
    pixels = hand.landmarks[[0, 1, 5, 9, 13, 17]]
    widest = max(np.linalg.norm(a - b) for a in pixels for b in pixels)
    assert palm.span == pytest.approx(widest / PINHOLE.fx * (z + 0.012), rel=0.02)


@pytest.mark.parametrize("size", [0.35, 2.2])
def test_wrong_size_is_not_a_hand(size: float) -> None:
    """A face is about twice as large as a hand; a doll's hand is too small."""
    palm = locate_palm(make_hand(0.8, PINHOLE, size), np.full((480, 640), 0.788, np.float32), PINHOLE)
    assert palm is not None and not palm.plausible


def test_no_depth_no_point() -> None:
    hand = make_hand(0.8, PINHOLE)
    assert locate_palm(hand, np.zeros((480, 640), np.float32), PINHOLE) is None
    far = replace(hand, landmarks=hand.landmarks + 5000)
    assert locate_palm(far, np.ones((480, 640), np.float32), PINHOLE) is None
    broken = replace(hand, landmarks=hand.landmarks * np.nan)
    assert locate_palm(broken, np.ones((480, 640), np.float32), PINHOLE) is None


def test_isolate_keeps_what_is_at_the_hand() -> None:
    """A hand (0.8 m) before a wall (2 m), with holes on it and a band beside it that has no depth."""
    depth = np.full((100, 200), 2.0, np.float32)
    depth[20:80, 80:160] = 0.8
    depth[20:80, 50:80] = 0.0  # hidden from the second imager
    depth[40:60, 100:130] = 0.0  # seen at a grazing angle
    depth[0:10] = 0.3  # something in front
    rgb = np.full((100, 200, 3), 7, np.uint8)
    kept = isolate(rgb, depth, [0.85], 500.0)[..., 0] == 7
    assert kept[20:80, 80:160].all()
    assert not kept[12:16].any() and not kept[0:10].any() and not kept[:, 165:].any()
    assert not kept[25:75, 50:76].any()
    assert kept[25:75, 78:80].all()  # the rim may still be the hand's
    both = isolate(rgb, depth, [0.85, 2.0], 500.0)[..., 0] == 7
    assert both[12:].all() and not both[0:5].any()


def test_isolate_keeps_a_hand_in_the_shadow_of_something_nearer() -> None:
    """A body (0.4 m) hides a part of a hand (0.8 m) from the second imager; behind is a wall (2 m)."""
    depth = np.full((100, 200), 2.0, np.float32)
    depth[30:50, 80:100] = 0.8
    depth[:, 120:] = 0.4
    depth[30:70, 100:120] = 0.0  # the rest of the hand, and some wall
    depth[50:70, 80:100] = 0.0  # a thumb that points down
    rgb = np.full((100, 200, 3), 7, np.uint8)
    kept = isolate(rgb, depth, [0.85], 200.0)[..., 0] == 7
    assert kept[30:70, 80:118].all()
    assert not kept[:, 124:].any() and not kept[:, :70].any() and not kept[80:].any()


# -- the networks --------------------------------------------------------------------------------


def picture(name: str) -> np.ndarray:
    """A rendered hand, (200, 200, 3) RGB."""
    return np.asarray(cv2.imread(str(DATA / f"hand_{name}.png"))[..., ::-1])


@needs_models
@pytest.mark.parametrize("name", ["up", "down"])
def test_landmarks_are_those_of_mediapipe(name: str) -> None:
    """The reference is MediaPipe 0.10.21 itself, on the same image; see tests/data."""
    expected = json.loads((DATA / "hand_landmarks.json").read_text())[name]
    (hand,) = HandTracker(config=TrackerConfig(hands=1)).update(picture(name), [letterbox(200, 200)])
    assert np.abs(hand.landmarks - expected["landmarks"]).max() < 0.05
    assert np.abs(hand.world - expected["world"]).max() < 5e-4
    assert hand.presence > 0.9
    assert (hand.p_right > 0.5) == (name == "up")  # the pictures show a right and a left hand
    assert classify(hand).gesture.value == name


@needs_models
def test_tracking_follows_and_lets_go() -> None:
    tracker = HandTracker()
    rgb = np.full((300, 400, 3), 90, np.uint8)
    found = []
    for step in range(6):
        frame = rgb.copy()
        frame[20 + 5 * step : 220 + 5 * step, 30 + 12 * step : 230 + 12 * step] = picture("up")
        (hand,) = tracker.update(frame, [Roi(140 + 12 * step, 120 + 5 * step, 200)])
        found.append(hand.landmarks[9])
    moved = np.diff(found, axis=0)
    assert np.abs(moved - (12, 5)).max() < 4
    assert tracker.update(rgb, [Roi(200, 150, 200)]) == ()
    assert tracker.update(rgb, []) == ()


@needs_models
def test_two_hands_and_no_hand_twice() -> None:
    rgb = np.concatenate([picture("up"), picture("down")], axis=1)
    left, right = Roi(100, 100, 200), Roi(300, 100, 200)
    tracker = HandTracker()
    for _ in range(3):
        hands = tracker.update(rgb, [left, left, right, right])
        assert len(hands) == 2
        assert hands[0].landmarks[:, 0].max() < 200 < hands[1].landmarks[:, 0].min()
    # The candidates decide which hand stays when there is room for one.
    single = HandTracker(config=TrackerConfig(hands=1))
    single.update(rgb, [left])
    (hand,) = single.update(rgb, [right])
    assert hand.landmarks[:, 0].min() > 200


@needs_models
def test_tracking_is_deterministic() -> None:
    runs = []
    for _ in range(2):
        tracker = HandTracker()
        for _ in range(2):
            tracker.reset()
            hands = [tracker.update(picture("down"), [Roi(105, 98, 190)]) for _ in range(4)]
            runs.append(np.array([h.landmarks for (h,) in hands]))
    assert all(np.array_equal(runs[0], other) for other in runs[1:])


@needs_models
def test_nothing_is_found_in_noise() -> None:
    rgb = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
    tracker = HandTracker()
    assert tracker.update(rgb, [Roi(320, 240, 240), Roi(0, 0, 200)]) == ()
    assert tracker.update(rgb, []) == ()
