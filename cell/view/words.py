"""What happens, in words and HTML. Every text of the wire is escaped: it may come from anywhere."""

from __future__ import annotations

from html import escape

import numpy as np

from cell.view.moment import Moment
from cell.wire.types import Event, SupervisorState
from cell.wire.vocabulary import Action, Mode, Prediction

_MODES = {
    Mode.STOPPED: ("STOPPED", "#c62828"),
    Mode.HOLD: ("HOLD", "#b26a00"),
    Mode.COLLABORATIVE: ("COLLABORATIVE", "#2e7d32"),
    Mode.INDUSTRIAL: ("INDUSTRIAL", "#1565c0"),
    Mode.RECOVERING: ("RECOVERING", "#6a1b9a"),
}
_GREY = "#616161"
_ACTIONS = {
    Action.NO_OP: "nothing",
    Action.DETECT: "looks for an onion",
    Action.DETECT_PICK: "looks for an onion and picks it",
    Action.PICK: "picks an onion",
    Action.INSPECT: "inspects the onion",
    Action.PLACE_ON_CONVEYOR: "puts a sound onion back",
    Action.PLACE_IN_BIN: "puts a blemished onion into the bin",
    Action.SPEED_UP: "speeds up",
    Action.SLOW_DOWN: "slows down",
}
_HUMAN = {
    Action.NO_OP: "is away or rests",
    Action.DETECT: "looks for an onion",
    Action.PICK: "picks an onion",
    Action.INSPECT: "inspects an onion",
    Action.PLACE_ON_CONVEYOR: "puts an onion back",
    Action.PLACE_IN_BIN: "bins an onion",
    Action.SPEED_UP: "shows thumbs up",
    Action.SLOW_DOWN: "shows thumbs down",
}
_COLOURS = {30: "#b26a00", 40: "#c62828", 50: "#c62828"}


def mode_of(moment: Moment) -> tuple[str, str, str]:
    """(mode, colour, why) for the headline."""
    arm, state = moment.arm, moment.state
    if not moment.fresh:
        return "NO CELL", _GREY, "nothing comes from the node"
    if arm is not None and arm.stopped:
        name, colour = _MODES[Mode.STOPPED]
        return name, colour, arm.stop_reason
    if state is None:
        return "WAITING", _GREY, "no supervisor speaks"
    name, colour = _MODES[Mode(state.mode)] if state.mode in set(Mode) else ("?", _GREY)
    return name, colour, _why(state)


def status(moment: Moment, speed: float, elapsed: float, whole: bool) -> str:
    """The block at the top of the page.

    Args:
        speed: of the tool [m/s]. elapsed: time of the round [s], of its `whole` or since
            the view began.
    """
    name, colour, why = mode_of(moment)
    head = (
        f'<div style="background:{colour};color:#fff;border-radius:6px;padding:5px 10px;margin-bottom:5px">'
        f'<b style="font-size:1.15em" id="cell-mode">{name}</b><br>'
        f'<span style="font-size:0.85em">{escape(why) or "&nbsp;"}</span></div>'
    )
    state = moment.state
    if state is None:
        return _block(head)
    onion = Prediction(state.prediction) if state.prediction in set(Prediction) else Prediction.UNKNOWN
    seen = "" if onion is Prediction.UNKNOWN else f", onion {onion.name.lower()}"
    robot = "the round is over" if state.phase == "done" else _of(_ACTIONS, state.action) + seen
    rows = [
        ("robot", escape(robot)),
        ("tool", f"<b>{speed:.2f}</b> of at most {state.speed_cap:.2f} m/s ({escape(state.binding_cap)})"),
        ("person", _person(state)),
        (
            "sorted",
            f"<b>{state.sorted}</b> by the robot ({state.in_bin} bin, {state.on_conveyor} belt), "
            f"<b>{state.by_human}</b> by the person",
        ),
        ("time", f"<b>{elapsed:.0f} s</b>{'' if whole else ' in view'}, {state.remaining} onions in sight"),
    ]
    lines = "".join(
        f'<tr><td style="color:#777;padding-right:8px;vertical-align:top">{a}</td><td>{b}</td></tr>'
        for a, b in rows
    )
    return _block(f'{head}<table style="border-spacing:0;line-height:1.35">{lines}</table>')


def events(said: tuple[Event, ...]) -> str:
    """The last events, newest first."""
    rows = "".join(
        f'<div style="color:{_COLOURS.get(e.level, "inherit")}">{e.t:.1f} s&ensp;{escape(e.text)}</div>'
        for e in reversed(said)
    )
    return _block(rows or "nothing yet")


def note(text: str, colour: str = "#777") -> str:
    """One small line."""
    return _block(f'<span style="color:{colour}">{escape(text) or "&nbsp;"}</span>')


def legend(title: str, curves: dict[str, str]) -> str:
    """One small line: what is plotted, each curve's name after a dot of its colour."""
    names = ", ".join(
        f'<span style="color:{colour}">&#9679;</span> {escape(name)}' for name, colour in curves.items()
    )
    return _block(f'<span style="color:#777">{escape(title)}: {names}</span>')


def _block(html: str) -> str:
    return f'<div style="padding:0 0.75em;font-size:0.8em">{html}</div>'


def _why(state: SupervisorState) -> str:
    if state.mode == Mode.HOLD:
        return f"waits on its path: {state.binding_cap}"
    if state.mode == Mode.INDUSTRIAL:
        return "fast: the person is away and the separation allows it"
    if state.requested_industrial and not state.permitted_industrial:
        return "would be fast, but the separation does not permit it"
    return "slow beside the person" if np.isfinite(state.separation) else "slow"


def _person(state: SupervisorState) -> str:
    if not np.isfinite(state.separation):
        return "nobody in sight"
    text = f"<b>{state.separation:.2f} m</b> away, {escape(_of(_HUMAN, state.human_action))}"
    sign = f", <b>thumb {escape(state.gesture)}</b>" if state.gesture else ""
    return f"{text}{sign}<br>tired: {100 * state.belief:.0f} % sure"


def _of(names: dict[Action, str], value: int) -> str:
    return names.get(Action(value), "?") if value in set(Action) else "?"
