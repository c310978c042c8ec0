"""TB-Dec-PPO: advantages, per-agent clipping, the alpha-vector value."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cell.learn.networks import Actors, Critic, believed, generator, joint_types
from cell.learn.ppo import DecPpo, clip_per_agent
from cell.learn.rollout import Rollout
from cell.learn.settings import paper

FEATURES = np.eye(6, dtype=np.float32)
MASK = np.ones((2, 6, 9), np.bool_)


def rollout(steps: int = 4, envs: int = 3) -> Rollout:
    rng = np.random.default_rng(0)
    zero = np.zeros(envs, np.int64)
    return Rollout(
        torch.from_numpy(rng.integers(0, 6, (steps + 1, envs, 2))),
        torch.from_numpy(rng.random((steps + 1, envs, 2, 1), np.float32)),
        torch.from_numpy(rng.integers(0, 9, (steps, envs, 2))),
        {},
        zero,
        zero,
        zero,
        zero,
        zero > 0,
    )


def test_gae_by_hand() -> None:
    ppo, r = DecPpo(FEATURES, MASK, paper()), rollout()
    reward = torch.arange(12.0).view(4, 3)
    with torch.no_grad():
        v = ppo.critic(r.local.flatten(0, 1), r.belief.flatten(0, 1)).view(5, 3)
    advantage, target = ppo.advantages(r, reward)
    delta = [reward[t, 1] + 0.95 * v[t + 1, 1] - v[t, 1] for t in range(4)]
    by_hand = sum((0.95 * 0.95) ** t * delta[t] for t in range(4))
    assert float(advantage.view(4, 3)[0, 1]) == pytest.approx(float(by_hand), rel=1e-5)
    assert torch.allclose(target, advantage + v[:-1].flatten())


def test_masked_actions_have_no_probability() -> None:
    mask = MASK.copy()
    mask[0, 2] = False
    mask[0, 2, 4] = True
    mask[1, 3] = False  # a state without any legal action stays defined
    policy = Actors(FEATURES, mask, (8,), True, generator(1))
    p = policy(torch.tensor([[2, 3]]), torch.zeros(1, 2, 1)).exp()
    assert p[0, 0, 4] == 1.0 and torch.isfinite(p).all()


def test_each_agent_has_its_own_gradient_norm() -> None:
    policy = Actors(FEATURES, MASK, (8,), True, generator(1))
    for p in policy.parameters():
        p.grad = torch.ones_like(p)
        p.grad[1] *= 1e-6
    small = [p.grad[1].clone() for p in policy.parameters() if p.grad is not None]
    clip_per_agent(policy, 0.5)
    grads = [p.grad for p in policy.parameters() if p.grad is not None]
    assert float(torch.stack([g[0].square().sum() for g in grads]).sum().sqrt()) == pytest.approx(
        0.5, rel=1e-4
    )
    assert all(torch.equal(g[1], s) for g, s in zip(grads, small, strict=True))


def test_only_learners_learn() -> None:
    ppo, r = DecPpo(FEATURES, MASK, paper(epochs=1)), rollout()
    before = [p.detach().clone() for p in ppo.actors.parameters()]
    ppo.update(r, torch.rand(4, 3, generator=generator(2)), generator(3), learners=[0])
    after = [p.detach() for p in ppo.actors.parameters()]
    moved = [(a - b).abs().amax((1, 2)) for a, b in zip(before, after, strict=True)]
    assert all(float(m[1]) == 0.0 for m in moved) and any(float(m[0]) > 0.0 for m in moved)


def test_alpha_value_is_convex_and_weighs_joint_types() -> None:
    critic = Critic(FEATURES, 2, (8,), True, generator(4), alphas=3)
    local = torch.tensor([[1, 2]]).repeat(3, 1)
    belief = torch.tensor([[[0.0], [1.0]], [[0.4], [1.0]], [[0.8], [1.0]]])
    low, mid, high = critic(local, belief).tolist()
    assert mid <= (low + high) / 2 + 1e-6
    assert believed(belief)[:, 0].tolist() == [1.0, 1.0, 1.0]  # the human's belief is about the robot
    assert joint_types(torch.tensor([[1.0, 0.25]])).tolist() == [[0.0, 0.75, 0.0, 0.25]]
