"""Faults on purpose: what may go wrong between a controller and its clients, at chosen times or at random.

All chance comes from one seed: the same faults and the same messages give the same disturbances.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.emulator.fault_syntax import Fault, parse_fault
from hil.emulator.interfaces_faults import Delivery, LinkFaults, Panel, Server

_ON_MESSAGES = ("delay", "drop", "duplicate", "freeze")
_ON_LINKS = (*_ON_MESSAGES, "cut")
_BUTTONS = ("protective_stop", "violation", "emergency_stop", "safeguard_stop")


def make_faults(texts: Sequence[str], seed: int = 0) -> PlannedFaults:
    """Faults from the command line; raises `ConfigError`."""
    return PlannedFaults([parse_fault(text) for text in texts], seed)


class PlannedFaults:
    """`interfaces_faults.Faults` of one controller.

    Args:
        faults: what shall go wrong. seed: of all chance.
    """

    def __init__(self, faults: Sequence[Fault], seed: int = 0) -> None:
        self._faults = tuple(faults)
        self._seed = seed
        self._links = 0
        self._now = 0.0
        self._rng = np.random.default_rng([seed, 0])
        self._buttons = [_Button(fault) for fault in faults if fault.kind in _BUTTONS]

    def version(self) -> tuple[int, int, int, int] | None:
        found = [fault["is"] for fault in self._faults if fault.kind == "version"]
        return found[-1] if found else None

    def remote_control(self) -> bool | None:
        return False if any(fault.kind == "local_control" for fault in self._faults) else None

    def in_use(self, name: str) -> bool:
        return any(fault.kind == "in_use" and fault["name"] == name for fault in self._faults)

    def before_cycle(self, panel: Panel, now: float) -> float:
        self._now = now
        for button in self._buttons:
            button.press(panel, now)
        late = 0.0
        for fault in self._faults:
            if fault.kind == "slow" and _within(fault, now) and self._rng.random() < fault["share"]:
                late += fault["by"]
        return late

    def refuse(self, server: Server, peer: str) -> bool:
        del peer
        return any(
            fault.kind == "refuse" and _concerns(fault, server) and _within(fault, self._now)
            for fault in self._faults
        )

    def link(self, server: Server, peer: str) -> LinkFaults | None:
        del peer
        found = [fault for fault in self._faults if fault.kind in _ON_LINKS and _concerns(fault, server)]
        if not found:
            return None
        self._links += 1
        return _Link(found, np.random.default_rng([self._seed, self._links]))


class _Button:
    """Something that is pressed once, and perhaps let go."""

    def __init__(self, fault: Fault) -> None:
        self._fault = fault
        self._state = "waits"

    def press(self, panel: Panel, now: float) -> None:
        fault, kind = self._fault, self._fault.kind
        if self._state == "waits" and now >= fault["at"]:
            self._state = "pressed"
            if kind == "protective_stop":
                panel.protective_stop("a fault on purpose")
            elif kind == "violation":
                panel.violation("a fault on purpose")
            else:
                self._hold(panel, True)
        elif self._state == "pressed" and "for" in fault.values and now >= fault["at"] + fault["for"]:
            self._state = "released"
            self._hold(panel, False)

    def _hold(self, panel: Panel, on: bool) -> None:
        if self._fault.kind == "emergency_stop":
            panel.emergency_stop(on)
        else:
            panel.safeguard_stop(on)


class _Link:
    """`interfaces_faults.LinkFaults` of one connection."""

    def __init__(self, faults: Sequence[Fault], rng: np.random.Generator) -> None:
        self._messages = [fault for fault in faults if fault.kind in _ON_MESSAGES]
        self._cuts = [fault for fault in faults if fault.kind == "cut"]
        self._rng = rng
        self._next_cut: float | None = None

    def incoming(self, message: bytes, now: float) -> Sequence[Delivery]:
        return self._pass(message, now, "in")

    def outgoing(self, message: bytes, now: float) -> Sequence[Delivery]:
        return self._pass(message, now, "out")

    def cut(self, now: float) -> bool:
        if self._next_cut is None:  # the first cycle of this connection: earlier cuts are past
            self._next_cut = min((_first_after(fault, now) for fault in self._cuts), default=math.inf)
        return now >= self._next_cut

    def _pass(self, message: bytes, now: float, way: str) -> list[Delivery]:
        out = [Delivery(message)]
        for fault in self._messages:
            if _within(fault, now) and fault.values.get("way", "both") in (way, "both"):
                out = [after for each in out for after in self._disturb(fault, each)]
        return out

    def _disturb(self, fault: Fault, it: Delivery) -> list[Delivery]:
        if fault.kind == "freeze":
            return []
        if self._rng.random() >= fault["share"]:
            return [it]
        if fault.kind == "drop":
            return []
        if fault.kind == "duplicate":
            return [it, it]
        return [Delivery(it.data, it.delay + fault["by"] + fault["jitter"] * float(self._rng.random()))]


def _within(fault: Fault, now: float) -> bool:
    return bool(fault["at"] <= now < fault["at"] + fault["for"])


def _concerns(fault: Fault, server: Server) -> bool:
    return fault["port"] is None or fault["port"] is server


def _first_after(fault: Fault, now: float) -> float:
    """When a cut comes next after `now` [s]."""
    at, every = fault["at"], fault["every"]
    if at > now:
        return float(at)
    if every <= 0.0:
        return math.inf
    return float(at + every * (math.floor((now - at) / every) + 1))
