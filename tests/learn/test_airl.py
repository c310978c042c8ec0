"""TB-DecAIRL: the discriminator's equations, and the whole loop on the `paper` domain."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cell.errors import ConfigError
from cell.learn import runs
from cell.learn.belief.bank import BeliefBank, bank
from cell.learn.belief.tracker import last_gesture
from cell.learn.demonstrations import expert, play
from cell.learn.discriminator import Discriminator, Source, Transitions
from cell.learn.domain.local import FEATURES
from cell.learn.domain.presets import preset
from cell.learn.domain.vector import make
from cell.learn.metrics import summary
from cell.learn.networks import Actors, generator
from cell.learn.settings import Settings, paper, tuned

PAPER = preset("paper")


def two() -> BeliefBank:
    return bank(PAPER.agents, [last_gesture()])


def some(count: int = 50) -> Transitions:
    return runs.demonstrations(PAPER, two(), episodes=2).take(torch.arange(count))


def actors(settings: Settings) -> Actors:
    domain = make(PAPER, 1, 0)
    return Actors(domain.features, domain.mask, (64, 64), settings.beliefs, generator(3))


def test_f_is_reward_plus_shaping_and_the_logit_is_f_minus_log_pi() -> None:
    settings, pool = paper(), some()
    policy = actors(settings)
    judge = Discriminator(FEATURES, 2, settings, generator(1))
    with torch.no_grad():
        here = judge.f.encode(pool.local, pool.belief)
        there = judge.f.encode(pool.next_local, pool.next_belief)
        by_hand = judge.f.task(here, pool.action) + 0.95 * judge.f.h(there)[:, 0] - judge.f.h(here)[:, 0]
        assert torch.allclose(judge.f(pool), by_hand, atol=1e-6)
        log_pi = policy.log_prob(pool.local, pool.belief, pool.action).sum(1)
        d = by_hand.exp() / (by_hand.exp() + log_pi.exp())
        assert torch.allclose(d.log() - (1 - d).log(), judge.reward(pool, policy), atol=1e-4)  # Eq. 2
    assert here.shape == (50, 2 * 15 + 2 * 2)


def test_the_baseline_sees_no_beliefs() -> None:
    settings, pool = paper(beliefs=False), some()
    judge = Discriminator(FEATURES, 2, settings, generator(1))
    blind = Transitions(pool.local, 1 - pool.belief, pool.action, pool.next_local, 1 - pool.next_belief)
    with torch.no_grad():
        assert torch.equal(judge.f(pool), judge.f(blind))
        policy = actors(settings)
        assert torch.equal(policy(pool.local, pool.belief), policy(pool.local, 1 - pool.belief))


def test_the_discriminator_learns_to_tell_experts_from_noise() -> None:
    settings = tuned()
    policy = actors(settings)
    judge = Discriminator(FEATURES, 2, settings, generator(1))
    expert_pool = runs.demonstrations(PAPER, two(), episodes=10)
    noise = runs.rollout_of(PAPER, two(), policy, "sampled", 10, 1).transitions()
    rng = generator(2)
    accuracy = [judge.train([Source(expert_pool, noise, policy)], rng) for _ in range(4)][-1]
    assert accuracy > 0.85


def test_converges_to_the_expert_without_invalid_actions() -> None:
    run = runs.start("tb-decairl", PAPER, two(), runs.demonstrations(PAPER, two()), tuned(iterations=14))
    runs.train(run)
    reference = summary(play(PAPER, two(), expert(PAPER), 300, 5))["reward_priced"]["mean"]
    greedy = runs.rollout_of(PAPER, two(), run.ppo.actors, "greedy", 300, 5)
    assert summary(greedy)["reward_priced"]["mean"] > 0.99 * reference
    legal = make(PAPER, 1, 0).mask
    for agent in range(2):
        assert legal[agent, greedy.local[:-1, :, agent].numpy(), greedy.action[:, :, agent].numpy()].all()


def test_same_seed_same_bits() -> None:
    def parameters(seed: int) -> list[torch.Tensor]:
        demos = runs.demonstrations(PAPER, two(), episodes=5)
        run = runs.start("tb-decairl", PAPER, two(), demos, tuned(seed=seed, iterations=2, envs=8))
        runs.train(run)
        return [p.detach() for p in (*run.ppo.actors.parameters(), *run.discriminator.f.parameters())]

    first, again, other = parameters(1), parameters(1), parameters(2)
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(first, other, strict=True))


def test_three_agents() -> None:
    rules = preset("paper", agents=("robot", "human", "human"))
    beliefs = bank(rules.agents, [last_gesture(), last_gesture()])
    demos = runs.demonstrations(rules, beliefs, episodes=5)
    assert demos.belief.shape == (500, 3, 2)
    run = runs.start("tb-decairl", rules, beliefs, demos, tuned(iterations=2, envs=8, value="alpha"))
    curve = runs.train(run)
    assert len(curve.progress) == 2 and np.isfinite(curve.progress[-1].learned_reward)


def test_settings_refuse_nonsense() -> None:
    assert (paper().discriminator_batch, paper().lr_actor, paper().gamma) == (128, 3e-4, 0.95)
    with pytest.raises(ConfigError, match="legal values"):
        tuned(learning_rate=1.0)
    with pytest.raises(ConfigError, match="value"):
        tuned(value="linear")
    with pytest.raises(ConfigError, match="at least 1"):
        tuned(envs=0)
