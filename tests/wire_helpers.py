"""What the tests of the wire share: a port of their own, waiting, and other processes."""

from __future__ import annotations

import socket
import subprocess
import sys
from typing import Any

import msgspec
import numpy as np

from cell.clock import WallClock, perf_s
from cell.config import CellConfig, load
from cell.wire import types as T

HEAD = """
import os, signal, sys, threading, time
import msgspec, numpy as np
from cell.config import load
from cell.wire import types as T
from cell.wire.session import Session
config = msgspec.structs.replace(load(), port={port})
"""


def own_port() -> CellConfig:
    """The reference cell on a port that was free just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return msgspec.structs.replace(load(), port=probe.getsockname()[1])


def pause(seconds: float) -> None:
    clock = WallClock()
    clock.sleep_until(clock.now() + seconds)


def until(condition: Any, seconds: float = 3.0) -> None:
    end = perf_s() + seconds
    while not condition():
        assert perf_s() < end, "waited in vain"
        pause(0.002)


def joints(t: float) -> T.JointState:
    return T.JointState(t, np.full(6, t), np.zeros(6), np.zeros(6))


def start(config: CellConfig, code: str, **kwargs: Any) -> subprocess.Popen[str]:
    script = HEAD.format(port=config.port) + code
    return subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **kwargs
    )
