"""The result of a round: judged against the truth where there is one, written as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from cell.errors import ConfigError
from cell.wire.types import Truth


@dataclass(frozen=True)
class RoundResult:
    """One round; field names are the JSON contract. Times [s], speeds [m/s], distances [m].

    Where nobody knows what really became of the onions, by_human, misplaced and dropped are None, and
    `sorted` counts what the robot sorted and what the person was seen to sort. `misplaced_by_human` are
    those of `misplaced` that the person put there: people, simulated ones too, make mistakes.
    """

    backend: str
    policy: str
    seed: int
    person: str
    onions: int
    sorted: int
    by_robot: int
    by_human: int | None
    misplaced: int | None
    dropped: int | None
    sort_time_s: float
    mode_switches: int
    industrial_s: float
    min_separation_m: float | None
    max_tcp_speed_m_s: dict[str, float]
    gesture_delay_s: float | None
    real_time_factor: float
    commit: str
    version: str
    failure: str = ""
    arm_contacts: int | None = 0
    joint_states_lost: int = 0
    joint_limits: dict[str, float] = field(default_factory=dict)
    sha256: dict[str, str] = field(default_factory=dict)
    misses: tuple[str, ...] = ()
    yields: int = 0
    person_contacts: int | None = 0
    misplaced_by_human: int | None = None

    @property
    def succeeded(self) -> bool:
        """The round completed with every onion handled and nothing dropped, as far as is known."""
        return not self.failure and not self.dropped and self.sorted >= self.onions

    def write(self, path: Path) -> None:
        """Write the JSON file; raises `ConfigError` when the place cannot be written."""
        try:
            path.write_text(json.dumps(asdict(self), indent=2) + "\n")
        except OSError as error:
            raise ConfigError(f"cannot write {path}: {error.strerror}") from None


def judge(truth: Truth) -> tuple[int, int, tuple[str, ...]]:
    """(misplaced, dropped, a line per miss) by the world's own labels.

    Misplaced: a blemished onion on the belt or a sound one in the bin. Dropped: an onion that
    is neither on the belt nor in the bin when the round is over.
    """
    misplaced, dropped, lines = 0, 0, []
    for i, (blemished, place) in enumerate(zip(truth.blemished, truth.place, strict=True)):
        kind = "blemished" if blemished else "sound"
        where = ", ".join(f"{v:.3f}" for v in np.asarray(truth.p_WO[i]))
        if place not in ("belt", "bin"):
            dropped += 1
            lines.append(f"onion {i} ({kind}) dropped: {place} at ({where}) m")
        elif (place == "bin") != bool(blemished):
            misplaced += 1
            who = ", put there by the person" if truth.by_human[i] else ""
            lines.append(f"onion {i} ({kind}) ended on the {place} at ({where}) m{who}")
    return misplaced, dropped, tuple(lines)


def misplaced_by_human(truth: Truth) -> int:
    """Of the misplaced onions those that the person sorted."""
    in_bin = np.array([place == "bin" for place in truth.place])
    settled = np.array([place in ("belt", "bin") for place in truth.place])
    return int((settled & truth.by_human & (in_bin != truth.blemished)).sum())


def gesture_delay(truth: Truth) -> float | None:
    """Mean time from a sign's being shown to the person's seeing that it was understood [s]."""
    shown = () if truth.person is None else truth.person.gestures
    delays = [g.answered - g.shown for g in shown if g.answered >= 0.0]
    return round(sum(delays) / len(delays), 6) if delays else None
