"""Belief trackers: Eq. 3, the first-order filter, the GRU cell, and how they are judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.errors import ConfigError
from cell.learn.belief.auc import auc, beliefs, roc
from cell.learn.belief.bank import bank
from cell.learn.belief.eq3 import Eq3Belief, fit_kernel
from cell.learn.belief.gru import GruBelief, GruNet, TypeData, load_gru, save_gru, train_gru
from cell.learn.belief.hmm import HmmBelief, fit_hmm
from cell.learn.belief.tracker import last_gesture
from cell.learn.networks import generator


def gestures(seed: int, steps: int = 40, episodes: int = 60) -> TypeData:
    """A person that rests for six steps after thumbs-down, then shows thumbs-up."""
    rng = np.random.default_rng(seed)
    observed = rng.integers(1, 7, (steps, episodes)).astype(np.int8)
    types = np.zeros((steps + 1, episodes), np.int8)
    for episode in range(episodes):
        t = int(rng.integers(2, 12))
        while t + 8 < steps:
            observed[t, episode], observed[t + 1 : t + 7, episode], observed[t + 7, episode] = 8, 0, 7
            types[t + 1 : t + 8, episode] = 1
            t += 8 + int(rng.integers(2, 12))
    return TypeData(observed, types)


def test_eq3_by_hand() -> None:
    observed = np.array([[8, 8], [0, 0], [7, 0]], np.int8)
    types = np.array([[0, 0], [1, 1], [1, 0], [0, 0]], np.int8)
    kernel = fit_kernel(observed, types, unseen="identity")
    assert kernel.table[8, 0].tolist() == [0.0, 1.0]
    assert kernel.table[0, 1].tolist() == [0.5, 0.5]
    assert kernel.table[3].tolist() == [[1.0, 0.0], [0.0, 1.0]] and not kernel.seen[3].any()
    tracker = Eq3Belief(kernel, prior=0.0)
    assert tracker.reset(1).tolist() == [0.0]
    assert tracker.update(np.array([8], np.int8)).tolist() == [1.0]
    assert tracker.update(np.array([0], np.int8)).tolist() == [0.5]
    assert tracker.update(np.array([3], np.int8)).tolist() == [0.5]


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000))
def test_beliefs_are_probabilities(seed: int) -> None:
    data = gestures(seed, steps=20, episodes=4)
    for tracker in (
        Eq3Belief(fit_kernel(data.observed, data.types), 0.2),
        HmmBelief(fit_hmm(data.observed, data.types), 0.2),
        GruBelief(GruNet(generator(seed))),
        last_gesture(),
    ):
        values = beliefs(tracker, data)
        assert values.shape == data.observed.shape and values.dtype == np.float32
        assert ((values >= 0) & (values <= 1)).all()


def test_stepwise_gru_is_the_unrolled_gru() -> None:
    data, net = gestures(3), GruNet(generator(5))
    with torch.no_grad():
        whole = torch.softmax(net(torch.from_numpy(data.observed)), -1)[..., 1].numpy()
    assert np.abs(beliefs(GruBelief(net), data) - whole).max() < 1e-6


def test_gru_learns_the_announced_type_and_survives_the_file(tmp_path: Path) -> None:
    torch.set_num_threads(1)
    net = train_gru(gestures(1), seed=1, updates=60)
    test = gestures(2)
    assert auc(beliefs(GruBelief(net), test), test.types[1:]) > 0.99
    save_gru(net, tmp_path / "b.safetensors", {"label": "announced"})
    again = beliefs(GruBelief(load_gru(tmp_path / "b.safetensors")), test)
    assert np.array_equal(again, beliefs(GruBelief(net), test))
    same = train_gru(gestures(1), seed=1, updates=60)
    assert all(torch.equal(a, b) for a, b in zip(net.parameters(), same.parameters(), strict=True))


def test_bad_weights_are_refused(tmp_path: Path) -> None:
    from safetensors.torch import save_file

    with pytest.raises(ConfigError, match="cannot read"):
        load_gru(tmp_path / "missing.safetensors")
    (tmp_path / "junk.safetensors").write_bytes(b"junk")
    with pytest.raises(ConfigError, match="cannot read"):
        load_gru(tmp_path / "junk.safetensors")
    save_file({"x": torch.zeros(2)}, tmp_path / "other.safetensors")
    with pytest.raises(ConfigError, match="does not hold belief weights"):
        load_gru(tmp_path / "other.safetensors")


def test_three_agents_believe_about_each_other() -> None:
    beliefs_of = bank(("robot", "human", "human2"), [last_gesture(), last_gesture()])
    assert beliefs_of.reset(1)[0].tolist() == [[0, 0], [0, 0], [0, 0]]
    now = beliefs_of.update(np.array([[7, 8, 1]], np.int8))
    assert now[0].tolist() == [[1, 0], [1, 0], [1, 1]]
    with pytest.raises(ConfigError, match="2 of the agents"):
        bank(("robot", "human", "human2"), [last_gesture()])


def test_auc_counts_ties_half_and_roc_agrees() -> None:
    truth = np.array([0, 0, 1, 1], np.int8)
    assert auc(np.array([0.1, 0.4, 0.35, 0.8]), truth) == 0.75
    assert auc(np.array([0.5, 0.5, 0.5, 0.5]), truth) == 0.5
    rng = np.random.default_rng(0)
    many = (rng.random(500) < 0.4).astype(np.int8)
    score = np.round(rng.random(500) + many * 0.3, 2)
    fpr, tpr = roc(score, many, points=10_000)
    assert abs(float(np.trapezoid(tpr, fpr)) - auc(score, many)) < 1e-9
