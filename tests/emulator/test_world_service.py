"""The side channel, end to end: the process with the surroundings, a plant in real time, clients."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cell.clock import WallClock, perf_s
from cell.config import load
from cell.errors import BackendError, CellError, ConfigError, WireError
from cell.wire.types import Frame
from hil.cameras import CameraSource
from hil.emulator.interfaces import PERIOD
from hil.emulator.plant import WorldPlant
from hil.emulator.surroundings import Surroundings
from hil.emulator.world_client import SimCamera, SimSurroundings
from hil.sim.render.renderer import gl_problem
from hil.ur3e.lamp import lamp_bits

CONFIG = load()
NO_GL = gl_problem()
pytestmark = pytest.mark.skipif(bool(NO_GL), reason=NO_GL)
ADDRESS = "127.0.0.43:17448"


@dataclass
class Running:
    surroundings: Surroundings
    plant: WorldPlant


@contextmanager
def in_real_time(plant: WorldPlant) -> Iterator[None]:
    """Steps the plant at home as the controller's loop does."""
    clock, ended = WallClock(), threading.Event()
    home, rest = np.array(CONFIG.arm.home), np.zeros(6)

    def loop() -> None:
        due = clock.now()
        while not ended.is_set():
            due = max(due + PERIOD, clock.now())
            clock.sleep_until(due)
            plant.step(home, rest)

    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@pytest.fixture(scope="module")
def running() -> Iterator[Running]:
    surroundings = Surroundings(CONFIG, ADDRESS, seed=1, onions=5, persona="ana")
    plant = WorldPlant(CONFIG, surroundings.exchange)
    try:
        with in_real_time(plant):
            surroundings.wait_ready()
            yield Running(surroundings, plant)
    finally:
        surroundings.close()
        plant.close()


def wait_for(condition: Callable[[], object], seconds: float = 20.0) -> None:
    clock, end = WallClock(), perf_s() + seconds
    while not condition():
        assert perf_s() < end, "waited in vain"
        clock.sleep_until(clock.now() + 0.01)


def frames(camera: CameraSource, count: int) -> list[Frame]:
    out: list[Frame] = []
    wait_for(lambda: out.extend(camera.take()) or len(out) >= count)
    return out


@contextmanager
def connected(name: str) -> Iterator[CameraSource]:
    camera: CameraSource = SimCamera(name, CONFIG, ADDRESS)
    camera.connect()
    try:
        yield camera
    finally:
        camera.close()
        camera.close()  # harmless


def test_a_free_running_camera_with_times_of_this_machine(running: Running) -> None:
    with connected("person") as camera:
        got = frames(camera, 4)
        info = camera.info()
    now = WallClock().now()
    assert all(now - 60.0 < frame.t < now for frame in got)
    assert all(a.t < b.t for a, b in pairwise(got))
    assert (info.width, info.height, info.frame) == (640, 480, "camera_person")
    assert got[0].rgb.shape == (480, 640, 3) and got[0].depth.dtype == np.float32


def test_a_camera_on_demand_exposes_when_asked(running: Running) -> None:
    with connected("belt") as camera:
        clock = WallClock()
        clock.sleep_until(clock.now() + 0.3)
        assert camera.take() == []
        asked = clock.now()
        camera.request()
        (frame,) = frames(camera, 1)
        assert asked - 0.5 < frame.t < clock.now() - CONFIG.cameras["belt"].latency
        clock.sleep_until(clock.now() + 0.2)
        assert camera.take() == []  # each once


def test_truth_and_lamp(running: Running) -> None:
    with SimSurroundings(CONFIG, ADDRESS) as surroundings:
        running.plant.outputs(lamp_bits("industrial"))
        truth = surroundings.truth()
        assert abs(truth.t - WallClock().now()) < 5.0
        assert len(truth.place) == 5 and truth.person is not None and truth.person.name == "ana"


def test_a_new_batch_comes_with_the_arm_where_it_is(running: Running) -> None:
    with SimSurroundings(CONFIG, ADDRESS) as surroundings:
        surroundings.reset(seed=4, onions=3, persona="chen")
        truth = surroundings.truth()
        assert len(truth.place) == 3 and truth.person is not None and truth.person.name == "chen"
        assert set(truth.place) <= {"belt", "held"}
        assert running.plant.batch == 2
        assert np.allclose(running.plant.measure().q, CONFIG.arm.home, atol=1e-3)
        with pytest.raises(BackendError, match="onions must be from 0 to 15, got 20"):
            surroundings.reset(seed=4, onions=20, persona="chen")
        assert len(surroundings.truth().place) == 3  # as before
        surroundings.reset(seed=4, onions=2, persona="")
        assert surroundings.truth().person is None
    with connected("belt") as camera:
        camera.request()
        assert frames(camera, 1)[0].camera == "belt"


def test_an_address_that_is_taken(running: Running) -> None:
    second = Surroundings(CONFIG, ADDRESS, seed=1, onions=1, persona="")
    try:
        with pytest.raises(CellError, match=r"in use: another emulator runs at this address.*--listen"):
            second.wait_ready()
    finally:
        second.close()


def test_mistakes_of_clients() -> None:
    with pytest.raises(ConfigError, match="camera: got 'ceiling'; legal values: belt, person"):
        SimCamera("ceiling", CONFIG, ADDRESS)
    camera = SimCamera("belt", CONFIG, "127.0.0.44:17448")
    with pytest.raises(BackendError, match="not connected"):
        camera.take()
    with pytest.raises(WireError, match=r"no simulated surroundings at tcp/127\.0\.0\.44:17448"):
        camera.connect()


def test_the_process_ends_with_the_emulator() -> None:
    surroundings = Surroundings(CONFIG, "127.0.0.45:17448", seed=1, onions=1, persona="")
    pid, began = surroundings.pid, perf_s()
    surroundings.close()  # while it still builds its world
    assert perf_s() - began < 2.0
    assert not Path(f"/proc/{pid}").exists()
    assert not surroundings.alive
