"""The supervisor over whole rounds in one process: it replays exactly, and every failure has a name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cell.decision import policy
from cell.decision.io import Command, Outputs
from cell.decision.supervisor import Supervisor
from cell.frames import pose
from cell.motion.planner import Planner
from cell.motion.views import InspectionViews
from cell.wire.codec import encode
from cell.wire.types import GripperCommand, Reply, Trajectory
from cell.wire.vocabulary import Action, Mode
from tests.rig import Replayed, Rig, reference

AWAY = pose(p=(1.2, 1.2, -0.70))
"""On the floor, far from everything."""


@pytest.fixture
def rig() -> Iterator[Callable[[int, int], Rig]]:
    rigs: list[Rig] = []

    def make(seed: int, onions: int) -> Rig:
        rigs.append(Rig(seed, onions))
        return rigs[-1]

    yield make
    for one in rigs:
        one.backend.close()


@cache
def sorted_round() -> Rig:
    """Two onions, one blemished, sorted without incident, in industrial mode."""
    rig = Rig(SEED_OF_BOTH_KINDS, 2, "always-industrial")
    rig.run()
    rig.backend.close()
    return rig


SEED_OF_BOTH_KINDS = 4


def as_bytes(outputs: Outputs) -> bytes:
    """Everything a tick gives, as it would go over the wire."""
    parts = [encode(outputs.state)]
    parts += [f"{c.ticket} {c.camera}".encode() + encode(c.order) for c in outputs.commands]
    parts += [encode(message) for message in (*outputs.detections, *outputs.events)]
    return b"|".join([*parts, f"{outputs.done} {outputs.failure}".encode()])


def waiting_texts(rig: Rig) -> str:
    return " / ".join(rig.texts)


# -- a round that goes well --------------------------------------------------------------------------


def test_both_kinds_end_where_they_belong() -> None:
    rig = sorted_round()
    last = rig.outputs[-1]
    assert (last.done, last.failure, last.state.sorted, last.state.remaining) == (True, "", 2, 0)
    assert (last.state.in_bin, last.state.on_conveyor) == (1, 1)
    actions = {Action(o.state.action) for o in rig.outputs}
    assert actions >= {Action.DETECT_PICK, Action.INSPECT, Action.PLACE_IN_BIN, Action.PLACE_ON_CONVEYOR}


def test_replaying_the_inputs_gives_the_same_outputs_byte_for_byte() -> None:
    rig, config = sorted_round(), reference()
    fresh = Supervisor(
        config,
        policy.load("always-industrial"),
        Planner(config),
        InspectionViews(config),
        Replayed(rig.detector.log),
        "test",
    )
    assert len(rig.inputs) > 200
    for k, (inputs, outputs) in enumerate(zip(rig.inputs, rig.outputs, strict=True)):
        assert as_bytes(fresh.tick(inputs)) == as_bytes(outputs), f"tick {k} at {inputs.t:.3f} s"


def test_after_the_round_it_stays_quiet() -> None:
    rig = sorted_round()
    for _ in range(3):
        outputs = rig.supervisor.tick(rig.inputs[-1])
        assert outputs.done and not outputs.commands and not outputs.events
        assert outputs.state.phase == "done"


def test_commands_are_numbered_dated_and_slow_enough() -> None:
    rig = sorted_round()
    commands = [(i.t, c) for i, o in zip(rig.inputs, rig.outputs, strict=True) for c in o.commands]
    tickets = [c.ticket for _, c in commands]
    assert tickets == list(range(1, len(tickets) + 1))
    ids = [c.order.id for _, c in commands if isinstance(c.order, Trajectory)]
    assert ids == list(range(1, len(ids) + 1))
    for t, command in commands:
        if isinstance(command.order, (Trajectory, GripperCommand)):
            lifetime = command.order.expires - t
            assert 0.0 < lifetime <= reference().supervisor.command_lifetime + 1e-9
    assert {Mode(o.state.mode) for o in rig.outputs[3:]} == {Mode.INDUSTRIAL}


# -- what can go wrong --------------------------------------------------------------------------------


def test_a_missed_grasp_is_tried_again_and_then_set_aside(rig: Callable[[int, int], Rig]) -> None:
    """The onion hides whenever the hand comes, like a detection that is not there."""
    cell = rig(5, 1)
    world = cell.backend.world
    home = world.onion_pose(0)

    def hide() -> None:
        reaching = cell.outputs and cell.outputs[-1].state.action == Action.PICK
        world.set_onion_pose(0, AWAY if reaching else home)

    last = cell.run(hide)
    assert last.failure == "" and last.state.sorted == 0
    assert waiting_texts(cell).count("missed_grasp") == reference().supervisor.grasp_attempts
    assert "set aside" in cell.texts[-1] and "nothing between the fingers" in cell.texts[-1]


def test_an_onion_missed_once_is_sorted_after_all(rig: Callable[[int, int], Rig]) -> None:
    cell = rig(5, 1)
    world = cell.backend.world
    home = world.onion_pose(0)
    state = {"hidden": False}

    def hide_once() -> None:
        missed = "missed_grasp" in waiting_texts(cell)
        reaching = bool(cell.outputs) and cell.outputs[-1].state.action == Action.PICK and not missed
        if reaching or state["hidden"]:
            world.set_onion_pose(0, AWAY if reaching else home)
        state["hidden"] = reaching

    last = cell.run(hide_once)
    assert last.failure == "" and last.state.sorted == 1
    assert waiting_texts(cell).count("missed_grasp") == 1


@pytest.mark.parametrize("during", [Action.INSPECT, Action.PLACE_ON_CONVEYOR, Action.PLACE_IN_BIN])
def test_an_onion_lost_from_the_hand_is_noticed(rig: Callable[[int, int], Rig], during: Action) -> None:
    """It is pulled out behind the robot's back; the robot says so, opens its hand and goes on."""
    cell = rig(5 if during is Action.PLACE_IN_BIN else SOUND_SEED, 1)
    state = {"gone": False}

    def pull() -> None:
        if cell.outputs and cell.outputs[-1].state.action == during and not state["gone"]:
            state["gone"] = True
            cell.backend.world.set_onion_pose(0, AWAY)

    last = cell.run(pull)
    assert state["gone"] and last.done
    assert any(f"{during.name.lower()}: lost_onion" in text for text in cell.texts), cell.texts
    assert last.state.sorted == 0
    assert cell.backend.read_gripper().width > 0.08


SOUND_SEED = 1


def test_refused_motions_end_the_round_with_the_nodes_reason(rig: Callable[[int, int], Rig]) -> None:
    cell = rig(5, 1)

    def refuse(command: Command) -> Reply | None:
        if isinstance(command.order, Trajectory):
            return Reply(False, "tcp_speed", "the tool would move at 9.000 m/s")
        return None

    cell.refuse = refuse
    last = cell.run()
    assert "refused" in last.failure and "tcp_speed: the tool would move at 9.000 m/s" in last.failure
    assert last.state.sorted == 0


def test_one_refusal_is_survived(rig: Callable[[int, int], Rig]) -> None:
    """Refused with an onion in the hand: it is put back, found again and sorted."""
    cell = rig(SOUND_SEED, 1)
    state = {"refused": False}

    def refuse(command: Command) -> Reply | None:
        inspecting = bool(cell.outputs) and cell.outputs[-1].state.action == Action.INSPECT
        if isinstance(command.order, Trajectory) and inspecting and not state["refused"]:
            state["refused"] = True
            return Reply(False, "stale", "it expired")
        return None

    cell.refuse = refuse
    last = cell.run()
    assert any("inspect: refused: stale: it expired" in text for text in cell.texts)
    assert last.failure == "" and last.state.sorted == 1


def test_a_stopped_arm_ends_the_round_with_the_reason(rig: Callable[[int, int], Rig]) -> None:
    cell = rig(5, 1)

    def stop() -> None:
        if cell.backend.now() > 1.0 and cell.executor.moving:
            cell.executor.stop("a person pressed the button")

    last = cell.run(stop)
    assert last.failure == "the arm was stopped: a person pressed the button"
    assert Mode(last.state.mode) is Mode.STOPPED and last.state.speed_cap == 0.0
    assert not last.commands


def test_a_silent_camera_ends_the_round_with_the_reason(rig: Callable[[int, int], Rig]) -> None:
    cell = rig(5, 1)

    def blind() -> None:
        cell.backend.take_frames()

    last = cell.run(blind)
    assert "no_image: the belt camera delivers no frames" in last.failure


def test_a_node_that_does_not_answer_ends_the_round(rig: Callable[[int, int], Rig]) -> None:
    cell = rig(5, 1)
    silent = cell._obey
    cell._obey = lambda command: silent(command)  # type: ignore[method-assign]

    def forget() -> None:
        cell._replies = ()

    last = cell.run(forget)
    assert "timeout: the node did not answer a command" in last.failure


def test_onions_out_of_reach_are_left_and_said_so(rig: Callable[[int, int], Rig]) -> None:
    """Beside the pick window, where the camera still counts them but the arm cannot go."""
    cell = rig(5, 1)
    config = reference()
    X_WO = cell.backend.world.onion_pose(0)
    X_WO[:2, 3] = (config.belt.pick_x[1] + 0.045, config.belt.pick_y[1] + 0.045)
    cell.backend.world.set_onion_pose(0, X_WO)
    last = cell.run()
    assert last.done and last.state.sorted == 0
    assert "out of the arm's reach" in cell.texts[-1]


def test_an_onion_that_cannot_be_seen_in_the_hand_goes_to_the_bin(rig: Callable[[int, int], Rig]) -> None:
    """Nothing proves that it is sound, and the bin is the safe side."""
    cell = rig(SOUND_SEED, 1)
    cell.detector.blind_to_held = True
    last = cell.run()
    assert (last.state.in_bin, last.state.on_conveyor) == (1, 0)
    assert any("not recognised in any view" in text for text in cell.texts)


def test_a_round_that_takes_too_long_ends(rig: Callable[[int, int], Rig]) -> None:
    cell = rig(5, 1)
    timeout = reference().supervisor.round_timeout
    cell.step()
    late = replace(cell.inputs[0], t=cell.inputs[0].t + timeout + 1.0)
    outputs = cell.supervisor.tick(late)
    assert outputs.done and outputs.failure == f"the round took longer than {timeout:g} s"
    assert np.isfinite(outputs.state.t)
