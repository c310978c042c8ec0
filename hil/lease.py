"""Who may command the arm: the supervisor whose heart beats."""

from __future__ import annotations

from cell.errors import RefusedError
from cell.limits import RefusalCode


class Lease:
    """The first holder to beat gets the lease and keeps it while it beats.

    Args:
        deadline: silence after which the lease is lost [s].
    """

    def __init__(self, deadline: float) -> None:
        self._deadline = deadline
        self._last = 0.0
        self.holder = ""

    def beat(self, holder: str, now: float) -> None:
        """A heartbeat of `holder` at `now` [s]; others' are ignored while the lease is held."""
        if not self.holder:
            self.holder = holder
        if holder == self.holder:
            self._last = now

    def lost(self, now: float) -> str:
        """The holder that fell silent, once; empty while all is well."""
        if not self.holder or now - self._last <= self._deadline + 1e-9:
            return ""
        silent, self.holder = self.holder, ""
        return silent

    def excuse(self, seconds: float, now: float) -> None:
        """The node itself could not listen for `seconds` until `now` [s]: that was no silence."""
        self._last = min(now, self._last + seconds)

    def require(self, holder: str) -> None:
        """Raise `RefusedError` unless `holder` has the lease."""
        if holder != self.holder:
            owner = f"'{self.holder}' holds it" if self.holder else "nobody holds it; send heartbeats first"
            raise RefusedError(RefusalCode.LEASE.value, f"'{holder}' does not hold the lease; {owner}")
