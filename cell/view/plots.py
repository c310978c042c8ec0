"""Belief, speed cap and speed of the tool over the last minute."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.frames import Array
from cell.view import words
from cell.view.moment import SPAN, Curves

if TYPE_CHECKING:
    from viser import ViserServer

_POINTS = 300
_TALL = 86


class Plots:
    """Two small plots."""

    def __init__(self, server: ViserServer) -> None:
        from viser import uplot

        none = (np.zeros(2), np.zeros(2))
        axes = (
            uplot.Axis(show=True, size=22, label=""),
            uplot.Axis(show=True, size=34, splits=(0.0, 0.5, 1.0)),
        )
        self._uplot = uplot
        server.gui.add_html(words.note("belief that the person is tired, over the last minute"))
        self._belief = server.gui.add_uplot(
            data=none,
            series=(uplot.Series(label="s"), uplot.Series(label="belief: tired", stroke="#7b1fa2", width=2)),
            scales={"x": uplot.Scale(time=False, range=(-SPAN, 0.0)), "y": uplot.Scale(range=(0.0, 1.05))},
            axes=axes,
            legend=uplot.Legend(show=False),
            height=_TALL,
        )
        server.gui.add_html(words.note("speed of the tool (blue) and its cap (red) [m/s]"))
        self._speed = server.gui.add_uplot(
            data=(np.zeros(2), np.zeros(2), np.zeros(2)),
            series=(
                uplot.Series(label="s"),
                uplot.Series(label="cap", stroke="#c62828", width=2),
                uplot.Series(label="tool", stroke="#1565c0", width=2),
            ),
            scales={"x": uplot.Scale(time=False, range=(-SPAN, 0.0)), "y": uplot.Scale(range=(0.0, 1.05))},
            axes=axes,
            legend=uplot.Legend(show=False),
            height=_TALL,
        )

    def show(self, curves: Curves) -> None:
        if len(curves.t) < 2:
            return
        t = curves.t - curves.t[-1]
        which = np.linspace(0, len(t) - 1, min(_POINTS, len(t))).astype(int)

        def thin(values: Array) -> Array:
            return np.asarray(values[which])

        self._belief.data = (thin(t), thin(curves.belief))
        self._speed.data = (thin(t), thin(curves.cap), thin(curves.speed))
