"""Hyperparameters of TB-DecAIRL: the paper's as defaults, and the deviations that make it converge faster."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from cell.errors import ConfigError, one_of


@dataclass(frozen=True)
class Settings:
    """Everything a training run depends on, apart from the domain's preset and the belief.

    Defaults marked (P) are the paper's; the rest of the PPO follows the public baseline's code
    (5 epochs there are 10, 2,048 steps per iteration are 20 episodes of 100 here).

    Attributes:
        seed: of every random number of the run.
        beliefs: False removes beliefs everywhere: Dec-AIRL.
        iterations: passes of Algorithm 1's outer loop.
        envs: episodes rolled out per iteration.
        gamma, gae_lambda: discount and GAE's lambda (P).
        max_grad_norm: per network (P).
        lr_discriminator, lr_actor, lr_critic: Adam's step sizes (P).
        reward_hidden: hidden layers of g and h (P). policy_hidden: of actors and critic.
        discriminator_steps, discriminator_batch: updates per iteration, samples per side (P: 128).
        replay: iterations whose transitions the discriminator draws from (1 = the last only).
        bfloat16: train the discriminator with bfloat16 products (3 times as fast where the processor
            has them, slower elsewhere). Its reward is always evaluated in float32.
        epochs, minibatch: of PPO, in joint steps (P: batch 128).
        clip: PPO's ratio clip. entropy: its bonus. anneal: bonus and step sizes fall linearly to
            this share over the run (1 = constant).
        value: "mlp", or "alpha": V(s, b) = max over alpha-vectors of alpha(s) . b (P).
        alpha_vectors: how many, for "alpha".
    """

    seed: int = 1
    beliefs: bool = True
    iterations: int = 500
    envs: int = 20
    gamma: float = 0.95
    gae_lambda: float = 0.95
    max_grad_norm: float = 0.5
    lr_discriminator: float = 3e-4
    lr_actor: float = 3e-4
    lr_critic: float = 3e-4
    reward_hidden: tuple[int, ...] = (256, 256)
    policy_hidden: tuple[int, ...] = (64, 64)
    discriminator_steps: int = 10
    discriminator_batch: int = 128
    replay: int = 1
    bfloat16: bool = False
    epochs: int = 10
    minibatch: int = 128
    clip: float = 0.2
    entropy: float = 0.0
    anneal: float = 1.0
    value: str = "mlp"
    alpha_vectors: int = 4

    def __post_init__(self) -> None:
        if self.value not in ("mlp", "alpha"):
            raise ConfigError(f"value: {one_of(self.value, ['mlp', 'alpha'])}")
        for name in (
            "iterations",
            "envs",
            "discriminator_steps",
            "discriminator_batch",
            "replay",
            "epochs",
            "minibatch",
            "alpha_vectors",
        ):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)}")

    def change(self, **changes: Any) -> Settings:
        """A copy with some fields changed.

        Raises:
            ConfigError: unknown field.
        """
        legal = [f.name for f in fields(self)]
        for name in changes:
            if name not in legal:
                raise ConfigError(f"settings: {one_of(name, legal)}")
        return replace(self, **changes)

    def share(self, iteration: int) -> float:
        """What is left of step sizes and entropy bonus at an iteration (1 falling to `anneal`)."""
        return 1.0 - (1.0 - self.anneal) * iteration / max(1, self.iterations - 1)


def paper(**changes: Any) -> Settings:
    """The paper's hyperparameters."""
    return Settings().change(**changes)


def tuned(**changes: Any) -> Settings:
    """Converges in a tenth of the time: fewer and larger steps, more discriminator updates, replay."""
    return Settings(
        iterations=40,
        envs=32,
        lr_discriminator=1e-3,
        lr_actor=3e-3,
        lr_critic=3e-3,
        discriminator_steps=20,
        discriminator_batch=256,
        replay=20,
        epochs=5,
        minibatch=800,
        entropy=0.01,
        anneal=0.1,
    ).change(**changes)


def fast(**changes: Any) -> Settings:
    """`tuned` with bfloat16 products in the discriminator: for processors that have them."""
    return tuned(bfloat16=True).change(**changes)


PRESETS = {"paper": paper, "tuned": tuned, "fast": fast}
"""Named settings."""
