"""Puts a recording's ticks through today's supervisor and compares what comes out, byte for byte.

No node, no wire, no simulation and no clock: configuration, policy and inputs come from the file. What
the hand networks answered is recorded and given again, unless the recording keeps the person camera's
frames whole; everything else (onion detector, separation, actions, belief, planning) runs anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cell.decision.belief import make_belief
from cell.decision.companion import Companion
from cell.decision.supervisor import Supervisor
from cell.errors import CellError, DecodeError
from cell.motion.planner import Planner
from cell.motion.views import InspectionViews
from cell.perception.detector import Detector
from cell.perception.person import PersonEye
from cell.record import tick
from cell.record.hand_tap import RecordedHands
from cell.replay.difference import Difference, first_difference
from cell.replay.recorded import Recorded, Then, Tick


@dataclass(frozen=True)
class Verdict:
    """What a replay showed.

    Attributes:
        ticks: compared. duration: of them in the round [s]. difference: the first, or None.
        ended_early: why the recording has no end; empty if it has one.
    """

    ticks: int
    duration: float
    difference: Difference | None
    ended_early: str


class Replay:
    """Today's supervisor in the recorded cell."""

    def __init__(self, then: Then) -> None:
        config = then.config
        self._hands = RecordedHands()
        planner, companion = Planner(config), None
        if then.has_person:
            eye = PersonEye(config, None if then.whole else self._hands)
            companion = Companion(config, eye, make_belief(config.supervisor.belief), planner.collision)
        self._whole = then.whole
        detector = Detector(Path(config.detector) if config.detector else None)
        holder = then.facts.get("holder", "supervisor")
        self._supervisor = Supervisor(
            config, then.policy, planner, InspectionViews(config), detector, holder, companion
        )

    def take(self, recorded: Tick, within: float = 0.0) -> Difference | None:
        """Decide anew; the first difference from what was decided then. within: see `replay`."""
        n, t = recorded.number, recorded.inputs.t
        self._hands.expect(recorded.searches)
        number, then = tick.decode_outputs(recorded.outputs)
        if number != n:
            raise DecodeError(f"the outputs of tick {n} carry the number {number}")
        try:
            now = self._supervisor.tick(recorded.inputs)
        except CellError as error:
            return Difference(n, t, "the tick itself", "outputs", f"{type(error).__name__}: {error}")
        data = tick.encode_outputs(n, now)
        if data != recorded.outputs:
            # Both sides as they read from bytes, so that only what is written counts.
            difference = first_difference(n, t, then, tick.decode_outputs(data)[1], within)
            if difference is not None or within == 0.0:
                return difference or Difference(n, t, "the bytes", "read the same", "read the same")
        if not self._whole:
            if self._hands.strayed:
                return Difference(n, t, "the hand networks", "what was asked then", self._hands.strayed)
            if self._hands.unasked():
                return Difference(n, t, "the hand networks", "were asked", "are not asked")
        return None


def replay(recorded: Recorded, progress: Callable[[int], None] | None = None, within: float = 0.0) -> Verdict:
    """Replay a recording up to the first difference.

    Args:
        within: numbers that differ by no more than this count as equal; 0 compares bytes. For recordings
            of another type of machine, whose arithmetic may differ in last bits.
        progress: called after every tick with its number.

    Raises:
        DecodeError: a tick is missing or garbled, or there is none.
    """
    again = Replay(recorded.then)
    ticks, begin, end = 0, 0.0, 0.0
    for one in recorded.ticks():
        begin, end = one.inputs.t if ticks == 0 else begin, one.inputs.t
        difference = again.take(one, within)
        ticks += 1
        if difference is not None:
            return Verdict(ticks, end - begin, difference, "")
        if progress is not None:
            progress(one.number)
    if ticks == 0:
        raise DecodeError(f"{recorded.path} holds no decisions")
    return Verdict(ticks, end - begin, None, recorded.ended_early)
