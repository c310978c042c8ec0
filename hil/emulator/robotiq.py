"""The 2F-85 behind its socket: variables, activation, and what the fingers make of it.

Numbers are those of Robotiq's manual; a real unit's end stops read about 3 (open) and 230 (closed)
counts, and so do these.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from hil.emulator.interfaces import GripperPlant

OPEN_COUNTS, CLOSED_COUNTS = 3, 230
"""What the position reads at the end stops."""
_SPEED = (0.020, 0.150)
_FORCE = (20.0, 235.0)
"""Finger speed [m/s] and grip force [N] at 0 and at 255."""
_SID = 9
_RELEASE_SPEED = _SPEED[0]
_ECHO_TIME = 0.5
"""An activation takes at least this long [s], even where nothing must move."""

WRITABLE = ("ACT", "GTO", "ATR", "ADR", "FOR", "SPE", "POS")
READABLE = (*WRITABLE, "STA", "PRE", "OBJ", "FLT", "SID")
ALIASES = {"ARD": "ADR"}
"""Some clients spell the direction of the automatic release like this."""
_FLAGS = ("ACT", "GTO", "ATR", "ADR")


class Sta(IntEnum):
    """What STA reads."""

    RESET = 0
    ACTIVATING = 1
    ACTIVE = 3


class Obj(IntEnum):
    """What OBJ reads."""

    MOVING = 0
    STOPPED_OPENING = 1
    STOPPED_CLOSING = 2
    AT_DESTINATION = 3


class Flt(IntEnum):
    """What FLT reads; those of Robotiq's list that can happen here."""

    NONE = 0
    WAIT_FOR_ACTIVATION = 5
    NOT_ACTIVATED = 7
    RELEASING = 11
    RELEASED = 15


def counts(width: float, stroke: float) -> int:
    """Position of fingers `width` [m] apart, of at most `stroke` [m]."""
    share = 1.0 - min(max(width / stroke, 0.0), 1.0)
    return round(OPEN_COUNTS + share * (CLOSED_COUNTS - OPEN_COUNTS))


def width_of(position: int, stroke: float) -> float:
    """Where a requested position brings the fingers [m]: not beyond the end stops."""
    share = (position - OPEN_COUNTS) / (CLOSED_COUNTS - OPEN_COUNTS)
    return stroke * (1.0 - min(max(share, 0.0), 1.0))


class Robotiq:
    """One gripper; all calls from one thread.

    Args:
        plant: the fingers.
    """

    def __init__(self, plant: GripperPlant) -> None:
        self._plant = plant
        self._set = dict.fromkeys(WRITABLE, 0)
        self._requested = 0
        self._sta, self._flt = Sta.RESET, Flt.NONE
        self._steps: list[float] = []
        self._since = self._now = 0.0
        self._closing = False

    def read(self, name: str) -> int:
        """A variable of `READABLE`."""
        width, moving, holding = self._plant.state()
        if name == "POS":
            return counts(width, self._plant.stroke)
        if name == "OBJ":
            return self._obj(moving, holding)
        return {"STA": int(self._sta), "PRE": self._requested, "FLT": int(self._flt), "SID": _SID}.get(
            name, self._set.get(name, 0)
        )

    def write(self, values: Mapping[str, int]) -> None:
        """Set variables of `WRITABLE`, 0..255, all at once."""
        before = dict(self._set)
        self._set.update({k: int(bool(v)) if k in _FLAGS else v for k, v in values.items()})
        if "POS" in values:
            self._requested = values["POS"]
        if not self._set["ACT"]:
            self._reset()
        elif not before["ACT"]:
            self._activate()
        elif self._set["ATR"] and not before["ATR"]:
            self._release()
        elif self._set["GTO"] and {"POS", "SPE", "FOR", "GTO"} & values.keys():
            self._go()
        elif before["GTO"] and not self._set["GTO"]:
            self._halt()

    def tick(self, now: float) -> None:
        """Go on with an activation or a release.

        Args:
            now: [s], never less than before.
        """
        self._now = now
        if self._sta is not Sta.ACTIVATING and self._flt is not Flt.RELEASING:
            return
        if self._plant.state()[1]:
            return
        if self._steps:
            self._move(self._steps.pop(0), _SPEED[1], _FORCE[0])
        elif self._flt is Flt.RELEASING:
            self._sta, self._flt = Sta.RESET, Flt.RELEASED
        elif now - self._since >= _ECHO_TIME:
            self._sta, self._flt = Sta.ACTIVE, Flt.NONE
            if self._set["GTO"]:
                self._go()

    # -- internals --------------------------------------------------------------------------------

    def _reset(self) -> None:
        if self._sta is not Sta.RESET or self._flt is Flt.RELEASING:
            self._halt()
        self._sta, self._flt, self._steps = Sta.RESET, Flt.NONE, []

    def _activate(self) -> None:
        """The fingers close and open once, so that the unit finds its end stops."""
        self._sta, self._flt, self._since = Sta.ACTIVATING, Flt.NONE, self._now
        self._steps = [0.0, self._plant.stroke]
        self._requested = 0

    def _release(self) -> None:
        self._flt, self._steps = Flt.RELEASING, []
        self._move(self._plant.stroke if self._set["ADR"] else 0.0, _RELEASE_SPEED, _FORCE[0])

    def _go(self) -> None:
        if self._flt in (Flt.RELEASING, Flt.RELEASED):
            return
        if self._sta is Sta.ACTIVATING:
            self._flt = Flt.WAIT_FOR_ACTIVATION
            return
        if self._sta is Sta.RESET:
            self._flt = Flt.NOT_ACTIVATED
            return
        speed, force = (_share(self._set[k], bounds) for k, bounds in (("SPE", _SPEED), ("FOR", _FORCE)))
        self._move(width_of(self._set["POS"], self._plant.stroke), speed, force)

    def _halt(self) -> None:
        width, moving, _ = self._plant.state()
        if moving:
            self._move(width, _SPEED[0], _FORCE[0])

    def _move(self, width: float, speed: float, force: float) -> None:
        self._closing = width < self._plant.state()[0]
        self._plant.command(width, speed, force)

    def _obj(self, moving: bool, holding: bool) -> Obj:
        if moving:
            return Obj.MOVING
        if holding:
            return Obj.STOPPED_CLOSING if self._closing else Obj.STOPPED_OPENING
        return Obj.AT_DESTINATION


def _share(value: int, bounds: tuple[float, float]) -> float:
    low, high = bounds
    return low + (high - low) * value / 255.0
