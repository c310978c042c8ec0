"""The view without a browser: what it reads, says and refuses, and what an operator's orders do."""

from __future__ import annotations

import dataclasses
import math
import socket
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest
import viser
from hypothesis import given, settings
from hypothesis import strategies as st
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from cell.clock import StepClock
from cell.config import load
from cell.decision import policy
from cell.decision.io import Inputs, Outputs
from cell.decision.supervisor import Supervisor
from cell.errors import DecodeError, WireError
from cell.frames import Array, look_at
from cell.limits import tcp_positions
from cell.motion.collision import CollisionModel
from cell.perception.separation import Cloud, Separation
from cell.record import tick
from cell.record.content import About, Content
from cell.record.decision import Decision, code, whole_frames
from cell.record.mcap_writer import McapFile
from cell.replay.recorded import Recorded
from cell.run.desk import Desk
from cell.run.tell import planned_path
from cell.view import drawing, words
from cell.view.controls import APART, ARMED, TwoClicks
from cell.view.live import LiveSource
from cell.view.moment import Moment
from cell.view.onions import Onion, Perceived
from cell.view.person import PersonFigure
from cell.view.recorded import RecordedSource
from cell.view.web import make_server, stop_server
from cell.wire import codec
from cell.wire import types as T
from cell.wire.keys import Keys
from cell.wire.service import Tapped
from cell.wire.session import Session
from cell.wire.vocabulary import Action, Mode
from tests.rig import Rig, motion, reference
from tests.test_cli import cell, free_port
from tests.test_codec import examples, trajectory
from tests.test_limits import HOME, move
from tests.wire_helpers import own_port, until

OF = {type(m): m for m in examples()}
STATE: T.SupervisorState = OF[T.SupervisorState]  # type: ignore[assignment]


def order(name: str, value: float = 0.0) -> T.OperatorCommand:
    return T.OperatorCommand("view", name, value)


# -- what an operator's orders do -------------------------------------------------------------------


class Operated(Rig):
    """A rig whose supervisor waits for an operator after a stop; `orders` go into the next tick."""

    def __init__(self, seed: int, onions: int) -> None:
        super().__init__(seed, onions, "expert")
        section = msgspec.structs.replace(reference().supervisor, stop_patience=60.0)
        person = msgspec.structs.replace(reference().separation, patience=0.5)
        config = msgspec.structs.replace(reference(), supervisor=section, separation=person)
        table = policy.load("expert")
        self.supervisor = Supervisor(config, table, *motion(), self.detector, "test")
        self.orders: tuple[T.OperatorCommand, ...] = ()
        supervisor = self.supervisor

        class WithOrders:
            def tick(_, inputs: Inputs) -> Outputs:
                orders, self.orders = self.orders, ()
                return supervisor.tick(dataclasses.replace(inputs, operator=orders))

        self.supervisor = WithOrders()  # type: ignore[assignment]
        self.refuse = lambda command: self._resume() if isinstance(command.order, T.Resume) else None

    def _resume(self) -> T.Reply:
        joints = self.backend.read_joints()
        self.executor.resume(joints.q, joints.qd)
        return T.Reply(True)

    @property
    def state(self) -> T.SupervisorState:
        return self.outputs[-1].state

    def until(self, condition: object, seconds: float = 60.0) -> None:
        end = self.backend.now() + seconds
        while not condition():  # type: ignore[operator]
            assert not self.step().done and self.backend.now() < end, self.texts[-6:]

    def speed(self) -> float:
        """Of the tool [m/s]."""
        qs = np.array([i.joints.q for i in self.inputs[-2:]])
        p = tcp_positions(qs, self.config.gripper.length)
        return float(np.linalg.norm(p[1] - p[0]) / (self.inputs[-1].t - self.inputs[-2].t))


@cache
def operated() -> Operated:
    """One onion, sorted in spite of a hold, a low cap, and a stop while it was in the hand."""
    rig = Operated(4, 1)
    rig.step()
    rig.until(lambda: rig.state.action == Action.PICK and rig.executor.moving)
    rig.orders = (order("hold"),)
    rig.until(lambda: rig.state.mode == Mode.HOLD)
    rig.until(lambda: not rig.executor.moving)
    held_at = rig.backend.read_joints().q
    for _ in range(50):  # longer than a person would be waited for
        assert not rig.step().done
    assert np.abs(rig.backend.read_joints().q - held_at).max() < 0.01
    assert rig.state.mode == Mode.HOLD and rig.state.binding_cap == "operator"

    rig.orders = (order("cap", 0.1), order("go"))
    rig.until(lambda: rig.state.action == Action.INSPECT)
    slow = [
        s
        for s in (o.state for o in rig.outputs)
        if s.binding_cap == "operator" and s.mode == Mode.COLLABORATIVE
    ]
    assert slow and {s.speed_cap for s in slow} == {0.1}
    rig.orders = (order("cap", 1.0),)
    rig.until(lambda: rig.state.speed_cap == reference().motion.collaborative_speed)

    rig.until(lambda: rig.executor.moving)
    rig.orders = (order("resume"),)  # nothing is stopped: it must not count later
    rig.step()
    rig.executor.stop("a test")
    rig.until(lambda: rig.state.mode == Mode.STOPPED)
    stopped_at = len(rig.outputs)
    for _ in range(25):
        assert not rig.step().done
    assert rig.executor.stop_reason and not rig.executor.moving
    assert not any(out.commands for out in rig.outputs[stopped_at + 1 :])
    rig.orders = (order("resume"),)
    rig.until(lambda: rig.state.mode == Mode.RECOVERING)
    rig.run()
    rig.backend.close()
    return rig


def test_a_round_is_held_slowed_stopped_resumed_and_completed() -> None:
    rig = operated()
    assert (rig.outputs[-1].failure, rig.state.sorted, rig.state.remaining) == ("", 1, 0)
    said = " / ".join(rig.texts)
    for text in ("'view' orders: hold", "no faster than 0.1 m/s", "an operator may resume", "resume after"):
        assert text in said


def test_without_patience_a_stop_ends_the_round_whatever_is_ordered() -> None:
    rig = Rig(4, 1)
    while not rig.executor.moving:
        rig.step()
    rig.executor.stop("a test")
    assert rig.run().failure == "the arm was stopped: a test"
    rig.backend.close()


def test_orders_are_recorded_with_the_tick_that_took_them(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    file = McapFile(path)
    table = policy.load("expert")
    files = {
        "config.json": msgspec.json.encode(reference()),
        "policy.csv": policy.write("expert", table.actions, table.bin_edges, "commit=x").encode(),
    }
    content = Content(reference(), file, About({"policy": "expert"}, files=files), lossless=False)
    rig = operated()
    given = [(), (order("hold"),), (), (order("cap", 0.2), order("go"))]
    for n, (inputs, outputs, orders) in enumerate(zip(rig.inputs, rig.outputs, given, strict=False)):
        decision = Decision(n, dataclasses.replace(inputs, operator=orders), outputs)
        content.decision(code(decision, whole_frames(reference(), lossless=False)))
    file.close()
    assert [t.inputs.operator for t in Recorded(path).ticks()] == given


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 200), st.integers(0, 255), st.integers(0, 90))
def test_garbled_orders_are_refused_or_read(at: int, value: int, cut: int) -> None:
    inputs = Inputs(1.0, OF[T.JointState], OF[T.ArmStatus], OF[T.GripperState], OF[T.BeltState])  # type: ignore[arg-type]
    good = tick.encode_operator(3, dataclasses.replace(inputs, operator=(order("hold"), order("cap", 0.3))))
    assert tick.decode_operator(good) == (3, (order("hold"), order("cap", 0.3)))
    data = bytearray(good[: len(good) - cut])
    if at < len(data):
        data[at] = value
    try:
        number, orders = tick.decode_operator(bytes(data))
    except DecodeError:
        return
    assert isinstance(number, int) and all(math.isfinite(o.value) for o in orders)


def test_the_desk_takes_what_makes_sense_and_says_why_not() -> None:
    config = own_port()
    with Session.listen(config) as node, Session.connect(config) as view:
        desk, once = Desk(config, again=True), Desk(config)
        desk.open(node)
        keys = view.keys

        def ask(key: str, request: object) -> T.Reply:
            return view.call(key, request, T.Reply)

        assert ask(keys.operator, order("hold")).accepted
        assert ask(keys.operator, order("cap", 0.05)).accepted
        assert [o.order for o in desk.take()] == ["hold", "cap"] and desk.take() == ()
        for bad in (order("fly"), order("cap", 2.0), order("cap", 0.0), order("cap", math.nan)):
            assert not ask(keys.operator, bad).accepted
        assert desk.take() == ()
        assert "legal values: hold, go, cap, resume" in ask(keys.operator, order("fly")).reason
        assert not ask(keys.next_round, T.NextRound("view", "no-such", 3, 1)).accepted
        assert not ask(keys.next_round, T.NextRound("view", "expert", 99, 1)).accepted
        assert desk.next is None
        assert ask(keys.next_round, T.NextRound("view", "expert", 3, 1)).accepted
        assert desk.next == T.NextRound("view", "expert", 3, 1)
        replies = [ask(keys.operator, order("go")) for _ in range(20)]
        assert not replies[-1].accepted and replies[-1].code == "busy"
        assert once.next is None


def test_starting_a_motion_takes_two_deliberate_clicks_of_one_person() -> None:
    clock = StepClock(0.1)
    clicks = TwoClicks(clock)

    def later(seconds: float) -> None:
        clock.advance(round(seconds / clock.period))

    assert not clicks.click(1) and clicks.armed
    assert not clicks.click(1)  # a double click
    later(APART + 0.1)
    assert not clicks.click(2)  # somebody else begins anew
    later(APART + 0.1)
    assert clicks.click(2) and not clicks.armed
    assert not clicks.click(2)
    later(ARMED + 0.2)
    assert not clicks.armed and not clicks.click(2)


# -- what is read -----------------------------------------------------------------------------------


def rgb(value: int) -> np.ndarray:
    return np.full((480, 640, 3), value, np.uint8)


def test_the_newest_of_the_wire_is_shown_with_the_frame_it_was_seen_in() -> None:
    config = own_port()
    boxes = (T.Box((10.0, 20.0, 50.0, 70.0), "blemished", 0.75),)
    with Session.listen(config, patient=True) as node:
        source = LiveSource(config, 5.0)
        assert not source.moment().fresh
        keys, depth = node.keys, np.full((480, 640), 0.6, np.float32)
        until(lambda: _published(node, source, 1.0))
        node.publish_frame(T.Frame("belt", 1, 1.0, rgb(1), depth))
        until(lambda: "belt" in source.moment().frames)
        node.publish(keys.detections, T.Detections(1.0, "belt", boxes))
        node.publish_frame(T.Frame("belt", 2, 1.5, rgb(2), depth))
        until(lambda: (m := source.moment()).detections is not None and m.frames["belt"].t == 1.5)
        moment = source.moment()
        assert moment.fresh and moment.detections is not None and moment.detections[1].t == 1.0
        node.publish(keys.events, T.Event(1.0, 20, "node", "hello"))
        node.publish(keys.planned_path, planned_path(trajectory(), 1.0, 0.163))
        until(lambda: source.moment().events and source.moment().path is not None)
        until(lambda: _published(node, source, 0.5))  # the clock was set back: another round
        assert source.moment().detections is None and not source.moment().events
        assert source.send(keys.stop, T.Stop("view", "x")) == T.Reply(
            False, "wire", f"nobody answers {keys.stop}: is the cell's node running?"
        )
        source.close()


def _published(node: Session, source: LiveSource, t: float) -> bool:
    node.publish(node.keys.joint_states, T.JointState(t, HOME, np.zeros(6), np.zeros(6)))
    return source.moment().t == t


def recording(path: Path) -> Path:
    """Two seconds: a moving arm, states, and a frame of the belt camera with a detection at 1 s."""
    file, config = McapFile(path), load()
    content = Content(config, file, None, lossless=False)
    keys, depth = Keys(config.name), np.full((480, 640), 0.6, np.float32)

    def add(key: str, message: object, t: float, seq: int = 1) -> None:
        data = codec.encode(message)
        content.sample(Tapped(key, data, seq, t, codec.ros_type(type(message)), 0))

    q = move(HOME, HOME + 0.3, 2.0, 251)
    for n, t in enumerate(q.times):
        add(keys.joint_states, T.JointState(float(t), q.q[n], q.qd[n], np.zeros(6)), float(t), n)
        if n % 5 == 0:
            state = dataclasses.replace(STATE, t=float(t), belief=float(t) / 2, speed_cap=0.25)
            add(keys.supervisor_state, state, float(t), n)
    add(keys.camera("belt", "color"), T.Image(1.0, "belt", rgb(90)), 1.0)
    add(keys.camera("belt", "depth"), T.Image(1.0, "belt", depth), 1.0)
    add(keys.detections, T.Detections(1.0, "belt", (T.Box((10.0, 20.0, 50.0, 70.0), "x", 0.7),)), 1.0)
    add(keys.events, T.Event(0.5, 20, "supervisor", "hello"), 0.5)
    file.close()
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RecordedSource]:
    yield RecordedSource(recording(tmp_path_factory.mktemp("view") / "a.mcap"))


def test_a_recording_is_shown_at_any_time_in_any_order(recorded: RecordedSource) -> None:
    q = move(HOME, HOME + 0.3, 2.0, 251)
    assert recorded.start == 0.0 and abs(recorded.end - 2.0) < 0.05
    for t in (2.0, 0.4, 1.2, 0.0):
        recorded.t = t
        moment = recorded.moment()
        assert moment.joints is not None and moment.state is not None
        assert np.abs(moment.joints.q - q.q[round(t / 0.008)]).max() < 0.02
        assert abs(moment.state.belief - t / 2) < 0.03
        assert (moment.detections is not None) == (t >= 1.0)
        assert len(moment.events) == (t >= 0.5)
        curves = recorded.curves()
        assert len(curves.t) == len(curves.speed) and (t == 0.0 or abs(curves.t[-1] - t) < 0.05)
    picture = drawing.both(dataclasses.replace(moment, frames={}))
    assert picture is None


def test_onions_are_placed_where_the_robot_sees_them_and_go_with_the_hand() -> None:
    config = load()
    camera = config.cameras["belt"]
    X_WC = look_at(camera.position, camera.target)
    p_WO = np.array([0.34, -0.02, config.belt.top_z + 0.035])
    frame, box = _onion_in_view(p_WO, 0.035)
    perceived = Perceived(config)
    moment = Moment(t=1.0, detections=(T.Detections(1.0, "belt", (box,)), frame))
    (onion,) = perceived.update(moment)
    assert np.linalg.norm(onion.p_WO - p_WO) < 0.012 and onion.label == "blemished"
    joints = T.JointState(1.0, HOME, np.zeros(6), np.zeros(6))
    gripper = T.GripperState(1.0, 0.06, 0.0, False, True)
    held = perceived.update(dataclasses.replace(moment, joints=joints, gripper=gripper))[-1]
    assert np.allclose(held.p_WO, tcp_positions(HOME[None], config.gripper.length)[0])
    assert X_WC.shape == (4, 4)


def _onion_in_view(p_WO: np.ndarray, radius: float) -> tuple[T.Frame, T.Box]:
    """A sphere's depth image in the belt camera, ray by ray, and the box around it."""
    from cell.cameras import camera_pinhole

    camera = load().cameras["belt"]
    X_WC, pinhole = look_at(camera.position, camera.target), camera_pinhole(camera)
    p_C = X_WC[:3, :3].T @ (p_WO - X_WC[:3, 3])
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = pinhole.back_project(np.stack([u, v], axis=-1), np.ones(u.shape))
    a, b = (rays * rays).sum(-1), rays @ p_C
    root = b * b - a * (p_C @ p_C - radius * radius)
    depth = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0.9).astype(np.float32)
    rows, columns = np.nonzero(root > 0)
    corners = (float(columns.min()), float(rows.min()), float(columns.max()), float(rows.max()))
    return T.Frame("belt", 1, 1.0, rgb(90), depth), T.Box(corners, "blemished", 0.9)


# -- what is said -----------------------------------------------------------------------------------


def test_a_frame_is_drawn_beside_the_arm_and_the_onions_of_its_exposure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It comes a while later; what has just been lifted or moved away would be drawn as a person."""
    config = reference()
    shown: list[tuple[T.Frame, Array, Array]] = []

    def look(self: Separation, frame: T.Frame, arm: Array, onions: Array) -> Cloud:
        shown.append((frame, arm, onions))
        return Cloud(frame.t, np.zeros((0, 3)), np.zeros(0), 1.0)

    monkeypatch.setattr(Separation, "look", look)
    figure = PersonFigure(config)
    home, lifted_at = np.array(config.arm.home), 2.0
    onion = Onion(np.array([0.1, 0.5, 0.1]), 0.03, "")
    rgb, depth = np.zeros((480, 640, 3), np.uint8), np.zeros((480, 640), np.float32)
    for t in np.arange(0.0, 4.0, 0.1):
        held = bool(t >= lifted_at)
        moment = Moment(
            float(t),
            True,
            joints=T.JointState(float(t), home + 0.5 * t, np.full(6, 0.5), np.zeros(6)),
            gripper=T.GripperState(float(t), 0.05, 0.05, False, held),
            frames={"person": T.Frame("person", round(t * 10), float(t) - 0.23, rgb, depth)},
        )
        figure.note(moment, [] if held else [onion])
        figure.update(moment)
    collision = CollisionModel(config)
    for frame, arm, onions in shown[3:]:
        held = frame.t >= lifted_at - 0.05
        radius = 0.5 * config.onions.diameter[1] if held else 0.0
        p, r, _ = collision.spheres((home + 0.5 * frame.t)[None], width=0.05, held_radius=radius)
        assert np.allclose(arm, np.column_stack([p[0], r])) and len(onions) == (not held)
    assert len(shown) == 40


def test_texts_of_the_wire_cannot_become_a_page_of_their_own() -> None:
    bad = "<img src=x onerror=alert(1)>"
    arm = T.ArmStatus(1.0, stopped=True, stop_reason=bad)
    state = dataclasses.replace(STATE, binding_cap=bad, gesture="up", reason=bad)
    for moment in (Moment(fresh=True, arm=arm, state=state), Moment(fresh=True, state=state)):
        assert "<img" not in words.status(moment, 0.1, 3.0, True)
    assert "<img" not in words.events((T.Event(1.0, 40, bad, bad),))
    strange = dataclasses.replace(state, mode=99, action=-3, prediction=77, human_action=55)
    assert "?" in words.status(Moment(fresh=True, state=strange), 0.1, 3.0, False)


def one_line(*args: object) -> str:
    run = cell(*args)
    assert run.returncode == 2, run.stderr
    assert run.stdout == "" and run.stderr.count("\n") == 1 and run.stderr.startswith("cell: ")
    return run.stderr


def test_bad_input_gets_one_line(tmp_path: Path) -> None:
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"junk" * 100)
    assert "cannot read" in one_line("view", tmp_path / "none.mcap")
    assert "no MCAP recording" in one_line("view", junk)
    assert "1024 to 65535" in one_line("run", "--view", "--view-port", 80)


@pytest.mark.parametrize(
    ("origin", "let_in"),
    [
        ("http://127.0.0.1:8080", True),
        ("http://localhost:9999", True),
        (None, True),
        ("https://example.com", False),
        ("http://127.0.0.1.example.com", False),
        ("null", False),
    ],
)
def test_a_web_page_from_elsewhere_cannot_reach_the_cell(origin: str | None, let_in: bool) -> None:
    port = free_port()
    server = make_server(port)
    try:
        try:
            with connect(
                f"ws://127.0.0.1:{port}",
                origin=origin,  # type: ignore[arg-type]
                subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
                max_size=None,
            ) as page:
                assert page.recv(timeout=10.0)
            reached = True
        except InvalidStatus as refused:
            assert refused.response.status_code == 403
            reached = False
        assert reached == let_in
    finally:
        stop_server(server)


def test_an_absent_cell_and_a_taken_port_are_told(tmp_path: Path) -> None:
    config = own_port()
    with pytest.raises(WireError, match="is the cell's node running"):
        LiveSource(config, 0.2)
    port = free_port()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", port))
        taken.listen()
        with pytest.raises(WireError, match=f"port {port}"):
            make_server(port)
        assert f"port {port}" in one_line("run", "--headless", "--view", "--view-port", port)
