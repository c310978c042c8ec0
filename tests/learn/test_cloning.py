"""Behaviour cloning copies the expert where it is a function of what the actors see."""

from __future__ import annotations

from cell.learn import runs
from cell.learn.belief.bank import bank
from cell.learn.belief.tracker import last_gesture
from cell.learn.domain.presets import preset
from cell.learn.settings import tuned


def test_cloning_needs_the_belief() -> None:
    rules = preset("paper")
    beliefs = bank(rules.agents, [last_gesture()])
    demos = runs.demonstrations(rules, beliefs, episodes=50)
    agreement = {}
    for sees in (True, False):
        actors = runs.cloned(rules, demos, tuned(beliefs=sees), updates=300)
        best = actors(demos.local, demos.belief).argmax(-1).t()
        agreement[sees] = (best == demos.action).float().mean(0).tolist()
    assert agreement[True][0] > 0.999 and agreement[True][1] > 0.999
    assert agreement[False][0] < 0.95
