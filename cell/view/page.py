"""The page: its scene, its panel, and how often each part is drawn anew."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.clock import WallClock
from cell.config import CellConfig
from cell.decision.policy import shipped
from cell.view import drawing, words
from cell.view.controls import Controls
from cell.view.live import LiveSource
from cell.view.moment import Moment, Source
from cell.view.onions import Perceived
from cell.view.person import PersonFigure
from cell.view.player import Player
from cell.view.plots import Plots
from cell.view.recorded import RecordedSource
from cell.view.scene import Scene
from cell.view.tool import tool_speed

if TYPE_CHECKING:
    from viser import ViserServer

_STATUS, _PICTURES, _CURVES = 0.25, 0.35, 1.0
"""Least times between two drawings of words, pictures and person, plots [s]."""


class Due:
    """Whether it is time again."""

    def __init__(self, every: float) -> None:
        self._every, self._last = every, -1e9

    def now(self, t: float) -> bool:
        if 0.0 <= t - self._last < self._every:
            return False
        self._last = t
        return True


class Page:
    """Draws moments.

    Args:
        source: where the moments come from; a live one can be asked for things.
    """

    def __init__(self, server: ViserServer, config: CellConfig, source: Source) -> None:
        self._server, self._config, self._source = server, config, source
        gui = server.gui
        gui.configure_theme(
            control_layout="fixed", control_width="large", show_logo=False, show_share_button=False
        )
        gui.set_panel_label("sorting cell")
        self._status = gui.add_html(words.note("waiting for the cell"))
        live = source if isinstance(source, LiveSource) else None
        self._live = live
        self._controls = None if live is None else Controls(server, config, live)
        self._player = Player(server, source) if isinstance(source, RecordedSource) else None
        self._picture = gui.add_image(np.full((240, 644, 3), 60, np.uint8), format="jpeg", jpeg_quality=80)
        self._plots = Plots(server)
        self._show_truth = None if live is None else gui.add_checkbox("true onions (simulation)", False)
        if self._controls is not None:
            self._controls.add_next_round(server, list(shipped()))
        with gui.add_folder("Events", expand_by_default=False):
            self._events = gui.add_html(words.note(""))
        self._scene = Scene(server, config)
        self._perceived, self._figure = Perceived(config), PersonFigure(config)
        self._clock = WallClock()
        self._due = {"words": Due(_STATUS), "pictures": Due(_PICTURES), "plots": Due(_CURVES)}
        self._began: float | None = None
        self._ended: float | None = None
        self._whole = live is None
        self._last_picture: tuple[float, ...] = ()

    def draw(self) -> None:
        """Draw what is due of the present moment."""
        if self._player is not None:
            self._player.advance()
        self._show(self._source.moment())

    def _show(self, moment: Moment) -> None:
        onions = self._perceived.update(moment)  # follows the hand, also while nobody looks
        self._figure.note(moment, onions)
        self._keep_time(moment)
        if self._live is not None and self._show_truth is not None:
            watched = bool(self._server.get_clients())
            self._live.want_truth = watched and bool(self._show_truth.value)
        if not self._server.get_clients():
            return
        now = self._clock.now()
        with self._server.atomic():
            self._scene.show(moment)
            self._scene.onions(onions)
            self._scene.truth(moment)
        if self._due["words"].now(now):
            self._words(moment)
        if self._due["pictures"].now(now):
            self._pictures(moment)
            figure = self._figure.update(moment)
            separation = np.inf if moment.state is None else moment.state.separation
            if figure is not None or not np.isfinite(separation):
                self._scene.person(figure, separation)
        if self._due["plots"].now(now):
            self._plots.show(self._source.curves())

    # -- parts ----------------------------------------------------------------------------------------

    def _words(self, moment: Moment) -> None:
        speed = 0.0 if moment.joints is None else tool_speed(moment.joints, self._config.gripper.length)
        self._status.content = words.status(moment, speed, self._elapsed(moment), self._whole)
        self._events.content = words.events(moment.events)
        if self._controls is not None:
            self._controls.show(moment)

    def _pictures(self, moment: Moment) -> None:
        seen = [f[1].t for f in (moment.detections, moment.hands) if f is not None]
        seen += [f.t for f in moment.frames.values()]
        if tuple(seen) == self._last_picture:
            return
        self._last_picture = tuple(seen)
        picture = drawing.both(moment)
        if picture is not None:
            self._picture.image = picture

    def _keep_time(self, moment: Moment) -> None:
        if moment.state is None:
            self._whole |= moment.fresh  # the round has not begun
            return
        if self._began is None or moment.state.t < self._began:
            self._whole |= self._began is not None  # the clock was set back: a new round
            self._began, self._ended = moment.state.t, None
        if moment.state.phase == "done" and self._ended is None:
            self._ended = moment.state.t

    def _elapsed(self, moment: Moment) -> float:
        if moment.state is None or self._began is None:
            return 0.0
        return (moment.state.t if self._ended is None else self._ended) - self._began
