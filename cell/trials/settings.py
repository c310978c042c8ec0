"""The settings of a campaign: what decides its results, checked, and kept beside them."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from typing import Any

from cell.config import CellConfig, to_dict
from cell.errors import ConfigError, one_of
from cell.trials.contenders import Contender, contender

PEOPLE = ("ana", "bo", "chen", "dana", "efe")
"""The simulated people."""
BACKENDS, PERCEPTIONS = ("sim", "ur3e"), ("full", "truth")
FORMAT = 1


@dataclass(frozen=True)
class Settings:
    """Everything that a campaign's results depend on, besides the code.

    Attributes:
        people: personas, one per person; who comes twice is another one with other seeds.
        rounds: per person, a multiple of the number of policies.
        contenders: what is compared. onions: per round. seed: of the campaign.
        backend: "sim", or "ur3e": the emulated controller, in real time.
        perception: "full", or "truth": the supervisor is told of the person what the simulation knows.
        config: the cell, as plain data without the port.
    """

    people: tuple[str, ...]
    rounds: int
    contenders: tuple[Contender, ...]
    onions: int
    seed: int
    backend: str
    perception: str
    config: dict[str, Any]

    def __post_init__(self) -> None:
        names = [c.name for c in self.contenders]
        checks = [
            (1 <= len(self.people) <= 100, f"--people must be from 1 to 100, got {len(self.people)}"),
            (bool(names) and len(set(names)) == len(names), f"--policies: each once, got {','.join(names)}"),
            (
                1 <= self.rounds <= 1000 and self.rounds % max(len(names), 1) == 0,
                f"--rounds must be a multiple of the number of policies ({len(names)}), got {self.rounds}",
            ),
            (1 <= self.onions <= 15, f"--onions must be from 1 to 15, got {self.onions}"),
            (0 <= self.seed < 2**63, f"--seed must be from 0 to 2^63 - 1, got {self.seed}"),
            (self.backend in BACKENDS, f"--backend: {one_of(self.backend, BACKENDS)}"),
            (self.perception in PERCEPTIONS, f"--perception: {one_of(self.perception, PERCEPTIONS)}"),
            (
                self.backend == "sim" or self.perception == "full",
                "--perception truth belongs to --backend sim: the emulated cell has cameras",
            ),
        ]
        for fine, problem in checks:
            if not fine:
                raise ConfigError(problem)
        for person in self.people:
            if person not in PEOPLE:
                raise ConfigError(f"--people: {one_of(person, PEOPLE)}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the contenders, in order."""
        return tuple(c.name for c in self.contenders)

    def as_dict(self) -> dict[str, Any]:
        """For the manifest."""
        return json.loads(json.dumps({"format": FORMAT, **asdict(self)}))  # type: ignore[no-any-return]


def cell_data(config: CellConfig) -> dict[str, Any]:
    """A cell as the manifest keeps it: plain JSON, without the port, which every round chooses."""
    data: dict[str, Any] = json.loads(json.dumps(to_dict(config)))
    del data["port"]
    return data


def people(text: str) -> tuple[str, ...]:
    """ "5" -> the first five people, after efe from the start again; "ana,efe" -> these."""
    if text.isdecimal():
        return tuple(PEOPLE[i % len(PEOPLE)] for i in range(min(int(text), 101)))
    return tuple(name.strip() for name in text.split(","))


def contenders(text: str, perception: str) -> tuple[Contender, ...]:
    """The policies that a comma-separated list names."""
    return tuple(contender(name.strip(), perception) for name in text.split(",") if name.strip())


def from_dict(data: Any, source: object) -> Settings:
    """Settings from a manifest; raises `ConfigError`."""
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ConfigError(f"{source} is no manifest of a campaign (format {FORMAT})")
    try:
        values = {f.name: data[f.name] for f in fields(Settings)}
        values["people"] = tuple(values["people"])
        values["contenders"] = tuple(Contender(**c) for c in values["contenders"])
        return Settings(**values)
    except (KeyError, TypeError) as error:
        raise ConfigError(f"{source} is no manifest of a campaign: {error}") from None


def differences(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """Names of the settings in which two manifests differ."""
    return sorted(key for key in {*one, *other} if one.get(key) != other.get(key))
