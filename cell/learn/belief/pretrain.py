"""Pre-train the belief module on expert episodes, on several recovery times by default."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from cell.errors import ConfigError, one_of
from cell.learn.belief.gru import GruNet, TypeData, train_gru
from cell.learn.demonstrations import LABELS, derived, type_data
from cell.learn.domain.presets import Preset

MIXED = tuple(range(5, 44, 2))
"""Recovery times [steps] of the default training set: the belief must not learn to count to one."""


def mixed_data(preset: Preset, label: str, recoveries: Sequence[int], episodes: int, seed: int) -> TypeData:
    """`episodes` expert episodes at each recovery time.

    Args:
        label: "announced", "own" or "hidden": which reading of the person's type is the truth.
    """
    if label not in LABELS:
        raise ConfigError(f"belief label: {one_of(label, LABELS)}")
    parts = [
        type_data(replace(preset, recovery=recovery), label, episodes, derived(seed, 9, recovery))
        for recovery in recoveries
    ]
    return TypeData.join(parts)


def pretrain(
    preset: Preset,
    label: str = "announced",
    recoveries: Sequence[int] = MIXED,
    episodes: int = 40,
    seed: int = 1,
    updates: int = 350,
    progress: Callable[[int, float], None] | None = None,
) -> GruNet:
    """A frozen GRU trained on mixed recovery times; see `belief.gru.train_gru`."""
    data = mixed_data(preset, label, recoveries, episodes, seed)
    return train_gru(data, seed, updates=updates, progress=progress)
