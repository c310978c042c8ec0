"""The robot's belief about the person's type while it works: P(fatigued | observed actions).

The networks and models are trained by `cell train belief`; here they only run, one person at a
time, in numpy. An observation is one action of the person: fed when the person's action changes
and when the robot decides, as in the domain whose actions take time.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Protocol

import numpy as np

from cell.errors import ConfigError, one_of
from cell.frames import Array
from cell.wire.vocabulary import Action

NAMES = ("gru", "last-gesture", "none")
"""Beliefs that a cell can run with; a file name ending in .safetensors is a GRU's weights."""
_ACTIONS = len(Action)
_PRIOR = 0.5


class Belief(Protocol):
    """P(the person is fatigued)."""

    @property
    def value(self) -> float:
        """The belief now."""
        ...

    def observe(self, action: Action) -> float:
        """Take in one action of the person; the belief after it."""
        ...


class LastGesture:
    """Fatigued from the last thumbs-down to the next thumbs-up."""

    def __init__(self) -> None:
        self.value = 0.0

    def observe(self, action: Action) -> float:
        if action is Action.SLOW_DOWN:
            self.value = 1.0
        elif action is Action.SPEED_UP:
            self.value = 0.0
        return self.value


class NoBelief:
    """Knows nothing; always the same."""

    def __init__(self, value: float = _PRIOR) -> None:
        self.value = value

    def observe(self, action: Action) -> float:
        del action
        return self.value


class Gru:
    """The frozen GRU cell (tanh, one step per observation) with its softmax of two.

    Args:
        path: weights as `cell train belief` writes them.

    Raises:
        ConfigError: missing, damaged or of another shape.
    """

    def __init__(self, path: Path) -> None:
        w = _load(path)
        self._from_action = w["gru.weight_ih_l0"].T + w["gru.bias_ih_l0"]
        self._from_state = w["gru.weight_hh_l0"].T
        self._bias = w["gru.bias_hh_l0"]
        self._head = w["head.weight"][1] - w["head.weight"][0]
        self._head_bias = float(w["head.bias"][1] - w["head.bias"][0])
        self._state = np.zeros(self._from_state.shape[0])
        self.value = float(w["prior"])

    def observe(self, action: Action) -> float:
        n = len(self._state)
        x, s = self._from_action[int(action)], self._state @ self._from_state + self._bias
        reset, keep = np.split(_sigmoid(x[: 2 * n] + s[: 2 * n]), 2)
        new = np.tanh(x[2 * n :] + reset * s[2 * n :])
        self._state = new + keep * (self._state - new)
        self.value = float(_sigmoid(np.array(self._state @ self._head + self._head_bias)))
        return self.value


def make_belief(name: str) -> Belief:
    """The belief called `name`; see `NAMES`.

    Raises:
        ConfigError: no such belief, or unusable weights.
    """
    if (path := weights_of(name)) is not None:
        return Gru(path)
    if name == "last-gesture":
        return LastGesture()
    if name == "none":
        return NoBelief()
    raise ConfigError(f"belief: {one_of(name, [*NAMES, 'FILE.safetensors'])}")


def weights_of(name: str) -> Path | None:
    """The file that the belief called `name` is read from; None if it needs none."""
    if name == "gru":
        return Path(str(files("cell") / "learn" / "belief" / "weights" / "cell-announced.safetensors"))
    return Path(name) if name.endswith(".safetensors") else None


def _load(path: Path) -> dict[str, Array]:
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    try:
        weights = load_file(path)
    except (OSError, SafetensorError) as error:
        raise ConfigError(f"cannot read belief weights {path}: {error}") from None
    hidden = weights["gru.weight_hh_l0"].shape[-1] if "gru.weight_hh_l0" in weights else 0
    expected = {
        "gru.weight_ih_l0": (3 * hidden, _ACTIONS),
        "gru.weight_hh_l0": (3 * hidden, hidden),
        "gru.bias_ih_l0": (3 * hidden,),
        "gru.bias_hh_l0": (3 * hidden,),
        "head.weight": (2, hidden),
        "head.bias": (2,),
        "prior": (),
    }
    if hidden == 0 or {name: value.shape for name, value in weights.items()} != expected:
        raise ConfigError(f"{path} does not hold belief weights: other tensors than {', '.join(expected)}")
    if not all(np.isfinite(value).all() for value in weights.values()):
        raise ConfigError(f"{path} does not hold belief weights: some are not finite")
    return {name: value.astype(np.float64) for name, value in weights.items()}


def _sigmoid(x: Array) -> Array:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)))


__all__ = ["NAMES", "Belief", "Gru", "LastGesture", "NoBelief", "make_belief", "weights_of"]
