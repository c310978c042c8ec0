"""Checkpoints: a resumed run is the same run."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from cell.errors import ConfigError
from cell.learn import checkpoint, runs
from cell.learn.belief.bank import bank
from cell.learn.belief.tracker import last_gesture
from cell.learn.domain.presets import preset
from cell.learn.settings import tuned
from cell.learn.tb_decairl import Progress, TbDecAirl

SMALL = tuned(iterations=4, envs=4, discriminator_steps=3, minibatch=200, replay=2)


def fresh(episodes: int = 4, **changes: int) -> TbDecAirl:
    rules = preset("paper", **changes)
    beliefs = bank(rules.agents, [last_gesture()])
    return runs.start("tb-decairl", rules, beliefs, runs.demonstrations(rules, beliefs, episodes), SMALL)


def test_resumed_run_is_bit_identical(tmp_path: Path) -> None:
    whole = fresh()
    runs.train(whole)
    half = fresh()
    for progress in half.iterate():
        if progress.iteration == 2:
            break
    checkpoint.save(half, tmp_path / "c.safetensors")
    resumed = fresh()
    runs.train(resumed, tmp_path / "c.safetensors")
    assert resumed.iteration == 4
    for a, b in (
        (whole.ppo.actors, resumed.ppo.actors),
        (whole.ppo.critic, resumed.ppo.critic),
        (whole.discriminator.f, resumed.discriminator.f),
    ):
        assert all(torch.equal(x, y) for x, y in zip(a.parameters(), b.parameters(), strict=True))
    assert checkpoint.settings_of(tmp_path / "c.safetensors") == ("paper", SMALL)


def test_the_curve_goes_on_where_it_stopped(tmp_path: Path) -> None:
    class Interrupted(Exception):
        pass

    def stop(progress: Progress) -> None:
        if progress.iteration == 3:
            raise Interrupted

    path, whole = tmp_path / "c.safetensors", runs.train(fresh())
    with pytest.raises(Interrupted):
        runs.train(fresh(), path, save_every=2, report=stop)
    resumed = runs.train(fresh(), path, save_every=2)
    assert resumed.progress == whole.progress  # of all four iterations, two of them from the file
    assert len(resumed.seconds) == 4 and resumed.seconds == sorted(resumed.seconds)
    path.with_suffix(".json").write_text("{")
    with pytest.raises(ConfigError, match="cannot read learning curve"):
        runs.train(fresh(), path)


def test_wrong_checkpoints_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "c.safetensors"
    with pytest.raises(ConfigError, match="cannot read"):
        checkpoint.restore(fresh(), path)
    checkpoint.save(fresh(), path)
    other = fresh()
    other.settings = SMALL.change(seed=9)
    with pytest.raises(ConfigError, match="belongs to"):
        checkpoint.restore(other, path)
    with pytest.raises(ConfigError, match="recovery 20, not 10"):
        checkpoint.restore(fresh(recovery=10), path)
    with pytest.raises(ConfigError, match="other demonstrations"):
        checkpoint.restore(fresh(episodes=5), path)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ConfigError, match="cannot read"):
        checkpoint.restore(fresh(), path)
