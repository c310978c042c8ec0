"""The policy table: which action in which state, read from the CSV that the learner exports.

A file has an optional first comment line, `# preset=... seed=... commit=... belief_bins=0,0.5,1`,
then a header and one row per state: `onion_location, eef_location, prediction, own_type,
indicated, belief_bin, action, p_<action> ...`. Values are the names of `cell.wire.vocabulary`
in lower case. The table must be complete: the robot must know what to do everywhere.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from importlib.resources import files
from itertools import pairwise, product
from pathlib import Path
from typing import NamedTuple, TypeVar

from cell.errors import PolicyError, one_of
from cell.wire.vocabulary import Action, EefLocation, OnionLocation, Prediction, RobotType

STATE_COLUMNS = ("onion_location", "eef_location", "prediction", "own_type", "indicated", "belief_bin")
PROBABILITY_COLUMNS = tuple(f"p_{a.name.lower()}" for a in Action)
COLUMNS = (*STATE_COLUMNS, "action", *PROBABILITY_COLUMNS)
_MAX_BYTES = 4_000_000

E = TypeVar("E", bound=IntEnum)


class State(NamedTuple):
    """The robot's local state and the bin its belief falls into."""

    onion: OnionLocation
    eef: EefLocation
    prediction: Prediction
    own_type: RobotType
    indicated: int
    belief_bin: int


def states(belief_bins: int) -> Iterator[State]:
    """Every state that can occur (the published domain's 16 valid triples), in file order.

    An onion in front or at home is in the hand, so the hand is there too; an onion whose place
    is unknown has an unknown prediction, and only such an onion has.
    """
    for onion, eef, prediction in product(OnionLocation, EefLocation, Prediction):
        held = onion in (OnionLocation.IN_FRONT, OnionLocation.AT_HOME)
        if held and eef.name != onion.name:
            continue
        if (onion is OnionLocation.UNKNOWN) != (prediction is Prediction.UNKNOWN):
            continue
        for own_type, indicated, belief_bin in product(RobotType, (0, 1), range(belief_bins)):
            yield State(onion, eef, prediction, own_type, indicated, belief_bin)


def possible_actions(state: State) -> tuple[Action, ...]:
    """What the machine can do in a state (the learner's masks are a subset)."""
    held = state.onion in (OnionLocation.IN_FRONT, OnionLocation.AT_HOME)
    change = Action.SPEED_UP if state.own_type is RobotType.COLLABORATIVE else Action.SLOW_DOWN
    task: tuple[Action, ...]
    if held:
        task = (Action.INSPECT, Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN)
    elif state.onion is OnionLocation.ON_CONVEYOR:
        task = (Action.PICK,)
    else:
        task = (Action.DETECT, Action.DETECT_PICK)
    return (Action.NO_OP, *task, change)


@dataclass(frozen=True)
class PolicyTable:
    """A complete policy.

    Attributes:
        name: for people. bin_edges: belief bin edges, from 0 to 1.
        actions: most probable action per state.
    """

    name: str
    bin_edges: tuple[float, ...]
    actions: dict[State, Action]

    def belief_bin(self, belief: float) -> int:
        """Index of the bin that holds `belief` (P(fatigued), 0..1); the last bin is closed."""
        inner = self.bin_edges[1:-1]
        return sum(belief >= edge for edge in inner)

    def action(self, state: State) -> Action:
        """The action for a state."""
        return self.actions[state]


def shipped() -> dict[str, Path]:
    """Policies that come with the package, by name."""
    folder = Path(str(files("cell.decision") / "policies"))
    return {path.stem: path for path in sorted(folder.glob("*.csv"))}


def load(name_or_path: str) -> PolicyTable:
    """Read a policy by the name of a shipped one or by path.

    Raises:
        PolicyError: missing, not text, incomplete, contradictory or impossible; names the row.
    """
    known = shipped()
    path = known.get(name_or_path, Path(name_or_path))
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise PolicyError(f"policy {path} is larger than {_MAX_BYTES // 1_000_000} MB")
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise PolicyError(f"policy {path} is not a text file") from None
    except OSError as error:
        raise PolicyError(
            f"cannot read policy {name_or_path}: {error.strerror}; shipped policies: {', '.join(known)}"
        ) from None
    return parse(text, name=path.stem)


def parse(text: str, name: str) -> PolicyTable:
    """Policy from CSV text; see `load`."""
    lines = text.splitlines()
    edges: tuple[float, ...] = (0.0, 0.5, 1.0)
    start = 0
    while start < len(lines) and lines[start].startswith("#"):
        edges = _edges(lines[start], name) or edges
        start += 1
    reader = csv.reader(io.StringIO("\n".join(lines[start:])))
    try:
        header = tuple(cell.strip() for cell in next(reader))
        rows = [(start + reader.line_num, row) for row in reader if row]
    except (StopIteration, csv.Error) as error:
        raise PolicyError(f"policy {name}: no header row ({error})") from None
    if header != COLUMNS:
        raise PolicyError(
            f"policy {name}: the header must be {','.join(COLUMNS)}; got {','.join(header)[:200]}"
        )
    actions: dict[State, Action] = {}
    for number, row in rows:
        state, action = _row(row, f"policy {name}, line {number}", len(edges) - 1)
        if state in actions:
            raise PolicyError(f"policy {name}, line {number}: second row for {_text(state)}")
        actions[state] = action
    for state in states(len(edges) - 1):
        if state not in actions:
            raise PolicyError(f"policy {name}: no row for {_text(state)}")
    return PolicyTable(name, edges, actions)


def write(name: str, table: dict[State, Action], bin_edges: tuple[float, ...], comment: str) -> str:
    """CSV text of a deterministic policy; `comment` gives preset, seed and commit."""
    edges = ",".join(f"{e:g}" for e in bin_edges)
    lines = [f"# policy={name} {comment} belief_bins={edges}", ",".join(COLUMNS)]
    for state, action in table.items():
        chances = ["1" if action is a else "0" for a in Action]
        lines.append(",".join([*_words(state), action.name.lower(), *chances]))
    return "\n".join(lines) + "\n"


def _edges(comment: str, name: str) -> tuple[float, ...] | None:
    for word in comment.split():
        if word.startswith("belief_bins="):
            try:
                edges = tuple(float(v) for v in word.removeprefix("belief_bins=").split(","))
            except ValueError:
                raise PolicyError(f"policy {name}: belief_bins must be numbers, got {word!r}") from None
            rising = all(a < b for a, b in pairwise(edges))
            if len(edges) < 2 or len(edges) > 101 or edges[0] != 0.0 or edges[-1] != 1.0 or not rising:
                raise PolicyError(f"policy {name}: belief_bins must rise from 0 to 1, got {word!r}")
            return edges
    return None


def _row(row: list[str], where: str, bins: int) -> tuple[State, Action]:
    if len(row) != len(COLUMNS):
        raise PolicyError(f"{where}: {len(row)} cells instead of {len(COLUMNS)}")
    cells = dict(zip(COLUMNS, (c.strip() for c in row), strict=True))
    state = State(
        _member(OnionLocation, cells, "onion_location", where),
        _member(EefLocation, cells, "eef_location", where),
        _member(Prediction, cells, "prediction", where),
        _member(RobotType, cells, "own_type", where),
        _integer(cells, "indicated", 2, where),
        _integer(cells, "belief_bin", bins, where),
    )
    action = _member(Action, cells, "action", where)
    chances = []
    for column in PROBABILITY_COLUMNS:
        try:
            chances.append(float(cells[column]))
        except ValueError:
            raise PolicyError(f"{where}: {column} is not a number: {cells[column]!r}") from None
    if not all(math.isfinite(c) and 0 <= c <= 1 for c in chances) or abs(sum(chances) - 1) > 1e-3:
        raise PolicyError(f"{where}: the p_ columns must be probabilities that sum to 1")
    if action not in possible_actions(state):
        legal = [a.name.lower() for a in possible_actions(state)]
        raise PolicyError(f"{where}: action in {_text(state)}: {one_of(action.name.lower(), legal)}")
    return state, action


def _member(kind: type[E], cells: dict[str, str], column: str, where: str) -> E:
    try:
        return kind[cells[column].upper()]
    except KeyError:
        legal = [member.name.lower() for member in kind]
        raise PolicyError(f"{where}: {column}: {one_of(cells[column], legal)}") from None


def _integer(cells: dict[str, str], column: str, below: int, where: str) -> int:
    value = cells[column]
    if not value.isdecimal() or int(value) >= below:
        raise PolicyError(f"{where}: {column}: {one_of(value, range(below))}")
    return int(value)


def _words(state: State) -> list[str]:
    return [v.name.lower() if isinstance(v, IntEnum) else str(v) for v in state]


def _text(state: State) -> str:
    return ", ".join(f"{c}={w}" for c, w in zip(STATE_COLUMNS, _words(state), strict=True))
