"""Measures a round from outside: executed speeds, lost samples, digests of everything.

`Meter` taps the joint states on the wire, so what it reports is what the arm did, not what
was planned.
"""

from __future__ import annotations

import hashlib
import math
import threading
from itertools import pairwise

import numpy as np

from cell.clock import WallClock
from cell.config import CellConfig
from cell.decision.io import Inputs, Outputs
from cell.limits import QD_MAX, tcp_positions
from cell.wire import codec
from cell.wire.session import Session, Tapped
from cell.wire.types import JointState
from cell.wire.vocabulary import Mode

_BRAKING = 0.6
"""Longest braking from the industrial to the collaborative cap [s]."""


class Meter:
    """Collects one round's joint states and hashes joint states, images and decisions."""

    def __init__(self, session: Session, config: CellConfig) -> None:
        self._config = config
        self._lock = threading.Lock()
        self._samples: list[JointState] = []
        self._modes: list[tuple[float, int]] = []
        self._nearest = math.inf
        self.lost = 0
        self._images, self._decisions = hashlib.sha256(), hashlib.sha256()
        session.listen_all(session.keys.joint_states, self._store)

    def note(self, inputs: Inputs, outputs: Outputs) -> None:
        """Take in one supervisor tick."""
        for frame in inputs.frames:
            self._images.update(frame.rgb.tobytes())
            self._images.update(frame.depth.tobytes())
        self._decisions.update(codec.encode(outputs.state))
        for command in outputs.commands:
            self._decisions.update(codec.encode(command.order))
        self._nearest = min(self._nearest, outputs.state.separation)
        if not self._modes or self._modes[-1][1] != outputs.state.mode:
            self._modes.append((inputs.t, outputs.state.mode))

    def wait_for(self, t: float) -> None:
        """Wait until the tap has delivered the joint state of time `t` [s]; gives up after 2 s."""
        clock = WallClock()
        end = clock.now() + 2.0
        while clock.now() < end:
            with self._lock:
                if self._samples and self._samples[-1].t >= t - 1e-9:
                    return
            clock.sleep_until(clock.now() + 0.005)

    def motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Executed t (N,) [s], q (N, 6) [rad], qd (N, 6) [rad/s]."""
        with self._lock:
            samples = list(self._samples)
        return (
            np.array([s.t for s in samples]),
            np.array([s.q for s in samples]).reshape(-1, 6),
            np.array([s.qd for s in samples]).reshape(-1, 6),
        )

    def max_tcp_speed(self) -> dict[str, float]:
        """Largest executed TCP speed per mode [m/s], by central differences of positions.

        The braking after a change of mode, at most `_BRAKING` long, belongs to neither.
        """
        t, q, _ = self.motion()
        out = {"collaborative": 0.0, "industrial": 0.0}
        if len(t) < 3:
            return out
        p = tcp_positions(q, self._config.gripper.length)
        speed = np.linalg.norm(p[2:] - p[:-2], axis=1) / (t[2:] - t[:-2])
        starts = np.array([start for start, _ in self._modes])
        modes = np.array([mode for _, mode in self._modes])
        index = np.clip(np.searchsorted(starts, t[1:-1], side="right") - 1, 0, None)
        settled = (index == 0) | (t[1:-1] - starts[index] > _BRAKING)
        for name, mode in (("collaborative", Mode.COLLABORATIVE), ("industrial", Mode.INDUSTRIAL)):
            of_mode = speed[(modes[index] == mode) & settled]
            out[name] = float(of_mode.max()) if of_mode.size else 0.0
        return out

    def min_separation(self) -> float | None:
        """Least measured separation [m]; None when nobody was ever in sight."""
        return round(self._nearest, 4) if math.isfinite(self._nearest) else None

    def joint_limits(self) -> dict[str, float]:
        """Largest executed joint speed and acceleration as shares of their limits."""
        t, _, qd = self.motion()
        if len(t) < 3:
            return {"speed_share": 0.0, "acceleration_share": 0.0}
        qdd = np.diff(qd, axis=0) / np.diff(t)[:, None]
        return {
            "speed_share": float((np.abs(qd) / QD_MAX).max()),
            "acceleration_share": float(np.abs(qdd).max() / self._config.arm.max_acceleration),
        }

    def time_in(self, mode: Mode, end: float) -> float:
        """Time spent in a mode until `end` [s]."""
        total = 0.0
        for i, (start, value) in enumerate(self._modes):
            until = self._modes[i + 1][0] if i + 1 < len(self._modes) else end
            total += until - start if value == mode else 0.0
        return total

    @property
    def mode_switches(self) -> int:
        """Changes between collaborative and industrial mode."""
        working = [m for _, m in self._modes if m in (Mode.COLLABORATIVE, Mode.INDUSTRIAL)]
        return sum(a != b for a, b in pairwise(working))

    def digests(self) -> dict[str, str]:
        """SHA-256 of the executed joint states, the images and the decisions."""
        joints = hashlib.sha256()
        for part in self.motion():
            joints.update(np.ascontiguousarray(part).tobytes())
        return {
            "joint_states": joints.hexdigest(),
            "images": self._images.hexdigest(),
            "decisions": self._decisions.hexdigest(),
        }

    def _store(self, sample: Tapped) -> None:
        state = codec.decode(JointState, sample.payload)
        with self._lock:
            self.lost += sample.missed
            if not self._samples or state.t > self._samples[-1].t:  # a real arm may have nothing new to say
                self._samples.append(state)
