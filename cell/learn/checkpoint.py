"""Resumable checkpoints: tensors in safetensors, everything else as text beside them in the same file."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cell.errors import ConfigError
from cell.learn.discriminator import Transitions
from cell.learn.settings import Settings
from cell.learn.tb_decairl import TbDecAirl

_FIELDS = ("local", "belief", "action", "next_local", "next_belief")
_SMALL = {"local": torch.int16, "action": torch.int8, "next_local": torch.int16}


def save(run: TbDecAirl, path: Path) -> None:
    """Write a run between two iterations: a resumed run continues bit for bit."""
    from safetensors.torch import save_file

    tensors: dict[str, Tensor] = {}
    for name, module in _modules(run).items():
        tensors |= {f"{name}.{key}": value.contiguous() for key, value in module.state_dict().items()}
    for name, optimiser in _optimisers(run).items():
        for index, state in optimiser.state_dict()["state"].items():
            tensors |= {f"{name}.{index}.{key}": value.contiguous() for key, value in state.items()}
    for index, pool in enumerate(run.replay):
        for key in _FIELDS:
            value: Tensor = getattr(pool, key)
            tensors[f"replay.{index}.{key}"] = value.to(_SMALL.get(key, value.dtype), copy=True).contiguous()
    about = {
        "kind": "tb-decairl run",
        "iteration": str(run.iteration),
        "preset": run.preset.name,
        "rules": json.dumps(asdict(run.preset), sort_keys=True),
        "settings": json.dumps(asdict(run.settings), sort_keys=True),
        "expert": _digest(run.expert),
    }
    part = path.with_suffix(path.suffix + ".part")
    save_file(tensors, part, metadata=about)
    part.replace(path)  # an interrupted save leaves the previous checkpoint whole


def _same_run(run: TbDecAirl, about: dict[str, str], path: Path) -> None:
    """Refuse a checkpoint of another run, and name what differs."""
    ours: dict[str, object] = {}
    theirs: dict[str, object] = {}
    for key, owned in (("rules", run.preset), ("settings", run.settings)):
        ours |= json.loads(json.dumps(asdict(owned)))
        try:
            theirs |= json.loads(about.get(key, "{}"))
        except (TypeError, ValueError):
            raise ConfigError(f"cannot read checkpoint {path}: its {key} are damaged") from None
    different = [f"{k} {theirs.get(k)}, not {v}" for k, v in ours.items() if theirs.get(k) != v]
    if not different and about.get("expert") != _digest(run.expert):
        different = ["other demonstrations, or another belief along them"]
    if different:
        raise ConfigError(
            f"{path} belongs to another run ({'; '.join(different)}); continue it with its own options, "
            "or choose another folder"
        )


def _digest(pool: Transitions) -> str:
    """Fingerprint of the expert's transitions; beliefs of other weights or labels change it too."""
    out = hashlib.sha256()
    for key in _FIELDS:
        value: Tensor = getattr(pool, key)
        out.update(value.contiguous().numpy().tobytes())
    return out.hexdigest()


def restore(run: TbDecAirl, path: Path) -> None:
    """Bring a freshly made run to where the checkpoint was written.

    Raises:
        ConfigError: missing, damaged, or of another task, other settings or other demonstrations.
    """
    about, tensors = _read(path)
    _same_run(run, about, path)
    try:
        for name, module in _modules(run).items():
            module.load_state_dict(_under(tensors, name))
        for name, optimiser in _optimisers(run).items():
            state: dict[int, dict[str, Tensor]] = {}
            for key, value in _under(tensors, name).items():
                index, _, field = key.partition(".")
                state.setdefault(int(index), {})[field] = value
            optimiser.load_state_dict(
                {"state": state, "param_groups": optimiser.state_dict()["param_groups"]}
            )
        pools: dict[int, dict[str, Tensor]] = {}
        for key, value in _under(tensors, "replay").items():
            index, _, field = key.partition(".")
            pools.setdefault(int(index), {})[field] = value.long() if field in _SMALL else value
        run.replay = deque((Transitions(**pools[i]) for i in sorted(pools)), maxlen=run.settings.replay)
        run.iteration = int(about["iteration"])
    except (KeyError, RuntimeError, ValueError, TypeError) as error:
        raise ConfigError(f"checkpoint {path} is damaged: {error}") from None


def settings_of(path: Path) -> tuple[str, Settings]:
    """Preset name and settings a checkpoint was written with."""
    about, _ = _read(path)
    try:
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in json.loads(about["settings"]).items()}
        return about["preset"], Settings().change(**values)
    except (KeyError, ValueError, AttributeError) as error:
        raise ConfigError(f"checkpoint {path} is damaged: {error}") from None


def _read(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            about: dict[str, str] = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118  not a dict
    except (OSError, SafetensorError) as error:
        raise ConfigError(f"cannot read checkpoint {path}: {error}") from None
    if about.get("kind") != "tb-decairl run":
        raise ConfigError(f"{path} is not a checkpoint of a training run")
    return about, tensors


def _under(tensors: dict[str, Tensor], name: str) -> dict[str, Tensor]:
    return {k.removeprefix(f"{name}."): v for k, v in tensors.items() if k.startswith(f"{name}.")}


def _modules(run: TbDecAirl) -> dict[str, torch.nn.Module]:
    return {"actors": run.ppo.actors, "critic": run.ppo.critic, "reward": run.discriminator.f}


def _optimisers(run: TbDecAirl) -> dict[str, Any]:
    return {
        "adam_actors": run.ppo.actor_optimiser,
        "adam_critic": run.ppo.critic_optimiser,
        "adam_reward": run.discriminator.optimiser,
    }
