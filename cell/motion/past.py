"""The arm as a camera saw it: its state at an exposure, looked up among states noted before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar, Protocol, TypeVar

from cell.frames import Array


class Noted(Protocol):
    """A frozen dataclass with a time `t` [s] and joints `q`, shape (6,) [rad]."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def t(self) -> float: ...

    @property
    def q(self) -> Array: ...


S = TypeVar("S", bound=Noted)


def state_at(past: Sequence[S], t: float) -> S:
    """The state at `t` [s]: joints between two noted ones, the rest as in the nearer; ends are not passed.

    Args:
        past: at least one state, oldest first. A fast arm leaves its own outline within 20 ms.
    """
    after = next((s for s in past if s.t >= t), past[-1])
    before = next((s for s in reversed(past) if s.t <= t), past[0])
    if after.t <= before.t:
        return before
    share = (t - before.t) / (after.t - before.t)
    return replace(before if share < 0.5 else after, t=t, q=before.q + share * (after.q - before.q))
