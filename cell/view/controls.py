"""What an operator can ask for. Stopping takes one click; whatever may start motion takes two."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from cell.clock import Clock, WallClock
from cell.config import CellConfig
from cell.view import words
from cell.view.live import HOLDER, LiveSource
from cell.view.moment import Moment
from cell.wire.types import NextRound, OperatorCommand, Reply, Stop
from cell.wire.vocabulary import Mode

if TYPE_CHECKING:
    from viser import ViserServer

ARMED = 5.0
"""The second click must come within this time [s] ..."""
APART = 0.5
"""... and not sooner than this: a double click is no deliberation [s]."""
_BAD, _GOOD = "#c62828", "#2e7d32"


class TwoClicks:
    """Tells the second deliberate click from the first; clicks of different browsers do not add up."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._armed: tuple[int, float] | None = None

    def click(self, who: int) -> bool:
        """A click of browser `who`; True when it is the second one."""
        now = self._clock.now()
        if self._armed is None or self._armed[0] != who or now - self._armed[1] > ARMED:
            self._armed = (who, now)
            return False
        if now - self._armed[1] < APART:
            return False
        self._armed = None
        return True

    @property
    def armed(self) -> bool:
        """A second click would do it now."""
        if self._armed is not None and self._clock.now() - self._armed[1] > ARMED:
            self._armed = None
        return self._armed is not None

    def disarm(self) -> None:
        self._armed = None


class _Guarded:
    """A button that needs two clicks."""

    def __init__(self, button: Any, label: str, does: Callable[[], None]) -> None:
        self.button, self._label, self._does = button, label, does
        self._clicks = TwoClicks(WallClock())
        button.on_click(self._clicked)

    def _clicked(self, event: Any) -> None:
        if self._clicks.click(event.client_id):
            self._does()
        self.refresh(True)

    def refresh(self, possible: bool) -> None:
        """Show whether it can be clicked, and how often still."""
        if not possible:
            self._clicks.disarm()
        label = f"{self._label}: click again" if self._clicks.armed else self._label
        if self.button.label != label:
            self.button.label = label
            self.button.color = "orange" if self._clicks.armed else "green"
        if self.button.disabled == possible:
            self.button.disabled = not possible


class Controls:
    """The operator's part of the page."""

    def __init__(self, server: ViserServer, config: CellConfig, source: LiveSource) -> None:
        gui, keys = server.gui, source.session.keys
        self._source, self._config, self._keys = source, config, keys
        self._lock = threading.Lock()
        self._next: _Guarded
        self._stop = gui.add_button("STOP", color="red", hint="brakes the arm on its path; one click")
        self._stop.on_click(lambda _: self._say("stop", source.send(keys.stop, self._stop_order())))
        resume = gui.add_button("Resume after stop", color="green", hint="two clicks; plans afresh")
        self._resume = _Guarded(resume, "Resume after stop", lambda: self._order("resume"))
        self._hold = gui.add_button("Hold", color="orange", hint="the arm waits on its path")
        self._hold.on_click(lambda _: self._order("hold"))
        go = gui.add_button("Go on", color="green", hint="ends the hold; two clicks")
        self._go = _Guarded(go, "Go on", lambda: self._order("go"))
        top = config.motion.industrial_speed
        self._cap = gui.add_slider("speed at most", 0.05, top, 0.05, top, hint="m/s; only ever slows down")
        self._cap.on_update(lambda event: self._order("cap", float(self._cap.value), event))
        self._note = gui.add_html(words.note(""))

    def add_next_round(self, server: ViserServer, policies: list[str]) -> None:
        """The part of the page that orders another batch."""
        gui, most = server.gui, 15
        with gui.add_folder("Next batch", expand_by_default=False):
            policy = gui.add_dropdown("policy", policies, initial_value=policies[0])
            onions = gui.add_number("onions", most, min=1, max=most, step=1)
            seed = gui.add_number("seed", 1, min=0, max=2**31 - 1, step=1)
            button = gui.add_button("Order it", color="green", hint="two clicks; it follows this batch")

            def order() -> None:
                wanted = NextRound(HOLDER, str(policy.value), int(onions.value), int(seed.value))
                self._say("next batch", self._source.send(self._keys.next_round, wanted))

            self._next = _Guarded(button, "Order it", order)
        self.show(Moment())  # nothing can be asked for yet but to stop

    def show(self, moment: Moment) -> None:
        """What can be asked for at this moment."""
        stopped = moment.arm is not None and moment.arm.stopped
        held = moment.state is not None and moment.state.mode == Mode.HOLD
        held = held and moment.state is not None and moment.state.binding_cap == "operator"
        live = moment.fresh
        self._resume.refresh(live and stopped)
        self._resume.button.visible = stopped
        self._hold.visible = not held and not stopped
        self._go.refresh(live and held and not stopped)
        self._go.button.visible = held and not stopped
        self._next.refresh(live)

    def _order(self, order: str, value: float = 0.0, event: Any = None) -> None:
        if event is not None and event.client_id is None:
            return  # moved by this program, not by a person
        reply = self._source.send(self._keys.operator, OperatorCommand(HOLDER, order, value))
        self._say(order, reply)

    def _say(self, what: str, reply: Reply) -> None:
        text = f"{what}: done" if reply.accepted else f"{what}: refused: {reply.reason}"
        with self._lock:
            self._note.content = words.note(text, _GOOD if reply.accepted else _BAD)

    @staticmethod
    def _stop_order() -> Stop:
        return Stop(HOLDER, "stopped by the operator in the view")
