"""Belief weights that come with the package, and the belief bank of a preset made from them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from cell.errors import ConfigError
from cell.learn.belief.bank import BeliefBank, bank
from cell.learn.belief.gru import GruBelief, GruNet, load_gru
from cell.learn.belief.tracker import BeliefTracker


def shipped(preset: str, label: str) -> Path:
    """Where the weights for a preset and label are shipped."""
    return Path(str(files("cell.learn.belief") / "weights" / f"{preset}-{label}.safetensors"))


def load(preset: str, label: str = "announced", path: Path | None = None) -> GruNet:
    """Belief network by file, or the shipped one of a preset and label.

    Raises:
        ConfigError: there is none; says how to train it.
    """
    chosen = shipped(preset, label) if path is None else path
    if not chosen.is_file():
        raise ConfigError(
            f"no belief weights {chosen}; train them: `cell train belief --preset {preset} --label {label}`"
        )
    return load_gru(chosen)


def gru_bank(agents: Sequence[str], net: GruNet, start: float = 0.0) -> BeliefBank:
    """Every person is watched by a tracker with the same frozen network.

    Args:
        agents: the preset's names. start: P(type 1) of a robot before it announced anything.
    """
    people: list[BeliefTracker] = [GruBelief(net) for name in agents if not name.startswith("robot")]
    return bank(agents, people, start)
