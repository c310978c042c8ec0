"""Calibrates the abstract task with a campaign, and trains the policies anew on it.

durations of the campaign -> durations.csv and the `cell` preset -> belief, TB-DecAIRL, Dec-AIRL ->
policy CSVs -> how well the task predicts the campaign's sort times. Everything is written to one
folder; `install` puts it where the package ships it.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import ConfigError
from cell.learn.domain.presets import Preset, preset
from cell.learn.domain.semi_markov import load_durations
from cell.trials.campaign import Record, Results
from cell.trials.durations import SORTING
from cell.version import commit
from cell.wire.vocabulary import Action

DURATIONS, CALIBRATION, PREDICTIONS = "durations.csv", "calibration.json", "predictions.json"
METHODS = ("tb-decairl", "dec-airl")
_LEAST = 3.0
"""An action that worked less often in a mode than this keeps the time it had, scaled."""
_MODES = ("collaborative", "industrial")


@dataclass(frozen=True)
class Measured:
    """What a campaign says of the task.

    Attributes:
        seconds: (2, 2, 9) by role, mode and action, as `load_durations` gives them.
        counts: the same shape: how often each worked; 0 where it kept its former value.
        recovery: mean length of a rest, from being tired to being rested [s].
        overhead: of a round beyond its onions [s]. rounds: measured.
    """

    seconds: np.ndarray[Any, np.dtype[np.float64]]
    counts: np.ndarray[Any, np.dtype[np.float64]]
    recovery: float
    overhead: float
    rounds: int


def measure(results: Results) -> Measured:
    """Durations over all completed rounds of a campaign.

    An action that was not seen often enough keeps its former time, scaled like the others of its
    role and mode.

    Raises:
        ConfigError: no round is done, or none with a rest.
    """
    records = [r["durations"] for r in results.records if "human" in r["durations"]]
    if not records:
        raise ConfigError(f"{results.folder} has no finished round with a simulated person")
    before = load_durations()
    spent, worked = np.zeros((2, 2, len(Action))), np.zeros((2, 2, len(Action)))
    for record in records:
        for m, mode in enumerate(_MODES):
            _add(spent, worked, (0, m), record["robot"][mode])
            _add(spent, worked, (1, m), record["human"])
    rests = [rest for record in records for rest in record["rests"]]
    if not rests:
        raise ConfigError(f"{results.folder}: nobody rested in these rounds; use more onions or rounds")
    known = worked >= _LEAST
    seconds = before.copy()
    for r in range(2):
        for m in range(2):
            at = known[r, m]
            scale = 1.0
            if at.any():
                measured = spent[r, m, at] / worked[r, m, at]
                scale = float(measured.sum() / before[r, m, at].sum())
                seconds[r, m, at] = measured
            for action in SORTING:
                if not at[action]:
                    seconds[r, m, action] = before[r, m, action] * scale
    for action, key in ((Action.SLOW_DOWN, "thumbs_down"), (Action.SPEED_UP, "thumbs_up")):
        seconds[1, :, action] = np.mean([rest[key] for rest in rests])
        worked[1, :, action] = len(rests)
    seconds[0, :, [Action.SPEED_UP, Action.SLOW_DOWN]] = 0.04  # decided within one tick
    overhead = [record["overhead"]["before"] + record["overhead"]["after"] for record in records]
    counts = np.where(known | (worked > 0) & (np.arange(len(Action)) >= Action.SPEED_UP), worked, 0.0)
    recovery = float(np.mean([rest["recovery"] for rest in rests]))
    return Measured(np.maximum(seconds, 0.02), counts, recovery, float(np.mean(overhead)), len(records))


def to_csv(measured: Measured, source: str) -> str:
    """The durations as the learner reads them; what kept its former value is said in a comment."""
    lines = [
        f"# Seconds that an action takes in the cell, by role and mode; measured in {measured.rounds} rounds",
        f"# of {source} ({commit()}), a rest lasting {measured.recovery:.1f} s.",
    ]
    kept = [
        f"{role} {mode} {action.name.lower()}"
        for r, role in enumerate(("robot", "human"))
        for m, mode in enumerate(_MODES)
        for action in SORTING
        if not measured.counts[r, m, action] and (r, m) != (1, 1)
    ]
    lines += [f"# Not measured, scaled: {name}" for name in kept]
    lines.append("role,mode,action,seconds")
    for r, role in enumerate(("robot", "human")):
        for m, mode in enumerate(_MODES if role == "robot" else ("any",)):
            lines += [f"{role},{mode},{a.name.lower()},{measured.seconds[r, m, a]:.3f}" for a in Action]
    return "\n".join(lines) + "\n"


def task(measured: Measured, durations: Path) -> Preset:
    """The `cell` preset with what was measured."""
    return preset("cell", durations=str(durations), recovery=max(1, round(measured.recovery)))


def calibrate(
    results: Results,
    out: Path,
    seed: int,
    iterations: int | None,
    say: Callable[[str], None],
    episodes: int = 1000,
) -> Record:
    """The whole chain; writes into `out` and returns what `predictions.json` holds.

    Raises:
        ConfigError: nothing to measure, or the learner's packages are missing.
    """
    from cell.trials.predict import predict
    from cell.trials.retrain import retrain

    out.mkdir(parents=True, exist_ok=True)
    measured = measure(results)
    table = out / DURATIONS
    table.write_text(to_csv(measured, f"{len(results.settings.people)} people, seed {results.settings.seed}"))
    load_durations(table)  # it can be read back
    rules = task(measured, table)
    (out / CALIBRATION).write_text(json.dumps(_about(measured), indent=1) + "\n")
    say(f"measured in {measured.rounds} rounds: a rest of {measured.recovery:.1f} s; {table}")
    policies = {}
    for method in METHODS:
        say(f"training {method} on the measured task")
        policies[method] = retrain(method, rules, seed, out / method, iterations, episodes)
    found = {
        "overhead_s": round(measured.overhead, 3),
        "recovery_s": round(measured.recovery, 3),
        "rows": predict(results, rules, measured.overhead, episodes),
        "policies": {method: str(path) for method, path in policies.items()},
    }
    (out / PREDICTIONS).write_text(json.dumps(found, indent=1) + "\n")
    return found


def install(out: Path) -> list[Path]:
    """Copy the calibrated durations and policies to where the package ships them; the files written."""
    durations = Path(str(files("cell.learn.domain"))) / DURATIONS
    folder = Path(str(files("cell.decision") / "policies"))
    targets = [(out / DURATIONS, durations)]
    targets += [(out / method / "robot.csv", folder / f"{method}.csv") for method in METHODS]
    for source, target in targets:
        shutil.copyfile(source, target)
    return [target for _, target in targets]


def _add(spent: Any, worked: Any, at: tuple[int, int], table: dict[str, list[float]]) -> None:
    for name, (seconds, count) in table.items():
        spent[(*at, Action[name.upper()])] += seconds
        worked[(*at, Action[name.upper()])] += count


def _about(measured: Measured) -> Record:
    return {
        "recovery": max(1, round(measured.recovery)),
        "overhead_s": round(measured.overhead, 3),
        "rounds": measured.rounds,
        "commit": commit(),
        "counts": {
            role: {
                mode: {a.name.lower(): round(float(measured.counts[r, m, a]), 2) for a in SORTING}
                for m, mode in enumerate(_MODES)
            }
            for r, role in enumerate(("robot", "human"))
        },
    }
