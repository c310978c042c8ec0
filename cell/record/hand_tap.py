"""Notes what the hand networks were asked and what they answered, and says it again in a replay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cell.perception.hands.landmarks import Hand
from cell.perception.hands.roi import Roi
from cell.perception.person import HandFinder
from cell.record.tick import Search


class HandTap:
    """A hand finder that answers as another one does and notes every answer.

    Args:
        finder: who answers.
    """

    def __init__(self, finder: HandFinder) -> None:
        self._finder = finder
        self._searches: list[Search] = []

    def update(self, rgb: NDArray[np.uint8], candidates: list[Roi]) -> tuple[Hand, ...]:
        hands = self._finder.update(rgb, candidates)
        self._searches.append(Search(tuple(candidates), hands))
        return hands

    def reset(self) -> None:
        self._finder.reset()

    def take(self) -> tuple[Search, ...]:
        """The searches since the last call."""
        searches, self._searches = tuple(self._searches), []
        return searches


class RecordedHands:
    """A hand finder that gives recorded answers in their order.

    Attributes:
        strayed: how the questions differ from the recorded ones; empty while they do not.
    """

    def __init__(self) -> None:
        self._answers: list[Search] = []
        self.strayed = ""

    def expect(self, searches: Sequence[Search]) -> None:
        """The searches of the tick that comes."""
        self._answers = list(searches)

    def update(self, rgb: NDArray[np.uint8], candidates: list[Roi]) -> tuple[Hand, ...]:
        del rgb
        if not self._answers:
            self.strayed = self.strayed or f"asks for hands in {tuple(candidates)}; nothing was asked then"
            return ()
        recorded = self._answers.pop(0)
        if recorded.candidates != tuple(candidates):
            self.strayed = (
                self.strayed or f"asks for hands in {tuple(candidates)}; asked then: {recorded.candidates}"
            )
        return recorded.hands

    def reset(self) -> None:
        """Recorded answers remember nothing."""

    def unasked(self) -> int:
        """Recorded searches of this tick that did not happen now."""
        return len(self._answers)
