"""Plays a recording: a slider for the time, play and pause."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cell.clock import WallClock
from cell.view.recorded import RecordedSource

if TYPE_CHECKING:
    from viser import ViserServer

_RATES = ("0.5x", "1x", "2x", "5x")


class Player:
    """Moves the time of a recording."""

    def __init__(self, server: ViserServer, source: RecordedSource) -> None:
        self._source, self._clock = source, WallClock()
        self._playing = True
        self._last = self._clock.now()
        self._slider = server.gui.add_slider(
            "time [s]", 0.0, round(source.end - source.start, 2), 0.01, 0.0, hint="of the recording"
        )
        self._slider.on_update(self._moved)
        self._button = server.gui.add_button("Pause", color="blue")
        self._button.on_click(self._pressed)
        self._rate = server.gui.add_dropdown("speed", _RATES, initial_value="1x")

    def advance(self) -> None:
        """Let the recording go on by the time that has passed."""
        now = self._clock.now()
        passed, self._last = now - self._last, now
        source = self._source
        if not self._playing:
            return
        source.t = min(source.end, source.t + min(passed, 1.0) * float(self._rate.value[:-1]))
        self._slider.value = round(source.t - source.start, 2)
        if source.t >= source.end:
            self._play(False)

    def _moved(self, event: Any) -> None:
        if event.client_id is not None:  # by a person
            self._source.t = self._source.start + float(self._slider.value)

    def _pressed(self, event: Any) -> None:
        del event
        if not self._playing and self._source.t >= self._source.end:
            self._source.t = self._source.start
        self._play(not self._playing)

    def _play(self, playing: bool) -> None:
        self._playing = playing
        self._button.label = "Pause" if playing else "Play"
