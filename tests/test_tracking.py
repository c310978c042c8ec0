"""Which onion is which: sorted ones stay sorted, lost ones are forgotten, hopeless ones set aside."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.config import load
from cell.frames import Array
from cell.perception.tracking import Sighting, Status, Tracker

SPACING = load().onions.spacing


def at(x: float, y: float, p_blemished: float = 0.0) -> Sighting:
    return Sighting(np.array([x, y, -0.115]), 0.035, p_blemished, 0.9)


def test_a_sorted_onion_is_never_taken_again_though_it_moves() -> None:
    """It rolls a little when it is let go, and detections jitter: 2 cm in all."""
    tracker = Tracker()
    tracker.look([at(0.30, 0.0), at(0.40, 0.0)])
    first, second = tracker.waiting()
    tracker.placed(first.id, np.array([0.30, 0.0, -0.115]))
    for shift in (0.02, 0.03, 0.015, 0.02, 0.0):
        tracker.look([at(0.30, shift), at(0.40, 0.0)])
        assert [t.id for t in tracker.waiting()] == [second.id]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 10))
def test_noise_never_swaps_or_revives_onions(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    true = grid(count)
    tracker = Tracker()
    tracker.look([at(*p) for p in true])
    ids = [t.id for t in tracker.tracks]
    done = set(rng.choice(ids, size=count // 2, replace=False).tolist())
    for track in tracker.tracks:
        if track.id in done:
            tracker.placed(track.id, track.p_WO)
    for look in range(6):
        # 8 mm of noise, any order, now and then one is missed, but never three times in a row.
        shown = [p for p in true if look % 3 == 0 or rng.random() > 0.3]
        seen = [at(*(p + rng.uniform(-0.008, 0.008, 2))) for p in shown]
        rng.shuffle(seen)  # type: ignore[arg-type]
        tracker.look(seen)
    by_id = {t.id: t for t in tracker.tracks}
    assert set(by_id) <= set(ids)
    for k, track_id in enumerate(ids):
        if track_id in by_id:
            assert np.linalg.norm(by_id[track_id].p_WO[:2] - true[k]) < 0.012
            assert (by_id[track_id].status is Status.SORTED) == (track_id in done)


def grid(count: int) -> list[Array]:
    """Places as close as onions may lie."""
    return [np.array([0.25 + SPACING * (i % 2), -0.30 + SPACING * (i // 2)]) for i in range(count)]


def test_what_is_not_seen_any_more_is_forgotten_and_comes_back_as_new() -> None:
    tracker = Tracker()
    tracker.look([at(0.30, 0.0)])
    (old,) = tracker.tracks
    tracker.look([])
    tracker.look([])
    assert [t.id for t in tracker.tracks] == [old.id]  # two misses are a detector's bad day
    tracker.look([])
    assert tracker.tracks == ()
    tracker.look([at(0.30, 0.0)])
    assert tracker.tracks[0].id != old.id


def test_a_miss_is_forgiven_when_it_is_seen_again() -> None:
    tracker = Tracker()
    for seen in ([at(0.3, 0.0)], [], [], [at(0.3, 0.0)], [], [], [at(0.3, 0.0)]):
        tracker.look(seen)
    assert len(tracker.tracks) == 1 and tracker.tracks[0].id == 1


def test_failed_grasps_count_and_in_the_end_it_is_set_aside_with_the_reason() -> None:
    tracker = Tracker()
    tracker.look([at(0.3, 0.0)])
    for attempt in (1, 2):
        tracker.failed(1, 3, "nothing between the fingers")
        tracker.look([at(0.301, 0.0)])
        assert tracker.waiting()[0].attempts == attempt
    tracker.failed(1, 3, "nothing between the fingers")
    tracker.look([at(0.301, 0.0)])
    assert tracker.waiting() == []
    track = tracker.get(1)
    assert track is not None and track.status is Status.SET_ASIDE
    assert track.reason == "nothing between the fingers"


def test_the_newest_sighting_counts() -> None:
    tracker = Tracker()
    for p in (0.2, 0.9, 0.1):
        tracker.look([at(0.3, 0.01 * p, p)])
        track = tracker.tracks[0]
        assert (track.p_blemished, track.p_WO[1]) == (p, 0.01 * p)


def test_taken_onions_are_gone_and_unknown_ids_harmless() -> None:
    tracker = Tracker()
    tracker.look([at(0.3, 0.0)])
    tracker.taken(1)
    tracker.taken(1)
    tracker.failed(1, 3, "x")
    assert tracker.tracks == ()
    tracker.placed(1, np.array([0.3, 0.1, -0.1]))  # forgotten while it was in the hand
    tracker.look([at(0.31, 0.1)])
    assert tracker.waiting() == [] and tracker.tracks[0].status is Status.SORTED
