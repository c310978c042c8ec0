"""The emulated controller of a campaign's round: it serves while the round runs, and is gone after it."""

from __future__ import annotations

import socket

import pytest

from cell.config import load
from cell.run.round import RoundOptions
from cell.trials.emulated import Emulated
from hil.sim.render.renderer import gl_problem

NO_GL = gl_problem()


@pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
def test_it_serves_for_one_round_and_tells_how_many_cycles_it_left_out() -> None:
    emulated = Emulated(load(), seed=1, onions=1, persona="none")
    with emulated:
        options = emulated.options(RoundOptions(backend="ur3e"))
        assert options.robot_ip == emulated.address and options.simulated
        socket.create_connection((emulated.address, 29999), 5.0).close()
        assert emulated.left_out is None
    assert emulated.left_out is not None and emulated.left_out >= 0
    with pytest.raises(OSError):
        socket.create_connection((emulated.address, 29999), 1.0)
