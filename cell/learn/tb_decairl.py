"""TB-DecAIRL: Algorithm 1 of "Adaptive Human-Robot Collaboration using Type-Based IRL".

Expert trajectories (s, a) of N agents whose types are hidden from one another are given. Beliefs over
the partners' types come from a frozen, pre-trained module. A discriminator and decentralised policies
are trained against each other; what the discriminator ends with is the reward, what the policies end
with is the behaviour. Without beliefs (`Settings.beliefs` False) the same file is Dec-AIRL.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from cell.learn.belief.bank import BeliefBank
from cell.learn.demonstrations import derived
from cell.learn.discriminator import Discriminator, Source, Transitions
from cell.learn.domain.presets import Preset
from cell.learn.domain.vector import make
from cell.learn.networks import generator
from cell.learn.ppo import DecPpo
from cell.learn.rollout import roll, sampling
from cell.learn.settings import Settings


@dataclass(frozen=True)
class Progress:
    """One iteration: joint environment steps so far, the discriminator's accuracy on its batches,
    mean learned reward per step, mean true rewards per episode, onions, mean policy entropy [nats]."""

    iteration: int
    env_steps: int
    accuracy: float
    learned_reward: float
    reward_truth: float
    reward_priced: float
    onions: float
    entropy: float


class TbDecAirl:
    """A training run; everything that changes in it is in `ppo`, `discriminator`, `replay`, `iteration`.

    Args:
        preset: of the domain. beliefs: the frozen belief module (with it, M_i of every agent i).
        expert: pooled expert transitions, belief trajectories included (Eq. 4). settings: see there.
    """

    def __init__(self, preset: Preset, beliefs: BeliefBank, expert: Transitions, settings: Settings) -> None:
        self.preset, self.beliefs, self.expert, self.settings = preset, beliefs, expert, settings
        domain = make(preset, 1, 0)
        self.ppo = DecPpo(domain.features, domain.mask, settings)
        self.discriminator = Discriminator(
            domain.features, domain.n_agents, settings, generator(settings.seed, 3)
        )
        self.replay: deque[Transitions] = deque(maxlen=settings.replay)
        self.iteration = 0

    def iterate(self) -> Iterator[Progress]:
        """Algorithm 1's outer loop; may be left and entered again at any iteration."""
        settings, ppo, discriminator = self.settings, self.ppo, self.discriminator
        while self.iteration < settings.iterations:
            # All randomness of an iteration follows from (seed, iteration): a resumed run is the same run.
            rng = generator(settings.seed, 4, self.iteration)
            domain = make(self.preset, settings.envs, derived(settings.seed, 5, self.iteration))
            share = settings.share(self.iteration)

            # Roll the policies pi_i(a_i | s_i, b_i) out; b_i follows the observed actions (Eq. 3, learned).
            acting = sampling(ppo.actors, domain.horizon, settings.envs, rng)
            rollout = roll(domain, self.beliefs, acting)
            policy = rollout.transitions()  # pooled (s, b, a, s', b') of all agents
            self.replay.append(policy)

            # Train D = e^f / (e^f + pi), f = g + gamma h' - h, to tell expert from policy (Eq. 5).
            discriminator.set_share(share)
            seen = Transitions.join(list(self.replay))
            accuracy = discriminator.train([Source(self.expert, seen, ppo.actors)], rng)

            # The reward: R(s, b, a, s', b') = log D - log(1 - D) (Eq. 2), common to all agents.
            reward = discriminator.reward(policy, ppo.actors).view(domain.horizon, settings.envs)

            # TB-Dec-PPO: all actors and the one centralised critic, on that reward.
            report = ppo.update(rollout, reward, rng, share)

            self.iteration += 1
            yield Progress(
                self.iteration,
                self.iteration * settings.envs * domain.horizon,
                accuracy,
                float(reward.mean()),
                float(rollout.returns("truth").mean()),
                float(rollout.returns("priced").mean()),
                float(rollout.onions.mean()),
                report.entropy,
            )
