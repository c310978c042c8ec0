"""What a replay takes from a recording: the cell as it was, and its ticks in order."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.records import Attachment, Metadata

from cell.config import CellConfig, from_dict
from cell.decision.io import Inputs
from cell.decision.policy import PolicyTable, parse
from cell.errors import CellError, DecodeError
from cell.record import tick
from cell.record.content import ABOUT, CONFIG_FILE, EYES, INPUTS, OPERATOR, OUTPUTS, POLICY_FILE, READABLE
from cell.record.mcap_reader import Recording
from cell.wire.types import OperatorCommand

_LARGEST = 8 * 1024 * 1024
_RECORD = "record a round with `cell run --record FILE`"


@dataclass(frozen=True)
class Then:
    """The cell as it was recorded. facts: names and versions."""

    facts: dict[str, str]
    config: CellConfig
    policy: PolicyTable

    @property
    def has_person(self) -> bool:
        return self.facts.get("companion") == EYES

    @property
    def whole(self) -> bool:
        """The frames of every camera are kept with every pixel: the hand networks can look again."""
        return self.facts.get("lossless") == "true"


@dataclass(frozen=True)
class Tick:
    """One recorded decision: number, inputs, searches of the hand networks, and outputs as CDR."""

    number: int
    inputs: Inputs
    searches: tuple[tick.Search, ...]
    outputs: bytes


class Recorded:
    """A recording with decisions in it.

    Raises:
        DecodeError: not readable, or no decisions of a cell that can be built again.
    """

    def __init__(self, path: Path) -> None:
        self._recording = Recording(path)
        self.path = path
        self.then = self._read_about()

    @property
    def ended_early(self) -> str:
        """Why the file has no end, once it was read; empty if it has one."""
        if self._recording.finished:
            return ""
        return self._recording.problem or "its writer was killed or the disk was full"

    def ticks(self) -> Iterator[Tick]:
        """The decisions in order; raises DecodeError where one is missing or garbled."""
        expected, waiting = 0, None
        ordered: dict[int, tuple[OperatorCommand, ...]] = {}
        for item in self._recording.items(frozenset({INPUTS, OUTPUTS, OPERATOR})):
            if isinstance(item, Metadata | Attachment):
                continue
            if item.topic == OPERATOR:
                ordered = dict([tick.decode_operator(item.payload)])
            elif item.topic == INPUTS:
                number, inputs, searches = tick.decode_inputs(item.payload)
                waiting = number, replace(inputs, operator=ordered.pop(number, ())), searches
                if waiting[0] != expected:
                    raise DecodeError(
                        f"{self.path}: tick {expected} was not recorded, so nothing after it can be replayed"
                    )
            elif waiting is not None:
                yield Tick(*waiting, item.payload)
                expected, waiting = expected + 1, None

    def _read_about(self) -> Then:
        facts: dict[str, str] = {}
        files: dict[str, bytes] = {}
        for item in self._recording.items(frozenset()):
            if isinstance(item, Metadata) and item.name == ABOUT:
                facts = dict(item.metadata)
            elif isinstance(item, Attachment) and item.name in (CONFIG_FILE, POLICY_FILE):
                files[item.name] = item.data[:_LARGEST]
            if facts and len(files) == 2:
                break
        if not facts or len(files) < 2:
            raise DecodeError(f"{self.path} holds no decisions to replay; {_RECORD}")
        if facts.get("format") not in READABLE:
            raise DecodeError(
                f"{self.path}: replay format {facts.get('format', '')[:20]!r}; "
                f"this version reads {' and '.join(READABLE)}"
            )
        if facts.get("companion") not in (EYES, "none"):
            raise DecodeError(
                f"{self.path}: the person was watched by {facts.get('companion', '')[:40]!r}, which knew "
                "more than was recorded; rounds with the person camera or nobody can be replayed"
            )
        try:
            config = from_dict(json.loads(files[CONFIG_FILE]), f"{self.path}, {CONFIG_FILE}")
            policy = parse(files[POLICY_FILE].decode(), facts.get("policy", "recorded"))
        except (ValueError, RecursionError) as error:
            raise DecodeError(f"{self.path}: {CONFIG_FILE} or {POLICY_FILE} is garbled: {error}") from None
        except CellError as error:
            raise DecodeError(
                f"{self.path} was recorded with something today's code refuses: {error}"
            ) from None
        return Then(facts, config, policy)
