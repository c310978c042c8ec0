"""What a round's recorder is told about the round, and the tap through which decisions reach it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

from cell.config import CellConfig, to_dict
from cell.decision.belief import weights_of
from cell.decision.io import Inputs, Outputs
from cell.decision.policy import PolicyTable, write
from cell.perception.detector import shipped_weights
from cell.perception.hands.tracker import HandTracker
from cell.record.content import CONFIG_FILE, EYES, POLICY_FILE, About
from cell.record.decision import Decision
from cell.record.hand_tap import HandTap
from cell.record.recorder_process import RecorderProcess
from cell.version import code_version, commit, machine

if TYPE_CHECKING:
    from cell.run.round import RoundOptions, Watcher


def hand_tap(config: CellConfig) -> HandTap:
    """The hand networks with a tap on them."""
    return HandTap(HandTracker(Path(config.gestures.models) if config.gestures.models else None))


def about(
    config: CellConfig, policy: PolicyTable, options: RoundOptions, holder: str, companion: str
) -> About:
    """What is recorded. companion: as in `About`; empty: follows from the options."""
    detector = Path(config.detector) if config.detector else shipped_weights()
    belief = weights_of(config.supervisor.belief)
    facts = {
        "policy": policy.name,
        "backend": options.backend,
        "lock_step": str(options.lock_step).lower(),
        "seed": str(options.seed),
        "onions": str(options.onions),
        "person": options.person or "none",
        "belief": config.supervisor.belief,
        "belief_sha256": "" if belief is None else _digest(belief),
        "detector_sha256": _digest(detector),
        "version": code_version(),
        "commit": commit(),
        "machine": machine(),
    }
    table = write(policy.name, policy.actions, policy.bin_edges, f"commit={commit()}")
    files = {CONFIG_FILE: json.dumps(to_dict(config), indent=1).encode(), POLICY_FILE: table.encode()}
    companion = companion or (EYES if options.person else "none")
    return About(facts, companion, holder, files)


def make_recorder(
    config: CellConfig, policy: PolicyTable, options: RoundOptions, holder: str, companion: str
) -> RecorderProcess | None:
    """What records a round, if anything is to; it does not listen yet. companion: as for `about`."""
    if options.record is None:
        return None
    return RecorderProcess(
        config,
        options.record,
        about(config, policy, options, holder, companion),
        lossless=options.record_lossless,
        patient=options.lock_step,
    )


def tapped(recorder: RecorderProcess, tap: HandTap | None, watch: Watcher | None) -> Watcher:
    """A watcher that hands every tick to the recorder before `watch` sees it."""
    number = 0

    def both(inputs: Inputs, outputs: Outputs) -> None:
        nonlocal number
        recorder.decided(Decision(number, inputs, outputs, () if tap is None else tap.take()))
        number += 1
        if watch is not None:
            watch(inputs, outputs)

    return both


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
