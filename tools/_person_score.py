"""One round beside a simulated person, with everything measured against the truth of every tick."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import msgspec
import numpy as np

from cell.config import CellConfig
from cell.decision.belief import make_belief
from cell.decision.io import Inputs, Outputs
from cell.decision.policy import load as load_policy
from cell.decision.ssm import allowed_speed
from cell.frames import Array
from cell.limits import tcp_jacobian
from cell.motion.collision import CollisionModel
from cell.perception.separation import Separation
from cell.run.round import RoundOptions, run_round
from cell.wire.types import Frame, Truth
from cell.wire.vocabulary import Action, Mode

BRAKING = 0.6
"""Longest braking transient after a cap was lowered [s]."""
OVER = 0.005
"""Tool speeds count as above a cap from here on [m/s]: the differences of measured joint speeds."""
EVENT = 1.0


class Score:
    """Collects one round."""

    def __init__(self, config: CellConfig) -> None:
        self.config = config
        self._collision = CollisionModel(config)
        self._eye = Separation(config)
        self._frames: list[tuple[float, float]] = []
        self._past: list[tuple[float, Array, float, float]] = []
        self.rows: list[dict[str, Any]] = []
        self._actions: list[tuple[float, int]] = []
        self.worst: list[str] = []

    def tick(self, inputs: Inputs, outputs: Outputs, truth: Truth) -> None:
        """One supervisor tick with the truth at its end."""
        assert truth.person is not None
        state, person, c = outputs.state, truth.person, self.config
        v = tcp_jacobian(inputs.joints.q[None], c.gripper.length)[0] @ inputs.joints.qd
        held = 0.5 * c.onions.diameter[1] if inputs.gripper.holding else 0.0
        self._past.append((inputs.t, inputs.joints.q, round(inputs.gripper.width, 2), held))
        for frame in inputs.frames:
            if frame.camera == "person":
                self._look(frame)
                self._actions.append((frame.t, state.human_action))
        self.rows.append(
            {
                "t": inputs.t,
                "speed": float(np.linalg.norm(v)),
                "fatigued": person.fatigued,
                "true_action": person.action,
                "true_sign": person.gesture,
                "true_separation": person.separation,
                "action": state.human_action,
                "sign": state.gesture,
                "separation": state.separation,
                "belief": state.belief,
                "mode": state.mode,
                "cap": state.speed_cap,
                "requested": state.requested_industrial,
                "permitted": state.permitted_industrial,
                "arm_moving": inputs.arm.moving or inputs.gripper.moving,
                "robot": state.action,
            }
        )

    def _look(self, frame: Frame) -> None:
        """The separation of this frame at its own exposure."""
        t, q, width, held = min(self._past[-25:], key=lambda s: abs(s[0] - frame.t))
        del t
        p, r, _ = self._collision.spheres(q[None], width=width, held_radius=held)
        arm = np.column_stack([p[0], r])
        cloud = self._eye.look(frame, arm, np.zeros((0, 4)))
        self._frames.append((frame.t, cloud.distance(arm)[0]))

    # -- figures ------------------------------------------------------------------------------------------

    def report(self, truth: Truth | None) -> dict[str, Any]:
        """All figures of the round; pairs and matrices are summed over rounds elsewhere."""
        column = {k: np.array([row[k] for row in self.rows]) for k in self.rows[0]}
        confusion = np.zeros((len(Action), len(Action)), int)
        for t, seen in self._actions:  # what a frame showed against what was done at its exposure
            at = int(np.argmin(np.abs(column["t"] - t)))
            confusion[int(column["true_action"][at]), seen] += 1
        return {
            "confusion": confusion.tolist(),
            "ended": self._ended(column).tolist(),
            "belief": [column["fatigued"].astype(int).tolist(), np.round(column["belief"], 4).tolist()],
            "belief_true_actions": np.round(self._perfect_belief(column), 4).tolist(),
            "separation_error": self._separation_errors(column),
            "worst_separation": self.worst,
            "over_cap": self._over(column, column["cap"]),
            "over_permitted": self._over(column, self._permitted(column)),
            "entries": self._entries(column),
            "signs": self._signs(column, truth),
            "idle": {
                "robot": float(1.0 - column["arm_moving"].mean()),
                "person": float((column["true_action"] == Action.NO_OP).mean()),
            },
        }

    def _ended(self, c: dict[str, Array]) -> Array:
        """Confusion of whole actions: what was seen most of the time, 0.12 s late."""
        out = np.zeros((len(Action), len(Action)), int)
        starts = np.flatnonzero(np.diff(c["true_action"], prepend=-1))
        for a, b in zip(starts, [*starts[1:], len(c["t"])], strict=True):
            if c["t"][b - 1] - c["t"][a] < 0.3:
                continue
            seen = np.bincount(c["action"][a + 3 : b + 3], minlength=len(Action))
            out[int(c["true_action"][a]), int(seen.argmax())] += 1
        return out

    def _perfect_belief(self, c: dict[str, Array]) -> list[float]:
        """The same belief fed with the true actions at the same kind of events."""
        belief, last, since = make_belief(self.config.supervisor.belief), -1, -EVENT
        robot, out = -1, []
        for t, action, own in zip(c["t"], c["true_action"], c["robot"], strict=True):
            if action != last or own != robot or t - since >= EVENT:
                belief.observe(Action(int(action)))
                last, robot, since = action, own, t
            out.append(belief.value)
        return out

    def _separation_errors(self, c: dict[str, Array]) -> list[float]:
        """Measured minus true separation at each exposure [m], where somebody was seen."""
        t = np.array([f[0] for f in self._frames])
        d = np.array([f[1] for f in self._frames])
        seen = np.isfinite(d) & (t >= c["t"][0]) & (t <= c["t"][-1])
        true = np.interp(t[seen], c["t"], c["true_separation"])
        errors = d[seen] - true
        for k in np.argsort(-errors)[:3]:
            row = self.rows[int(np.argmin(np.abs(c["t"] - t[seen][k])))]
            what = Action(int(row["true_action"])).name.lower()
            self.worst.append(f"{t[seen][k]:.2f} s: {errors[k]:+.3f} m at {true[k]:.3f} m, {what}")
        return [round(float(e), 4) for e in errors]

    def _permitted(self, c: dict[str, Array]) -> Array:
        """Tool speed that the true separation permits [m/s]."""
        floor, top = self.config.motion.collaborative_speed, self.config.motion.industrial_speed
        allowed = [allowed_speed(float(d), self.config.separation) for d in c["true_separation"]]
        return np.clip(allowed, floor, top)

    def _over(self, c: dict[str, Array], cap: Array) -> int:
        """Ticks with the tool faster than a cap allowed at any time of the braking before."""
        most = np.array([cap[(c["t"] > t - BRAKING) & (c["t"] <= t)].max() for t in c["t"]])
        return int((c["speed"] > most + OVER).sum())

    def _entries(self, c: dict[str, Array]) -> list[dict[str, float]]:
        """Each time the person comes near while the robot works fast: until the tool is slow."""
        near = c["true_separation"] < self.config.separation.permit
        slow = self.config.motion.collaborative_speed + OVER
        out = []
        for k in np.flatnonzero(near[1:] & ~near[:-1]) + 1:
            if c["mode"][k] != Mode.INDUSTRIAL and c["speed"][k] <= slow:
                continue
            t0 = c["t"][k]
            window = (c["t"] >= t0) & (c["t"] < t0 + 2.0)
            fast = np.flatnonzero(window & (c["speed"] > slow))
            sensed = np.flatnonzero((c["t"] >= t0) & (c["separation"] < self.config.separation.permit))
            decided = np.flatnonzero((c["t"] >= t0) & (c["mode"] != Mode.INDUSTRIAL))
            at = [float(c["t"][i[0]] - t0) if len(i) else 0.0 for i in (sensed, decided)]
            total = float(c["t"][fast[-1]] - t0) + 0.04 if len(fast) else 0.0
            out.append({"sensing": at[0], "deciding": at[1] - at[0], "total": total})
        return out

    def _signs(self, c: dict[str, Array], truth: Truth | None) -> dict[str, Any]:
        """Signs shown, how soon they were seen, swapped ones, and false ones."""
        shown = () if truth is None or truth.person is None else truth.person.gestures
        delays, missed, swapped = [], 0, 0
        for sign in shown:
            until = sign.answered if sign.answered >= 0.0 else sign.shown + 12.0
            during = (c["t"] >= sign.shown - 0.2) & (c["t"] <= until + 0.3)
            seen = c["t"][during & (c["sign"] == sign.sign)]
            swapped += bool(((c["sign"] != sign.sign) & (c["sign"] != "") & during).any())
            missed += not len(seen)
            delays += [round(max(0.0, float(seen[0]) - sign.shown), 3)] if len(seen) else []
        any_sign = np.zeros(len(c["t"]), bool)
        for sign in shown:
            until = sign.answered if sign.answered >= 0.0 else sign.shown + 12.0
            any_sign |= (c["t"] >= sign.shown - 1.0) & (c["t"] <= until + 1.5)
        false = (c["sign"] != "") & ~any_sign
        return {
            "shown": len(shown),
            "missed": missed,
            "swapped": swapped,
            "delay_s": delays,
            "false": int((false[1:] & ~false[:-1]).sum()),
        }


def one_round(
    seed: int, persona: str, policy: str, onions: int, port: int, config: CellConfig
) -> dict[str, Any]:
    """Run one round and score it; `error` says what went wrong, if anything did."""
    config = msgspec.structs.replace(config, port=port)
    score = Score(config)
    last: list[Truth] = []

    def judge(inputs: Inputs, outputs: Outputs, truth: Truth) -> None:
        last[:] = [truth]
        score.tick(inputs, outputs, truth)

    options = RoundOptions(seed=seed, onions=onions, person=persona)
    result = asdict(run_round(config, load_policy(policy), options, None, judge))
    for key in ("sha256", "commit", "version"):
        result.pop(key)
    return {**result, **score.report(last[0] if last else None)}
