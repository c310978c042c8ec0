"""Which onion is which over time, so that a sorted one is never taken again.

Tracks live in the world frame. A look associates detections with tracks by mutual nearest
neighbour; what a look should have shown but did not is forgotten after a few looks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from cell.frames import Array

_GATE = 0.045
"""A detection farther than this from a track is another onion [m]: half the least spacing."""
_ROLLED = 0.12
"""Onions left over after that may have rolled this far [m]."""
_FORGET_AFTER = 3
"""Looks in a row without the onion after which its track is dropped; a sorted one is remembered,
since taking it again would be worse than remembering a place where nothing lies."""


class Status(Enum):
    """What is to be done with an onion."""

    WAITING = "waiting"
    SORTED = "sorted"
    SET_ASIDE = "set aside"


@dataclass(frozen=True)
class Sighting:
    """One detected onion in the world: centre (3,) [m], radius [m], P(blemished), score."""

    p_WO: Array
    radius: float
    p_blemished: float
    score: float


@dataclass(frozen=True)
class Track:
    """An onion over time.

    Attributes:
        id: never reused. p_WO (3,), radius [m], p_blemished: from the newest sighting.
        status, attempts: what to do; grasps that failed. missed: looks in a row without it.
        reason: why it was set aside.
    """

    id: int
    p_WO: Array
    radius: float
    p_blemished: float
    status: Status = Status.WAITING
    attempts: int = 0
    missed: int = 0
    reason: str = ""


class Tracker:
    """All onions known to be on the belt."""

    def __init__(self) -> None:
        self._tracks: dict[int, Track] = {}
        self._next = 1

    @property
    def tracks(self) -> tuple[Track, ...]:
        return tuple(self._tracks.values())

    def waiting(self) -> list[Track]:
        """Onions still to be sorted, in order of their discovery."""
        return [t for t in self._tracks.values() if t.status is Status.WAITING]

    def get(self, track_id: int) -> Track | None:
        return self._tracks.get(track_id)

    def look(self, sightings: list[Sighting]) -> None:
        """Take in everything one image of the whole belt showed."""
        pairs = _associate([t.p_WO for t in self._tracks.values()], [s.p_WO for s in sightings])
        ids = list(self._tracks)
        matched = {ids[i]: j for i, j in pairs.items()}
        for track_id in ids:
            track = self._tracks[track_id]
            if track_id in matched:
                s = sightings[matched[track_id]]
                self._tracks[track_id] = replace(
                    track, p_WO=s.p_WO, radius=s.radius, p_blemished=s.p_blemished, missed=0
                )
            elif track.missed + 1 >= _FORGET_AFTER and track.status is not Status.SORTED:
                del self._tracks[track_id]
            else:
                self._tracks[track_id] = replace(track, missed=track.missed + 1)
        for j in sorted(set(range(len(sightings))) - set(matched.values())):
            s = sightings[j]
            self._tracks[self._next] = Track(self._next, s.p_WO, s.radius, s.p_blemished)
            self._next += 1

    def taken(self, track_id: int) -> None:
        """The onion left the belt: in the hand for the bin."""
        self._tracks.pop(track_id, None)

    def placed(self, track_id: int, p_WO: Array) -> None:
        """The onion was put back on the belt at `p_WO` (3,) [m], sorted."""
        track = self._tracks.get(track_id)
        if track is None:
            track = Track(track_id, p_WO, 0.035, 0.0)
        self._tracks[track_id] = replace(track, p_WO=p_WO, status=Status.SORTED, missed=0)

    def failed(self, track_id: int, most: int, reason: str) -> None:
        """A grasp failed; after `most` of them the onion is set aside with the reason."""
        track = self._tracks.get(track_id)
        if track is None:
            return
        attempts = track.attempts + 1
        status = Status.SET_ASIDE if attempts >= most else track.status
        self._tracks[track_id] = replace(track, attempts=attempts, status=status, reason=reason)


def _associate(tracks: list[Array], sightings: list[Array]) -> dict[int, int]:
    """Sighting index of each track that was seen: near ones first, then those that rolled away."""
    pairs: dict[int, int] = {}
    for gate in (_GATE, _ROLLED):
        left_t = [i for i in range(len(tracks)) if i not in pairs]
        left_s = [j for j in range(len(sightings)) if j not in pairs.values()]
        found = _mutual_nearest([tracks[i] for i in left_t], [sightings[j] for j in left_s], gate)
        pairs |= {left_t[i]: left_s[j] for i, j in found}
    return pairs


def _mutual_nearest(tracks: list[Array], sightings: list[Array], gate: float) -> list[tuple[int, int]]:
    """Index pairs (track, sighting) that are each other's nearest and within `gate` [m]."""
    if not tracks or not sightings:
        return []
    delta = np.array(tracks)[:, None, :2] - np.array(sightings)[None, :, :2]
    distance = np.linalg.norm(delta, axis=2)
    nearest_sighting, nearest_track = distance.argmin(axis=1), distance.argmin(axis=0)
    return [
        (i, int(j))
        for i, j in enumerate(nearest_sighting)
        if nearest_track[j] == i and distance[i, j] <= gate
    ]
