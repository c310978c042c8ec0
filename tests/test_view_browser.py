"""The live page in a real browser: what its buttons do to an arm that moves."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from cell.config import CellConfig
from cell.run.desk import Desk
from cell.run.node_process import NodeProcess
from cell.view.controls import APART
from cell.view.live import LiveSource
from cell.view.serve import serve
from cell.wire import types as T
from cell.wire.session import Session
from tests import browser
from tests.browser import Browser
from tests.test_cli import free_port
from tests.test_limits import HOME, move
from tests.wire_helpers import own_port, pause, until

pytestmark = pytest.mark.skipif(
    not browser.find(), reason=f"no browser installed; one of {', '.join(browser.NAMES)} is needed"
)

HOLDER = "test"
SWING = np.array([0.4, 0.2, -0.3, 0.2, 0.1, 0.5])
REST = 0.01
"""Slower joints rest [rad/s]."""


@dataclass
class Cell:
    """A simulated arm that swings to and fro until it is stopped; time goes on by itself.

    Attributes:
        samples: (t, stopped, fastest joint [rad/s]) of every step. resumed: orders to resume that came.
    """

    config: CellConfig
    samples: list[tuple[float, bool, float]] = field(default_factory=list)
    resumed: int = 0
    ended: bool = False

    def run(self, session: Session) -> None:
        keys, desk = session.keys, Desk(self.config)
        desk.open(session)
        number = 0
        while not self.ended:
            reply = session.call(keys.sim_step, T.StepRequest(HOLDER, 5), T.StepReply, timeout=30.0)
            arm, joints = reply.arm_status, reply.joint_state
            self.samples.append((joints.t, arm.stopped, float(np.abs(joints.qd).max())))
            for wish in desk.take():
                if wish.order == "resume":
                    self.resumed += 1
                    assert session.call(keys.resume, T.Resume(HOLDER), T.Reply).accepted
            if not arm.moving and not arm.stopped and np.abs(joints.qd).max() < 1e-4:
                number += 1
                swing = move(joints.q, HOME + SWING * (number % 2), 4.0)
                order = replace(swing, id=number, holder=HOLDER, expires=joints.t + 1.0)
                session.call(keys.trajectory, order, T.Reply)
            pause(0.01)

    def moving(self) -> bool:
        return bool(self.samples) and self.samples[-1][2] > 0.1

    def stopped(self) -> bool:
        return bool(self.samples) and self.samples[-1][1]


@pytest.fixture
def swinging() -> Iterator[Cell]:
    config = own_port()
    with NodeProcess(config, backend="sim", lock_step=True, seed=0, onions=1) as node:
        node.wait_ready()
        with Session.connect(config) as session:
            cell = Cell(config)
            thread = threading.Thread(target=cell.run, args=(session,), daemon=True)
            thread.start()
            yield cell
            cell.ended = True
            thread.join(10.0)


@pytest.fixture
def page(swinging: Cell) -> Iterator[str]:
    """Address of the swinging cell's page."""
    ended, address = threading.Event(), []
    config, port = swinging.config, free_port()

    def show() -> None:
        serve(config, port, lambda: LiveSource(config, 10.0), address.append, ended.is_set)

    thread = threading.Thread(target=show, daemon=True)
    thread.start()
    until(lambda: address, 30.0)
    yield address[0]
    ended.set()
    thread.join(10.0)


def test_one_click_stops_the_arm_and_two_deliberate_ones_resume(swinging: Cell, page: str) -> None:
    with Browser(page, (900, 600), sharpness=0.15) as view:
        view.wait_for_button("STOP")
        until(swinging.moving, 20.0)
        view.click("STOP")
        until(swinging.stopped, 20.0)
        until(lambda: swinging.samples[-1][2] < REST, 20.0)
        begin = next(t for t, stopped, _ in swinging.samples if stopped)
        rest = next(t for t, stopped, speed in swinging.samples if stopped and speed < REST)
        assert rest - begin < 0.6  # simulated seconds of braking on the path
        view.wait_for_text("stopped by the operator in the view")

        view.wait_for_text("Resume after stop")
        view.wait(
            "[...document.querySelectorAll('button')].some(b => /^Resume/.test(b.textContent) && !b.disabled)"
        )
        view.click("Resume after stop")
        view.wait_for_button("Resume after stop: click again")
        seen = len(swinging.samples)
        until(lambda: len(swinging.samples) > seen + 25, 20.0)
        assert swinging.resumed == 0 and swinging.stopped()
        assert max(speed for _, _, speed in swinging.samples[seen:]) < REST
        pause(APART)
        view.click("Resume after stop: click again")
        until(lambda: not swinging.stopped(), 20.0)
        assert swinging.resumed == 1
