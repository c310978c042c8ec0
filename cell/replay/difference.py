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
    """The first difference. tick: counted from 0; t [s]; what: dotted name; then, now: both sides."""

    tick: int
    t: float
    what: str
    then: str
    now: str

    def lines(self) -> list[str]:
        """For people."""
        return [
            f"first difference at tick {self.tick} (t = {self.t:.3f} s): {self.what}",
            f"  recorded: {self.then}",
            f"  today:    {self.now}",
        ]


def first_difference(tick: int, t: float, then: Outputs, now: Outputs) -> Difference:
    """The first field in which two different outputs differ; commands come before the state."""
    for name, a, b in _walk("", then, now):
        return Difference(tick, t, name, _text(a), _text(b))
    return Difference(tick, t, "bytes", "outputs that read the same", "other bytes for them")


def _walk(name: str, a: Any, b: Any) -> Iterator[tuple[str, Any, Any]]:
    """(name, value, value) of every leaf that differs, in order."""
    if type(a) is not type(b):
        yield name, a, b
    elif is_dataclass(a):
        for field in fields(a):
            below = f"{name}.{field.name}" if name else field.name
            yield from _walk(below, getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple):
        for i, (x, y) in enumerate(zip_longest(a, b, fillvalue=_ABSENT)):
            yield from _walk(f"{name}[{i}]", x, y)
    elif isinstance(a, np.ndarray):
        if a.shape != b.shape:
            yield f"{name}.shape", a.shape, b.shape
        elif a.tobytes() != b.tobytes():
            at = tuple(int(i) for i in np.argwhere(~np.equal(a, b))[0]) if (a != b).any() else (0,) * a.ndim
            yield f"{name}{list(at)}", a[at], b[at]
    elif a != b and not (a != a and b != b):
        yield name, a, b


def _text(value: Any) -> str:
    text = repr(value.item() if isinstance(value, np.generic) else value)
    return text if len(text) <= _LONG else text[:_LONG] + " ..."
