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
_TALL = 150
"""Of which the page's library uses two thirds; with it, all that matters fits into 700 pixels."""
_CURVES = {"belief: tired": "#7b1fa2", "cap [m/s]": "#c62828", "tool [m/s]": "#1565c0"}
"""Names and colours in the order of the data; the last one is drawn on top."""


class Plots:
    """One small plot: all three go from 0 to about 1."""

    def __init__(self, server: ViserServer) -> None:
        from viser import uplot

        server.gui.add_html(words.legend("the last minute", _CURVES))
        self._plot = server.gui.add_uplot(
            data=(np.zeros(2),) * (1 + len(_CURVES)),
            series=(
                uplot.Series(label="s"),
                *(uplot.Series(label=name, stroke=colour, width=2) for name, colour in _CURVES.items()),
            ),
            scales={"x": uplot.Scale(time=False, range=(-SPAN, 0.0)), "y": uplot.Scale(range=(0.0, 1.15))},
            axes=(
                uplot.Axis(show=True, size=22, label=""),
                uplot.Axis(show=True, size=34, splits=(0.0, 0.5, 1.0)),
            ),
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

        self._plot.data = (thin(t), thin(curves.belief), thin(curves.cap), thin(curves.speed))
