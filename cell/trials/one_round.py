"""Runs one round of a campaign in this process, as `cell run` would, and measures it."""

from __future__ import annotations

import json
import resource
import socket
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from cell.clock import perf_s
from cell.config import CellConfig, from_dict
from cell.decision.belief import make_belief
from cell.decision.companion import Companion
from cell.decision.io import Inputs, Outputs
from cell.decision.policy import parse
from cell.motion.planner import Planner
from cell.run.result import RoundResult
from cell.run.round import MakeCompanion, RoundOptions, run_round
from cell.trials.contenders import ORACLE, Contender
from cell.trials.durations import durations
from cell.trials.emulated import Emulated
from cell.trials.log import Logger
from cell.trials.metrics import figures
from cell.trials.schedule import RoundSpec
from cell.trials.truth_person import OracleBelief, TrueCompanion, Witness
from cell.wire.types import Truth

RESULT, EVENTS, TICKS = "json", "events.jsonl", "npz"
"""What a round leaves, by the ending of the file."""
_JUDGE_EVERY = 2
"""Ticks from one look at the truth to the next: it costs some milliseconds."""


@dataclass(frozen=True)
class Job:
    """One round, as plain data for any worker.

    Attributes:
        spec: which. contender: the policy, with its table's text. onions, backend, perception: as in
            `Settings`. config: the cell. record: MCAP file, or empty.
    """

    spec: RoundSpec
    contender: Contender
    onions: int
    backend: str
    perception: str
    config: dict[str, Any]
    record: str = ""

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self))


def job_from_json(text: str) -> Job:
    """The inverse of `Job.to_json`."""
    data = json.loads(text)
    data["spec"] = RoundSpec(**data["spec"])
    data["contender"] = Contender(**data["contender"])
    return Job(**data)


def run_job(job: Job) -> dict[str, bytes]:
    """Run the round; its files by ending.

    Raises:
        CellError: it could not be run.
    """
    began = perf_s()
    config = from_dict({**job.config, "port": free_port()})
    if job.contender.belief not in ("", ORACLE):
        supervisor = msgspec.structs.replace(config.supervisor, belief=job.contender.belief)
        config = msgspec.structs.replace(config, supervisor=supervisor)
    logger = Logger(config)
    result, left_out = _round(job, config, logger)
    log = logger.log()
    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    record = {
        "id": job.spec.id,
        **{k: v for k, v in asdict(job.spec).items() if k != "id"},
        "contender": job.contender.name,
        "belief": job.contender.belief or config.supervisor.belief,
        "perception": job.perception,
        "result": asdict(result),
        "figures": figures(log, config),
        "durations": durations(log),
        "machine": {
            "wall_s": round(perf_s() - began, 3),
            "cpu_s": round(own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime, 3),
            "cpu_node_s": round(others.ru_utime + others.ru_stime, 3),
            "memory_mb": round((own.ru_maxrss + others.ru_maxrss) / 1024, 1),
            "real_time_factor": result.real_time_factor,
            "host": socket.gethostname(),
            **({} if left_out is None else {"cycles_left_out": left_out}),
        },
    }
    text = json.dumps(record, indent=1) + "\n"
    return {EVENTS: logger.events().encode(), TICKS: log.to_bytes(), RESULT: text.encode()}


def _round(job: Job, config: CellConfig, logger: Logger) -> tuple[RoundResult, int | None]:
    """The round, and how many cycles the emulated controller left out, if there was one."""
    witness = Witness()

    def watch(inputs: Inputs, outputs: Outputs) -> None:
        logger.tick(inputs, outputs)

    def judge(inputs: Inputs, outputs: Outputs, truth: Truth) -> None:
        del inputs, outputs
        logger.truth(truth)
        witness.tell(truth)

    make: MakeCompanion | None = None
    if job.perception == "truth":
        # Without the person camera nobody draws for it.
        cameras = {name: c for name, c in config.cameras.items() if name != "person"}
        config = msgspec.structs.replace(config, cameras=cameras)
        make = _told(job, witness)
    policy = parse(job.contender.csv, job.contender.policy)
    real_time = job.backend == "ur3e"
    options = RoundOptions(
        job.backend, not real_time, job.spec.seed, job.onions, person=job.spec.persona,
        record=Path(job.record) if job.record else None,
    )  # fmt: skip
    if not real_time:
        return run_round(config, policy, options, watch, judge, make, _JUDGE_EVERY), None
    emulated = Emulated(config, job.spec.seed, job.onions, job.spec.persona)
    with emulated, emulated.sampler(config, logger.truth) as sampler:
        result = run_round(config, policy, emulated.options(options), sampler.first(watch))
    return result, emulated.left_out


def _told(job: Job, witness: Witness) -> MakeCompanion:
    """A companion that is told the truth, with the contender's belief."""

    def make(config: CellConfig, planner: Planner) -> Companion:
        oracle = job.contender.belief == ORACLE
        belief = OracleBelief(witness) if oracle else make_belief(config.supervisor.belief)
        return TrueCompanion(config, witness, belief, planner.collision)

    return make


def free_port() -> int:
    """A TCP port of the loopback interface that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
