"""The simulated surroundings of an emulated controller: a backend's cameras, and the judge's truth."""

from __future__ import annotations

import queue
import threading
from types import TracebackType
from typing import Self

from cell.cameras import camera_pinhole
from cell.config import CellConfig
from cell.errors import BackendError, CellError, ConfigError, one_of
from cell.wire.reader import LatestFrame
from cell.wire.session import Session
from cell.wire.types import CameraInfo, Capture, Frame, Reply, ResetRequest, Truth, TruthRequest
from hil.emulator.world_link import RESET_TIME, open_world, reset_key

_HOLDER = "backend"
_CONNECT_TIME = 5.0
_CALL_TIME = 5.0
"""An answer takes as long as the picture that is being drawn [s]."""


class SimCamera:
    """`hil.cameras.CameraSource` of one camera of the simulated cell.

    Args:
        name: as in the configuration. config: the cell. address: of the emulator, "host" or "host:port".

    Raises:
        ConfigError: there is no such camera.
    """

    def __init__(self, name: str, config: CellConfig, address: str) -> None:
        if name not in config.cameras:
            raise ConfigError(f"camera: {one_of(name, config.cameras)}")
        self.name = name
        self._config, self._address = config, address
        self._session: Session | None = None
        self._frames: LatestFrame | None = None
        self._requests: queue.SimpleQueue[Session | None] = queue.SimpleQueue()
        self._trouble = ""

    def connect(self) -> None:
        """Join the side channel; raises `WireError` when no emulator answers."""
        if self._session is not None:
            return
        self._session = open_world(self._config, self._address, _CONNECT_TIME)
        self._frames = self._session.latest_frame(self.name)
        self._trouble = ""
        threading.Thread(target=self._ask, name=f"camera {self.name}", daemon=True).start()

    def info(self) -> CameraInfo:
        """Intrinsics: both sides know them from the configuration."""
        camera = self._config.cameras[self.name]
        p = camera_pinhole(camera)
        return CameraInfo(0.0, f"camera_{self.name}", p.width, p.height, p.fx, p.fy, p.cx, p.cy)

    def request(self) -> None:
        """Expose one frame now; what comes of it shows in `take`."""
        self._requests.put(self._connected())

    def take(self) -> list[Frame]:
        self._connected()
        assert self._frames is not None
        if self._trouble:
            raise BackendError(f"camera {self.name}: {self._trouble}")
        return self._frames.take_all()

    def close(self) -> None:
        if self._session is not None:
            self._requests.put(None)
            self._session.close()
            self._session = self._frames = None

    def _connected(self) -> Session:
        if self._session is None:
            raise BackendError(f"camera {self.name} is not connected; call connect() first")
        return self._session

    def _ask(self) -> None:
        """Requests are queries, and a query waits for its answer: not in the backend's loop."""
        while (session := self._requests.get()) is not None:
            try:
                key = session.keys.camera(self.name, "capture")
                reply = session.call(key, Capture(_HOLDER), Reply, _CALL_TIME)
                self._trouble = "" if reply.accepted else f"{reply.code}: {reply.reason}"
            except CellError as error:
                self._trouble = str(error)


class SimSurroundings:
    """Truth and new batches of the simulated cell; a context manager.

    Args:
        config: the cell. address: of the emulator, "host" or "host:port".

    Raises:
        WireError: no emulator answers there.
    """

    def __init__(self, config: CellConfig, address: str) -> None:
        self._session = open_world(config, address, _CONNECT_TIME)

    def truth(self) -> Truth:
        """What really is, times in wall clock; for judging, never for deciding. Raises `WireError`."""
        return self._session.call(self._session.keys.sim_truth, TruthRequest(_HOLDER), Truth, _CALL_TIME)

    def reset(self, seed: int, onions: int, persona: str = "") -> None:
        """Bring a new batch and person ("" is nobody), with the arm where it is; takes some seconds.

        Raises:
            BackendError: it was refused, with the reason. WireError: no answer.
        """
        request = ResetRequest(_HOLDER, seed, onions)
        reply = self._session.call(reset_key(persona), request, Reply, RESET_TIME)
        if not reply.accepted:
            raise BackendError(f"new batch refused: {reply.reason}")

    def close(self) -> None:
        self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
