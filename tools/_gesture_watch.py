"""From random image sequences to readings and signs, as the person camera's software does it."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _gesture_scenes import RATE, Plan, View, camera, film

from cell.clock import perf_s
from cell.config import load
from cell.perception.hands.depth import isolate, locate_palm
from cell.perception.hands.gesture import Gesture, Reading, classify
from cell.perception.hands.roi import Roi
from cell.perception.hands.tracker import HandTracker
from cell.perception.hands.vote import GestureVote, VoteConfig

_ACROSS, _ALONG = 0.10, 0.03
"""Errors of the place that depth gives: share of the square's side, and [m] along the line of sight."""


@dataclass(frozen=True)
class Glance:
    """What came of one image.

    Attributes:
        found: whether there was a hand. reading: of a hand of plausible size, else None.
        error: mean of the landmarks' errors, in palm sizes; infinite without a hand.
        ms: duration of everything, rendering apart.
    """

    found: bool
    reading: Reading | None
    error: float
    ms: float


@dataclass(frozen=True)
class Outcome:
    """What came of one sequence.

    Attributes:
        plan: what it showed. sign: first that counted, "" for none. at: when [s]; -1 for none.
        glances: one per image.
    """

    plan: Plan
    sign: str
    at: float
    glances: tuple[Glance, ...]


class Watcher:
    """The whole way from images to a sign that counts."""

    def __init__(self) -> None:
        config = load().gestures
        self._crop = config.crop
        self._votes = VoteConfig(votes=config.votes, window=config.window)
        self._tracker = HandTracker(Path(config.models) if config.models else None)
        self._pinhole = camera()[1]

    def watch(self, plan: Plan) -> Outcome:
        """Play one sequence."""
        self._tracker.reset()
        vote, rng = GestureVote(self._votes), np.random.default_rng([0x0D5, plan.seed])
        sign, at, glances = Gesture.NONE, -1.0, []
        for i, view in enumerate(film(plan)):
            distance = view.distance + rng.normal(0.0, _ALONG)
            side = self._crop * self._pinhole.fx / distance
            u, v = (view.landmarks[0] + view.landmarks[9]) / 2 + rng.normal(0.0, _ACROSS * side, 2)
            glance = self._look(view, Roi(float(u), float(v), float(side)), distance)
            glances.append(glance)
            now = vote.push(i / RATE, glance.reading.gesture if glance.reading else Gesture.NONE, True)
            if sign is Gesture.NONE and now is not Gesture.NONE:
                sign, at = now, i / RATE
        return Outcome(plan, sign.value, at, tuple(glances))

    def _look(self, view: View, roi: Roi, distance: float) -> Glance:
        start = perf_s()
        hands = self._tracker.update(isolate(view.rgb, view.depth, [distance], self._pinhole.fx), [roi])
        reading = None
        if hands:
            palm = locate_palm(hands[0], view.depth, self._pinhole, distance)
            if palm is not None and palm.plausible:
                reading = classify(hands[0], up_C=view.up_C)
        ms = 1e3 * (perf_s() - start)
        if not hands:
            return Glance(False, None, np.inf, ms)
        truth = view.landmarks
        size = np.linalg.norm(truth[9] - truth[0]) + np.linalg.norm(truth[5] - truth[17])
        error = np.linalg.norm(hands[0].landmarks - truth, axis=1).mean() / size
        return Glance(True, reading, float(error), ms)


def watch_all(plans: list[Plan], processes: int) -> Iterator[Outcome]:
    """The outcomes, in order."""
    with ProcessPoolExecutor(processes) as pool:
        yield from pool.map(_watch, plans)


_watcher: Watcher | None = None


def _watch(plan: Plan) -> Outcome:
    global _watcher
    _watcher = _watcher or Watcher()
    return _watcher.watch(plan)
