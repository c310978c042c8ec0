"""What happened in a round, tick by tick, beside the truth: the material of all figures."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cell.config import CellConfig
from cell.decision.io import Inputs, Outputs
from cell.errors import ConfigError
from cell.frames import Array
from cell.limits import tcp_jacobian
from cell.wire.types import ShownGesture, Truth
from cell.wire.vocabulary import Action, Mode

SIGNS = {"": 0, "up": 1, "down": 2}
"""Signs as numbers in a log's columns."""
_TICK = (
    "t", "speed", "cap", "mode", "requested", "permitted", "separation", "belief", "robot", "human_seen",
    "sign_seen", "robot_moving", "sorted", "own_type",
)  # fmt: skip
_TRUTH = ("human", "sign", "fatigued", "true_separation")


@dataclass(frozen=True)
class Log:
    """One round.

    Attributes:
        columns: by name, one value per supervisor tick: times [s], speeds [m/s], distances [m]; `robot`,
            `human_seen` and the true `human` are `Action`s, `mode` a `Mode`, signs as in `SIGNS`.
            Without a simulated person the true columns are missing.
        gestures: signs that were really shown.
    """

    columns: dict[str, Array]
    gestures: tuple[ShownGesture, ...] = ()

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    @property
    def with_person(self) -> bool:
        return "human" in self.columns

    def to_bytes(self) -> bytes:
        """Compressed; single precision, but for the times, which may be a wall clock's."""
        shown = [[SIGNS[g.sign], g.shown, g.answered] for g in self.gestures]
        out = io.BytesIO()
        arrays: dict[str, Any] = {
            k: v.astype(np.float64 if k == "t" else np.float32) for k, v in self.columns.items()
        }
        np.savez_compressed(out, gestures=np.array(shown, float).reshape(-1, 3), **arrays)
        return out.getvalue()


def read_log(path: Path) -> Log:
    """What `Log.to_bytes` wrote; raises `ConfigError`."""
    try:
        with np.load(path) as data:
            columns = {k: np.asarray(data[k], float) for k in data.files if k != "gestures"}
            names = {number: sign for sign, number in SIGNS.items()}
            shown = tuple(ShownGesture(names[int(g[0])], float(g[1]), float(g[2])) for g in data["gestures"])
    except (OSError, ValueError, KeyError) as error:
        raise ConfigError(f"cannot read {path}: {error}") from None
    return Log(columns, shown)


def segments(values: Array) -> list[tuple[int, int, int]]:
    """(value, first, end) of each run of equal values (N,); `end` is one past the last."""
    starts = np.flatnonzero(np.diff(values, prepend=np.nan))
    return [(int(values[a]), int(a), int(b)) for a, b in zip(starts, [*starts[1:], len(values)], strict=True)]


class Logger:
    """Collects one round; `tick` after every supervisor tick, `truth` whenever it is known."""

    def __init__(self, config: CellConfig) -> None:
        self._length = config.gripper.length
        self._rows: list[tuple[float, ...]] = []
        self._truths: list[tuple[float, ...]] = []
        self._gestures: tuple[ShownGesture, ...] = ()
        self._events: list[dict[str, Any]] = []
        self._before: dict[str, Any] = {}
        self.last_truth: Truth | None = None

    def tick(self, inputs: Inputs, outputs: Outputs) -> None:
        """One tick."""
        s = outputs.state
        v = tcp_jacobian(inputs.joints.q[None], self._length)[0] @ inputs.joints.qd
        moving = inputs.arm.moving or inputs.gripper.moving
        self._rows.append(
            (
                inputs.t, float(np.linalg.norm(v)), s.speed_cap, s.mode, s.requested_industrial,
                s.permitted_industrial, s.separation, s.belief, s.action, s.human_action, SIGNS[s.gesture],
                moving, s.sorted, s.own_type,
            )
        )  # fmt: skip
        for event in outputs.events:
            self._say(event.t, event.name, event.text, level=event.level)
        self._note(inputs.t, "mode", Mode(s.mode).name.lower())
        self._note(inputs.t, "robot", Action(s.action).name.lower())
        self._note(inputs.t, "cap", s.binding_cap)
        self._note(inputs.t, "sign seen", s.gesture)

    def truth(self, truth: Truth) -> None:
        """What is true at `truth.t`."""
        self.last_truth = truth
        person = truth.person
        if person is None:
            return
        self._gestures = person.gestures
        self._truths.append(
            (truth.t, person.action, SIGNS[person.gesture], person.fatigued, person.separation)
        )
        self._note(truth.t, "person", Action(person.action).name.lower())
        self._note(truth.t, "fatigued", person.fatigued)

    def log(self) -> Log:
        """Everything so far; the truth at a tick is the newest known then."""
        columns = dict(zip(_TICK, np.array(self._rows, float).reshape(-1, len(_TICK)).T, strict=True))
        if self._truths:
            known = np.array(self._truths, float)
            at = np.clip(np.searchsorted(known[:, 0], columns["t"] + 1e-9, side="right") - 1, 0, None)
            columns |= dict(zip(_TRUTH, known[at, 1:].T, strict=True))
        return Log(columns, self._gestures)

    def events(self) -> str:
        """JSON lines, in the order of time."""
        return "".join(json.dumps(e) + "\n" for e in sorted(self._events, key=lambda e: e["t"]))

    def _note(self, t: float, what: str, value: Any) -> None:
        """An event when a value changes."""
        if self._before.get(what, _NOTHING) != value:
            self._before[what] = value
            self._events.append({"t": round(t, 3), "what": what, "value": value})

    def _say(self, t: float, name: str, text: str, level: int) -> None:
        self._events.append({"t": round(t, 3), "what": name, "value": text, "level": level})


_NOTHING = object()
