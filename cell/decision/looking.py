"""Looking, as often as it takes: at the belt, and at an onion in the hand."""

from __future__ import annotations

from collections.abc import Callable

from cell.decision.primitives import Primitives, Skill
from cell.frames import Array
from cell.perception.drift import DriftWatch
from cell.perception.look import Eye
from cell.perception.tracking import Tracker
from cell.wire.types import Detections

BLEMISHED_ABOVE = 0.5
"""P(blemished) from which an onion counts as blemished."""
_UNCERTAIN = (0.25, 0.75)
"""Between these the detector is asked again."""


class Looking:
    """The belt camera in the hands of the skills.

    Attributes:
        tracker: the onions known to be on the belt. detections: of all looks, for watchers.
        news: what is to be said about the camera.
    """

    def __init__(self, body: Primitives, eye: Eye) -> None:
        self.body = body
        self.tracker = Tracker()
        self.detections: list[Detections] = []
        self.news: list[str] = []
        self._eye = eye
        self._drift = DriftWatch(body.config, "belt")

    def at_belt(self) -> Skill[None]:
        """Take a frame of the belt into the tracker."""
        frame = yield from self.body.look("belt")
        seen = self._eye.belt(frame)
        self.detections.append(seen.detections)
        self.tracker.look(list(seen.sightings))
        if warning := self._drift.look(frame):
            self.news.append(warning)

    def again(self, track_id: int) -> Skill[float | None]:
        """P(blemished) of one onion in a new frame of the belt; None if it was not seen."""
        yield from self.at_belt()
        track = self.tracker.get(track_id)
        return track.p_blemished if track is not None and track.missed == 0 else None

    def at_held(self, p_WT: Array) -> Skill[float | None]:
        """P(blemished) of the onion held at `p_WT` (3,) [m] in a new frame; None if it was not found."""
        frame = yield from self.body.look("belt")
        seen = self._eye.held(frame, p_WT)
        self.detections.append(seen.detections)
        return seen.p_blemished if seen.found else None

    def until_certain(self, chance: float, again: Callable[[], Skill[float | None]]) -> Skill[float]:
        """Mean P(blemished) over as many looks as it takes to be certain, in bounds."""
        looks = [chance]
        while (
            len(looks) < self.body.config.supervisor.look_attempts
            and _UNCERTAIN[0] < sum(looks) / len(looks) < _UNCERTAIN[1]
        ):
            more = yield from again()
            if more is None:
                break
            looks.append(more)
        return sum(looks) / len(looks)
