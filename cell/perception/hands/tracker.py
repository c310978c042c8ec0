"""Up to two hands over time: palms are looked for only where no hand is held already."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.perception.hands.landmarks import Hand, LandmarkNetwork
from cell.perception.hands.palm import PalmDetector
from cell.perception.hands.roi import Roi


@dataclass(frozen=True)
class TrackerConfig:
    """When a hand counts as found.

    Attributes:
        palm: least score of a palm. presence: least presence of a hand, new or tracked.
        overlap: IoU above which two regions are the same hand. hands: most hands at once.
        threads: CPU threads of one inference.
    """

    palm: float = 0.3
    presence: float = 0.5
    overlap: float = 0.5
    hands: int = 2
    threads: int = 1


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

    def reset(self) -> None:
        """Forget all hands, e.g. after a gap in the images."""
        self._held = ()

    def update(self, rgb: NDArray[np.uint8], candidates: Sequence[Roi]) -> tuple[Hand, ...]:
        """The hands of the next image.

        Args:
            rgb: shape (H, W, 3) uint8.
            candidates: squares that may show a hand, the most important first; centre and side
                from depth (0.40 to 0.45 m across). Hands inside none of them give way to new ones.

        Returns:
            At most `TrackerConfig.hands` hands: first the tracked, then the new ones.
        """
        hands: list[Hand] = []
        for old in self._held:
            self._take(hands, self._landmarks.find(rgb, old.next_roi(), old.score))
        wanted = [h for h in hands if any(_inside(h, c) for c in candidates)]
        spare = [h for h in hands if h not in wanted]
        hands = wanted
        for candidate in candidates:
            if len(hands) >= self._config.hands:
                break
            if any(_inside(hand, candidate) for hand in hands):
                continue
            for palm in self._palms.detect(rgb, candidate, self._config.palm):
                roi = palm.roi()
                if all(roi.iou(h.next_roi()) <= self._config.overlap for h in hands) and self._take(
                    hands, self._landmarks.find(rgb, roi, palm.score)
                ):
                    break
        for hand in spare:
            if len(hands) < self._config.hands:
                self._take(hands, hand)
        self._held = tuple(hands)
        return self._held

    def _take(self, hands: list[Hand], hand: Hand) -> bool:
        """Add a hand if it is one and not there already."""
        if hand.presence < self._config.presence:
            return False
        roi = hand.next_roi()
        if any(roi.iou(other.next_roi()) > self._config.overlap for other in hands):
            return False
        hands.append(hand)
        return True


def _inside(hand: Hand, candidate: Roi) -> bool:
    """Whether the middle of the palm lies in the candidate."""
    u, v = hand.landmarks[[0, 5, 9, 13, 17]].mean(axis=0)
    return candidate.contains(float(u), float(v))
