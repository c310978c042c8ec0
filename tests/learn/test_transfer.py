"""One reward from demonstrations at several recovery times, and what adapting is worth at each."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from cell.errors import ConfigError
from cell.learn import reports, runs, studies
from cell.learn.belief.bank import bank
from cell.learn.belief.tracker import last_gesture
from cell.learn.commands import bank_for
from cell.learn.domain.presets import preset
from cell.learn.job import Job
from cell.learn.settings import tuned
from cell.learn.transfer import PooledAirl, Task

PAPER = preset("paper")
SMALL = tuned(iterations=2, envs=4, discriminator_steps=3, minibatch=200)


def test_one_reward_explains_several_tasks_each_with_its_own_policies() -> None:
    runs.single_thread()
    told = bank(PAPER.agents, [last_gesture()])

    def trained() -> PooledAirl:
        places = [replace(PAPER, recovery=time) for time in (5, 40)]
        run = PooledAirl([Task(p, told, runs.demonstrations(p, told, 2)) for p in places], SMALL)
        assert [len(rollouts) for rollouts in run.iterate()] == [2, 2]
        return run

    first, again = trained(), trained()
    mine, other = (list(ppo.actors.parameters()) for ppo in first.learners)
    assert not all(torch.equal(a, b) for a, b in zip(mine, other, strict=True))
    for a, b in zip(first.discriminator.f.parameters(), again.discriminator.f.parameters(), strict=True):
        assert torch.equal(a, b)


def test_transfer_needs_an_optimum_and_a_choice() -> None:
    job = Job(1, 10, SMALL, "announced")
    for name in ("released", "cell"):
        rules = preset(name)
        with pytest.raises(ConfigError, match=f"not {name}"):
            reports.REPORTS["transfer"](rules, bank_for(rules, "announced"), job, lambda _: None)


def test_the_price_decides_whether_adapting_pays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studies, "RECOVERIES", (5, 20))
    monkeypatch.setattr(studies, "PRICES", (0.0, 0.5))
    job = Job(1, 200, SMALL, "announced")
    rows = studies.prices(PAPER, bank_for(PAPER, "announced"), job, lambda _: None)
    by = {(r["method"], r["recovery"], r["price"]): r["reward_priced"]["mean"] for r in rows}
    assert by["expert", 20, 0.5] == pytest.approx(38.05, abs=0.35)
    assert by["expert", 20, 0.0] == pytest.approx(39.40, abs=0.35)
    assert by["dp", 20, 0.0] == pytest.approx(45.05, abs=0.02) and by["dp", 5, 0.5] == pytest.approx(
        42.96, abs=0.02
    )
    assert all(by["expert", *key] < by["dp", *key] for key in ((5, 0.0), (5, 0.5), (20, 0.0), (20, 0.5)))
