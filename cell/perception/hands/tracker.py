"""Up to two hands over time.

A tracked hand costs one network run an image. The palm detector looks only where no hand is
held, and now and then where one is: a track can hold on to a wrong reading of a hand, e.g. with
the fingers taken for the thumb, which a fresh look mends. Every search turns and scales its
square differently, because a hand missed in one crop is often found in the next.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.perception.hands.landmarks import Hand, LandmarkNetwork
from cell.perception.hands.palm import PalmDetector
from cell.perception.hands.roi import Roi

_TURNS = np.deg2rad([0.0, 30.0, -30.0, 60.0, -60.0, 15.0, -15.0, 90.0, -90.0])
_SCALES = (1.0, 0.85, 1.1, 0.95, 0.8, 1.05)
"""How the squares of successive searches differ."""
_GUESSES = np.deg2rad([-90.0, 90.0, -45.0, 45.0, -135.0, 135.0, 0.0, 180.0])
_HAND = 0.55
"""Side of the square that a hand fills, as a share of a candidate's."""
_PALMS = 2
"""Palms of one search that the landmark network is asked about."""
_SURE = 0.9
_HOPELESS = 0.05
"""Presence above which a new hand is taken as it is, and below which it is given up."""


@dataclass(frozen=True)
class TrackerConfig:
    """When a hand counts as found.

    Attributes:
        palm: least score of a palm. presence: least presence of a hand, new or tracked.
        overlap: IoU above which two regions are the same hand. hands: most hands at once.
        middle: a hand belongs to a candidate if its palm lies in this middle part of the square's
            side: the rest is there to show the hand whole, and may show another one.
        look_again: a tracked hand is also searched for anew in every so many-th image; 0 never.
        threads: CPU threads of one inference.
    """

    palm: float = 0.3
    presence: float = 0.5
    overlap: float = 0.5
    hands: int = 2
    middle: float = 0.6
    look_again: int = 2
    threads: int = 2


class HandTracker:
    """Hands in a sequence of images.

    Args:
        folder: of the networks' files; the cache if None.
        config: thresholds.

    Raises:
        HandModelError: a network is missing or wrong.
    """

    def __init__(self, folder: Path | None = None, config: TrackerConfig | None = None) -> None:
        self._config = config or TrackerConfig()
        self._palms = PalmDetector(folder, self._config.threads)
        self._landmarks = LandmarkNetwork(folder, self._config.threads)
        self._held: tuple[Hand, ...] = ()
        self._images = 0

    def reset(self) -> None:
        """Forget all hands, e.g. after a gap in the images."""
        self._held = ()
        self._images = 0

    def update(self, rgb: NDArray[np.uint8], candidates: Sequence[Roi]) -> tuple[Hand, ...]:
        """The hands of the next image.

        Args:
            rgb: shape (H, W, 3) uint8.
            candidates: squares that may show a hand, the most important first; centre and side
                from depth (0.40 to 0.45 m across). Hands that belong to none of them give way to
                new ones.

        Returns:
            At most `TrackerConfig.hands` hands, first those in candidates, in their order.
        """
        every = self._config.look_again
        again = every > 0 and self._images % every == every - 1
        tracked = self._distinct(self._landmarks.find(rgb, h.next_roi(), h.score) for h in self._held)
        hands: list[Hand] = []
        for candidate in candidates:
            held = [h for h in tracked if self._belongs(h, candidate) and h not in hands]
            if len(hands) >= self._config.hands:
                break
            new = self._search(rgb, candidate, hands) if again or not held else None
            best = max([*held[:1], *([new] if new else [])], key=lambda h: h.presence, default=None)
            if best is not None and self._is_new(best, hands):
                hands.append(best)
        for hand in tracked:
            if len(hands) < self._config.hands and self._is_new(hand, hands):
                hands.append(hand)
        self._held = tuple(hands)
        self._images += 1
        return self._held

    def _search(self, rgb: NDArray[np.uint8], candidate: Roi, others: Sequence[Hand]) -> Hand | None:
        """A hand in a square, other than those already there."""
        turn, scale = _TURNS[self._images % len(_TURNS)], _SCALES[self._images % len(_SCALES)]
        square = Roi(candidate.u, candidate.v, candidate.side * scale, candidate.angle + float(turn))
        best: Hand | None = None
        for palm in self._palms.detect(rgb, square, self._config.palm)[:_PALMS]:
            hand = self._landmarks.find(rgb, palm.roi(), palm.score)
            if _HOPELESS < hand.presence < _SURE:  # a region from landmarks fits better than one from a palm
                hand = max(
                    hand, self._landmarks.find(rgb, hand.next_roi(), palm.score), key=lambda h: h.presence
                )
            if not (self._belongs(hand, candidate) and self._is_new(hand, others)):
                continue
            if best is None or hand.presence > best.presence:
                best = hand
            if best.presence > _SURE:
                return best
        if best is None or best.presence < self._config.presence:
            guess = self._guess(rgb, candidate)
            if self._belongs(guess, candidate) and self._is_new(guess, others):
                return guess
        return best

    def _guess(self, rgb: NDArray[np.uint8], candidate: Roi) -> Hand:
        """Without a palm: a hand of usual size in the middle, its fingers in a direction that varies."""
        turn = candidate.angle + float(_GUESSES[self._images % len(_GUESSES)])
        square = Roi(candidate.u, candidate.v, candidate.side * _HAND, turn)
        hand = self._landmarks.find(rgb, square, self._config.palm)
        if hand.presence > _HOPELESS:
            hand = self._landmarks.find(rgb, hand.next_roi(), self._config.palm)
        return hand

    def _distinct(self, hands: Iterable[Hand]) -> list[Hand]:
        out: list[Hand] = []
        for hand in sorted(hands, key=lambda h: -h.presence):
            if self._is_new(hand, out):
                out.append(hand)
        return out

    def _is_new(self, hand: Hand, others: Sequence[Hand]) -> bool:
        """Whether this is a hand, and none of the others."""
        if hand.presence < self._config.presence:
            return False
        roi = hand.next_roi()
        return all(roi.iou(other.next_roi()) <= self._config.overlap for other in others)

    def _belongs(self, hand: Hand, candidate: Roi) -> bool:
        u, v = hand.landmarks[[0, 5, 9, 13, 17]].mean(axis=0)
        middle = Roi(candidate.u, candidate.v, candidate.side * self._config.middle)
        return middle.contains(float(u), float(v))
