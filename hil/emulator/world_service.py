"""The side channel of the emulator: what a real cell has around its robot, and a simulated one must offer.

It is Zenoh on a port of its own beside the controller's, with the messages of the cell's wire:

| key | message |
|---|---|
| `emulator/camera/<name>/{color,depth,camera_info}` | published: sensor_msgs/Image, CameraInfo |
| `emulator/camera/<name>/capture` | query: Capture -> Reply; expose one frame now |
| `emulator/sim/truth` | query: TruthRequest -> Truth; for judging, never for deciding |
| `emulator/reset/<persona or none>` | query: ResetRequest -> Reply: a new batch and person |

All times are wall clock (Unix time) of this machine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from cell.config import CellConfig
from cell.wire.session import Session
from cell.wire.types import Capture, Reply, ResetRequest, TruthRequest
from hil.emulator.mirror import MirrorBackend
from hil.emulator.world_link import RESET_TIME, reset_key
from hil.inbox import Inbox
from hil.sim.person.persona import PERSONAS

Renew = Callable[[int, int, str], None]
"""Seed, onions, persona."""


class WorldService:
    """Serves one `MirrorBackend` on a session.

    Args:
        renew: told to bring a new batch; returns when it lies there. Called in `work`.
    """

    def __init__(self, config: CellConfig, backend: MirrorBackend, session: Session, renew: Renew) -> None:
        self._config, self._backend, self._session, self._renew = config, backend, session, renew
        self._inbox = Inbox(lambda code, reason: None, RESET_TIME)
        keys, serve = session.keys, self._serve
        serve(keys.sim_truth, TruthRequest, lambda request: backend.truth())
        for camera in config.cameras:
            serve(keys.camera(camera, "capture"), Capture, self._capture(camera))
        for persona in ("", *PERSONAS):
            serve(reset_key(persona), ResetRequest, self._reset(persona))

    def work(self) -> None:
        """Answer the queries that wait, and publish the frames that are due."""
        self._inbox.drain()
        for frame in self._backend.take_frames():
            self._session.publish_frame(frame)
            info = replace(self._backend.camera_info(frame.camera), t=frame.t)
            self._session.publish(self._session.keys.camera(frame.camera, "camera_info"), info)

    def close(self) -> None:
        self._inbox.close()

    def _serve(self, key: str, request: type[Any], handler: Callable[[Any], Any]) -> None:
        self._session.serve(key, request, self._inbox.wrap(handler))

    def _capture(self, camera: str) -> Callable[[Capture], Reply]:
        def expose(request: Capture) -> Reply:
            del request
            self._backend.request_frame(camera)
            return Reply(True)

        return expose

    def _reset(self, persona: str) -> Callable[[ResetRequest], Reply]:
        def reset(request: ResetRequest) -> Reply:
            self._renew(request.seed, request.onions, persona)
            return Reply(True)

        return reset
