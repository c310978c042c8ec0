"""Where an operator's orders arrive: for the supervisor of this round, and for the round that follows.

Threads of the wire put orders in; the decision loop takes them out between two ticks.
"""

from __future__ import annotations

import math
import threading
from collections import deque

from cell.config import CellConfig
from cell.decision.policy import load
from cell.errors import RefusedError, one_of
from cell.wire.session import Session
from cell.wire.types import NextRound, OperatorCommand, Reply
from cell.wire.vocabulary import LEAST_CAP, ORDERS

MOST_ONIONS = 15
_WAITING = 16
"""Most orders that may wait for the next tick."""


class Desk:
    """Takes orders from the wire.

    Args:
        again: another round may be ordered.

    Attributes:
        next: the round that is to follow, None where none is; whoever begins it clears it.
    """

    def __init__(self, config: CellConfig, *, again: bool = False) -> None:
        self._top, self._again = config.motion.industrial_speed, again
        self._lock = threading.Lock()
        self._orders: deque[OperatorCommand] = deque()
        self.next: NextRound | None = None

    def open(self, session: Session) -> None:
        """Serve on this session, until it is closed."""
        with self._lock:
            self._orders.clear()
        session.serve(session.keys.operator, OperatorCommand, self._on_order)
        session.serve(session.keys.next_round, NextRound, self._on_next)

    def take(self) -> tuple[OperatorCommand, ...]:
        """The orders since the last call."""
        with self._lock:
            orders = tuple(self._orders)
            self._orders.clear()
        return orders

    def _on_order(self, order: OperatorCommand) -> Reply:
        if order.order not in ORDERS:
            raise RefusedError("range", f"order: {one_of(order.order[:40], ORDERS)}")
        if order.order == "cap" and not (
            math.isfinite(order.value) and LEAST_CAP - 1e-9 <= order.value <= self._top
        ):
            raise RefusedError(
                "range", f"the cap must be from {LEAST_CAP:g} to {self._top:g} m/s, got {order.value:g}"
            )
        with self._lock:
            if len(self._orders) >= _WAITING:
                raise RefusedError("busy", f"{_WAITING} orders wait for the supervisor already")
            self._orders.append(order)
        return Reply(True)

    def _on_next(self, order: NextRound) -> Reply:
        if not self._again:
            raise RefusedError("unsupported", "this run ends with its round; start one with --view")
        if not 1 <= order.onions <= MOST_ONIONS or not 0 <= order.seed < 2**63:
            raise RefusedError("range", f"onions must be 1..{MOST_ONIONS}, and the seed at least 0")
        load(order.policy)  # an unknown or garbled one is refused with its own words
        self.next = order
        return Reply(True)
