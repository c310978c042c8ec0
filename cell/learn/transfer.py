"""Reward transfer: one reward from demonstrations at several recovery times, optimised at others.

A reward learnt at one recovery time may hide that time's dynamics. Here every demonstrated recovery
time has its own policies and critic, all judged by one discriminator, so f has to explain every
demonstration at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from cell.learn.belief.bank import BeliefBank
from cell.learn.cloning import clone
from cell.learn.demonstrations import demonstrate, derived, play
from cell.learn.discriminator import Discriminator, Source, Transitions
from cell.learn.domain.presets import Preset
from cell.learn.domain.vector import make
from cell.learn.networks import generator
from cell.learn.optimise import optimise, true_reward
from cell.learn.ppo import DecPpo
from cell.learn.rollout import Rollout, greedy, roll, sampling
from cell.learn.settings import Settings, tuned


@dataclass(frozen=True)
class Task:
    """Demonstrations at one recovery time, and the beliefs held there."""

    preset: Preset
    beliefs: BeliefBank
    expert: Transitions


class PooledAirl:
    """TB-DecAIRL with one reward and, per task, its own policies and critic."""

    def __init__(self, tasks: Sequence[Task], settings: Settings) -> None:
        self.tasks, self.settings = tuple(tasks), settings
        domain = make(tasks[0].preset, 1, 0)
        self.learners = [DecPpo(domain.features, domain.mask, settings) for _ in tasks]
        self.discriminator = Discriminator(
            domain.features, domain.n_agents, settings, generator(settings.seed, 3)
        )

    def iterate(self) -> Iterator[list[Rollout]]:
        """The outer loop of `tb_decairl`, over all tasks; yields the tasks' rollouts."""
        settings, judge = self.settings, self.discriminator
        replay: list[deque[Transitions]] = [deque(maxlen=settings.replay) for _ in self.tasks]
        for iteration in range(settings.iterations):
            rng = generator(settings.seed, 12, iteration)
            share = settings.share(iteration)
            rollouts: list[Rollout] = []
            for index, (task, ppo) in enumerate(zip(self.tasks, self.learners, strict=True)):
                domain = make(task.preset, settings.envs, derived(settings.seed, 13, iteration, index))
                acting = sampling(ppo.actors, domain.horizon, settings.envs, rng)
                rollouts.append(roll(domain, task.beliefs, acting))
                replay[index].append(rollouts[-1].transitions())
            judge.set_share(share)
            sources = [
                Source(task.expert, Transitions.join(list(seen)), ppo.actors)
                for task, seen, ppo in zip(self.tasks, replay, self.learners, strict=True)
            ]
            judge.train(sources, rng)
            for ppo, rollout in zip(self.learners, rollouts, strict=True):
                reward = judge.reward(rollout.transitions(), ppo.actors).view(rollout.action.shape[:2])
                ppo.update(rollout, reward, rng, share)
            yield rollouts


def best_response(
    preset: Preset,
    beliefs: BeliefBank,
    settings: Settings,
    starts: Sequence[str] = ("expert", "never-speed-up"),
) -> DecPpo:
    """The robots' policies optimised for the true reward beside the expert human.

    Args:
        settings: of the optimisation, see `refine`. starts: hand-coded rules the robot is cloned from;
            the best end (greedy, 300 episodes) is returned, since each start may end in its own optimum.
    """
    found: list[tuple[float, DecPpo]] = []
    for kind in starts:
        demos = demonstrate(preset, beliefs, 100, derived(settings.seed, 14), kind)
        domain = make(preset, 1, 0)
        actors = clone(domain.features, domain.mask, demos, settings.change(lr_actor=3e-3), updates=400)
        ppo = DecPpo(domain.features, domain.mask, settings)
        ppo.actors.load_state_dict(actors.state_dict())
        for _ in optimise(preset, beliefs, true_reward(), settings, ppo, preset.robots):
            pass
        score = (
            play(preset, beliefs, greedy(ppo.actors), 300, derived(settings.seed, 15))
            .returns("priced")
            .mean()
        )
        found.append((float(score), ppo))
    return max(found, key=lambda pair: pair[0])[1]


def refine(**changes: Any) -> Settings:
    """Settings for optimising a given reward from a good start: smaller steps, longer sight."""
    return tuned(
        iterations=40, envs=64, minibatch=1600, gamma=0.98, lr_actor=1e-3, entropy=0.003, anneal=0.05
    ).change(**changes)
