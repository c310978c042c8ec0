"""A campaign in its folder: what is done, what is left, running the rest.

    campaign.json        the settings; another campaign is refused in the same folder
    rounds/ID.json       one finished round; ID.events.jsonl and ID.npz beside it (ID.mcap on request)
    sessions.jsonl       each time it ran: workers, wall time, rounds

A round is finished when its JSON is there; it is the last file written, and comes by renaming.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cell.clock import perf_s
from cell.errors import ConfigError
from cell.trials.log import Log, read_log
from cell.trials.one_round import RESULT, TICKS, Job
from cell.trials.schedule import RoundSpec, schedule
from cell.trials.settings import Settings, differences, from_dict
from cell.trials.workers import Workers
from cell.version import commit

MANIFEST, ROUNDS, SESSIONS = "campaign.json", "rounds", "sessions.jsonl"
Record = dict[str, Any]
"""One round's JSON."""


@dataclass
class Outcome:
    """What running did: rounds done now, and a line per round that could not be run."""

    done: int = 0
    problems: list[str] = field(default_factory=list)


class Campaign:
    """One folder.

    Args:
        folder: made if it is missing. settings: of a new campaign, or the same as those there.

    Raises:
        ConfigError: other settings are there, or the folder cannot be used.
    """

    def __init__(self, folder: Path, settings: Settings) -> None:
        self.folder, self.settings = folder, settings
        manifest = folder / MANIFEST
        try:
            (folder / ROUNDS).mkdir(parents=True, exist_ok=True)
            if manifest.is_file():
                before = from_dict(_read(manifest), manifest).as_dict()
                if changed := differences(before, settings.as_dict()):
                    raise ConfigError(
                        f"{folder} holds a campaign with other settings ({', '.join(changed)}); "
                        "give the same ones to continue it, or another --out"
                    )
            else:
                write_atomically(manifest, json.dumps(settings.as_dict(), indent=1).encode())
        except OSError as error:
            raise ConfigError(f"--out {folder}: {error.strerror}") from None

    def left(self, specs: Sequence[RoundSpec]) -> list[RoundSpec]:
        """Those of `specs` that have no result yet."""
        return [spec for spec in specs if not self._file(spec.id, RESULT).is_file()]

    def run(
        self,
        specs: Sequence[RoundSpec],
        workers: Workers,
        record: bool,
        report: Callable[[Record], None],
        complain: Callable[[str], None] = lambda line: None,
    ) -> Outcome:
        """Run the rounds that are left; `report` is told of each one done, `complain` of the others."""
        jobs = [self._job(spec, record) for spec in self.left(specs)]
        outcome, began = Outcome(), perf_s()
        try:
            for job, files in workers.run(jobs) if jobs else ():
                if isinstance(files, str):
                    outcome.problems.append(f"{job.spec.id}: {files}")
                    complain(outcome.problems[-1])
                    continue
                for ending, content in sorted(files.items(), key=lambda item: item[0] == RESULT):
                    write_atomically(self._file(job.spec.id, ending), content)
                outcome.done += 1
                report(json.loads(files[RESULT]))
        finally:
            if jobs:
                line = {"commit": commit(), "rounds": outcome.done, "wall_s": round(perf_s() - began, 2)}
                with (self.folder / SESSIONS).open("a") as file:
                    file.write(json.dumps(line) + "\n")
        return outcome

    def _job(self, spec: RoundSpec, record: bool) -> Job:
        s = self.settings
        target = str(self._file(spec.id, "mcap").resolve()) if record else ""
        return Job(spec, s.contenders[spec.contender], s.onions, s.backend, s.perception, s.config, target)

    def _file(self, name: str, ending: str) -> Path:
        return self.folder / ROUNDS / f"{name}.{ending}"


@dataclass(frozen=True)
class Results:
    """A campaign read back.

    Attributes:
        records: of finished rounds, in the order of the schedule. expected: number of rounds.
        sessions: each time it ran.
    """

    folder: Path
    settings: Settings
    records: list[Record]
    expected: int
    sessions: list[Record]

    def log(self, name: str) -> Log:
        """The ticks of one round."""
        return read_log(self.folder / ROUNDS / f"{name}.{TICKS}")


def read(folder: Path) -> Results:
    """The results in a folder; raises `ConfigError` where there is no campaign."""
    manifest = folder / MANIFEST
    settings = from_dict(_read(manifest), manifest)
    specs = schedule(settings)
    files = [folder / ROUNDS / f"{spec.id}.{RESULT}" for spec in specs]
    records = [_read(file) for file in files if file.is_file()]
    log = folder / SESSIONS
    sessions = [json.loads(line) for line in log.read_text().splitlines()] if log.is_file() else []
    return Results(folder, settings, records, len(specs), sessions)


def write_atomically(path: Path, content: bytes) -> None:
    """Whole, or not at all."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except OSError as error:
        raise ConfigError(f"no campaign: cannot read {path}: {error.strerror}") from None
    except ValueError:
        raise ConfigError(f"{path} is not JSON; delete it, and its round is run again") from None
