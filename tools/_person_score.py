"""One round beside a simulated person, with what was seen measured against the truth of every tick.

Fluency, delays, signs and speeds are `cell.trials.metrics`; here is what only a benchmark of
perception needs: confusions of actions, the belief beside a perfect observer's, errors of separation.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import msgspec
import numpy as np

from cell.config import CellConfig
from cell.decision.belief import make_belief
from cell.decision.io import Inputs, Outputs
from cell.decision.policy import load as load_policy
from cell.frames import Array
from cell.motion.collision import CollisionModel
from cell.perception.separation import Separation
from cell.run.round import RoundOptions, run_round
from cell.trials import metrics
from cell.trials.log import Log, Logger
from cell.wire.types import Frame, Truth
from cell.wire.vocabulary import Action

EVENT = 1.0


class Score:
    """Collects one round."""

    def __init__(self, config: CellConfig) -> None:
        self.config = config
        self._logger = Logger(config)
        self._collision = CollisionModel(config)
        self._eye = Separation(config)
        self._frames: list[tuple[float, float]] = []
        self._past: list[tuple[float, Array, float, float]] = []
        self._actions: list[tuple[float, int]] = []
        self.worst: list[str] = []

    def tick(self, inputs: Inputs, outputs: Outputs, truth: Truth) -> None:
        """One supervisor tick with the truth at its end."""
        self._logger.tick(inputs, outputs)
        self._logger.truth(truth)
        held = 0.5 * self.config.onions.diameter[1] if inputs.gripper.holding else 0.0
        self._past.append((inputs.t, inputs.joints.q, round(inputs.gripper.width, 2), held))
        for frame in inputs.frames:
            if frame.camera == "person":
                self._look(frame)
                self._actions.append((frame.t, outputs.state.human_action))

    def log(self) -> Log:
        """Everything so far, tick by tick."""
        return self._logger.log()

    def _look(self, frame: Frame) -> None:
        """The separation of this frame at its own exposure."""
        _, q, width, held = min(self._past[-25:], key=lambda s: abs(s[0] - frame.t))
        p, r, _ = self._collision.spheres(q[None], width=width, held_radius=held)
        arm = np.column_stack([p[0], r])
        cloud = self._eye.look(frame, arm, np.zeros((0, 4)))
        self._frames.append((frame.t, cloud.distance(arm)[0]))

    # -- figures ------------------------------------------------------------------------------------------

    def report(self) -> dict[str, Any]:
        """All figures of the round; pairs and matrices are summed over rounds elsewhere."""
        log = self.log()
        confusion = np.zeros((len(Action), len(Action)), int)
        for t, seen in self._actions:  # what a frame showed against what was done at its exposure
            at = int(np.argmin(np.abs(log["t"] - t)))
            confusion[int(log["human"][at]), seen] += 1
        figures = metrics.figures(log, self.config)
        return {
            "confusion": confusion.tolist(),
            "ended": self._ended(log).tolist(),
            "belief": [log["fatigued"].astype(int).tolist(), np.round(log["belief"], 4).tolist()],
            "belief_true_actions": np.round(self._perfect_belief(log), 4).tolist(),
            "separation_error": self._separation_errors(log),
            "worst_separation": self.worst,
            "over_cap": figures["over_cap_ticks"],
            "over_permitted": figures["over_permitted_ticks"],
            "entries": metrics.entries(log, self.config),
            "signs": figures["signs"],
            "idle": {
                "robot": figures["fluency"]["robot_idle"],
                "person": float((log["human"] == Action.NO_OP).mean()),
            },
        }

    def _ended(self, log: Log) -> Array:
        """Confusion of whole actions: what was seen most of the time, 0.12 s late."""
        out = np.zeros((len(Action), len(Action)), int)
        t, human, seen = log["t"], log["human"].astype(int), log["human_seen"].astype(int)
        starts = np.flatnonzero(np.diff(human, prepend=-1))
        for a, b in zip(starts, [*starts[1:], len(t)], strict=True):
            if t[b - 1] - t[a] < 0.3:
                continue
            counts = np.bincount(seen[a + 3 : b + 3], minlength=len(Action))
            out[human[a], int(counts.argmax())] += 1
        return out

    def _perfect_belief(self, log: Log) -> list[float]:
        """The same belief fed with the true actions at the same kind of events."""
        belief, last, since = make_belief(self.config.supervisor.belief), -1, -EVENT
        robot, out = -1, []
        for t, action, own in zip(log["t"], log["human"], log["robot"], strict=True):
            if action != last or own != robot or t - since >= EVENT:
                belief.observe(Action(int(action)))
                last, robot, since = action, own, t
            out.append(belief.value)
        return out

    def _separation_errors(self, log: Log) -> list[float]:
        """Measured minus true separation at each exposure [m], where somebody was seen."""
        t = np.array([f[0] for f in self._frames])
        d = np.array([f[1] for f in self._frames])
        seen = np.isfinite(d) & (t >= log["t"][0]) & (t <= log["t"][-1])
        true = np.interp(t[seen], log["t"], log["true_separation"])
        errors = d[seen] - true
        for k in np.argsort(-errors)[:3]:
            at = int(np.argmin(np.abs(log["t"] - t[seen][k])))
            what = Action(int(log["human"][at])).name.lower()
            self.worst.append(f"{t[seen][k]:.2f} s: {errors[k]:+.3f} m at {true[k]:.3f} m, {what}")
        return [round(float(e), 4) for e in errors]


def one_round(
    seed: int, persona: str, policy: str, onions: int, port: int, config: CellConfig
) -> dict[str, Any]:
    """Run one round and score it; `error` says what went wrong, if anything did."""
    config = msgspec.structs.replace(config, port=port)
    score = Score(config)
    options = RoundOptions(seed=seed, onions=onions, person=persona)
    result = asdict(run_round(config, load_policy(policy), options, None, score.tick))
    for key in ("sha256", "commit", "version"):
        result.pop(key)
    return {**result, **score.report()}
