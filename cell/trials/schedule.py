"""Which rounds a campaign has, in which order, and with which seeds.

A person goes through blocks; in a block each policy has one round, on the same batch and the same
chance. The order within a block turns with person and block, so that no policy is always first.
Seeds come from (campaign, person, block) by a hash: nothing depends on workers or on what ran before.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from cell.errors import ConfigError
from cell.trials.settings import Settings


@dataclass(frozen=True)
class RoundSpec:
    """One round.

    Attributes:
        id: unique, and the name of its files. person: number from 1. persona: who that is.
        block: number from 1; rounds of one person and block are paired. order: place in the person's rounds.
        contender: index of the policy. seed: of batch and person.
    """

    id: str
    person: int
    persona: str
    block: int
    order: int
    contender: int
    seed: int


def schedule(settings: Settings) -> list[RoundSpec]:
    """All rounds: person by person, in the order in which each would live them."""
    count = len(settings.contenders)
    out = []
    for person, persona in enumerate(settings.people, start=1):
        for block in range(1, settings.rounds // count + 1):
            for place in range(count):
                which = (place + person + block) % count
                order = (block - 1) * count + place + 1
                name = f"p{person:02d}-r{order:02d}-{_plain(settings.contenders[which].name)}"
                seed = derive(settings.seed, person, block)
                out.append(RoundSpec(name, person, persona, block, order, which, seed))
    return out


def derive(*numbers: int) -> int:
    """A seed below 2^31 from several numbers, by SHA-256."""
    text = ":".join(str(n) for n in numbers)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big") >> 1


def shard(specs: Sequence[RoundSpec], text: str) -> list[RoundSpec]:
    """Part i of n, from "i/n" with i from 1; everything for an empty text."""
    if not text:
        return list(specs)
    i, _, n = text.partition("/")
    if not (i.isdecimal() and n.isdecimal() and 1 <= int(i) <= int(n)):
        raise ConfigError(f"--shard must be i/n with i from 1 to n, e.g. 2/4, got {text!r}")
    return list(specs[int(i) - 1 :: int(n)])


def _plain(name: str) -> str:
    """A policy's name as part of a file's name."""
    stem = name.rsplit("/", 1)[-1].removesuffix(".csv")
    return "".join(c if c.isalnum() or c in "-_" else "-" for c in stem)[:40]
