"""Where two sets of outputs of one tick differ first, in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from itertools import zip_longest
from typing import Any

import numpy as np

from cell.decision.io import Outputs

_LONG = 200
_ABSENT = "nothing"


@dataclass(frozen=True)
class Difference:
    """The first difference.

    Attributes:
        tick: counted from 0. t [s]. what: dotted name of the field. then, now: both sides of it.
        said: what the supervisor said at that tick, then and now.
    """

    tick: int
    t: float
    what: str
    then: str
    now: str
    said: tuple[str, str] = ("", "")

    def lines(self) -> list[str]:
        """For people."""
        out = [
            f"first difference at tick {self.tick} (t = {self.t:.3f} s): {self.what}",
            f"  recorded: {self.then}",
            f"  today:    {self.now}",
        ]
        if self.said[0] != self.said[1]:
            out += [f"  it said then:  {self.said[0]}", f"  it says today: {self.said[1]}"]
        return out


def first_difference(
    tick: int, t: float, then: Outputs, now: Outputs, within: float = 0.0
) -> Difference | None:
    """The first field in which outputs differ; commands come before the state.

    Args:
        within: numbers that differ by no more than this count as equal.

    Returns:
        None where nothing differs by more.
    """
    for name, a, b in _walk("", then, now, within):
        said = [" / ".join(event.text for event in side.events) or _ABSENT for side in (then, now)]
        return Difference(tick, t, name, _text(a), _text(b), (said[0], said[1]))
    return None


def _walk(name: str, a: Any, b: Any, within: float) -> Iterator[tuple[str, Any, Any]]:
    """(name, value, value) of every leaf that differs, in order."""
    if type(a) is not type(b):
        yield name, a, b
    elif is_dataclass(a):
        for field in fields(a):
            below = f"{name}.{field.name}" if name else field.name
            yield from _walk(below, getattr(a, field.name), getattr(b, field.name), within)
    elif isinstance(a, tuple):
        for i, (x, y) in enumerate(zip_longest(a, b, fillvalue=_ABSENT)):
            yield from _walk(f"{name}[{i}]", x, y, within)
    elif isinstance(a, np.ndarray):
        if a.shape != b.shape:
            yield f"{name}.shape", a.shape, b.shape
        else:
            for at in map(tuple, np.argwhere(~np.isclose(a, b, rtol=0.0, atol=within))):
                yield f"{name}{[int(i) for i in at]}", a[at], b[at]
    elif isinstance(a, float):
        if not (a == b or abs(a - b) <= within):
            yield name, a, b
    elif a != b:
        yield name, a, b


def _text(value: Any) -> str:
    text = repr(value.item() if isinstance(value, np.generic) else value)
    return text if len(text) <= _LONG else text[:_LONG] + " ..."
