"""What an operator has asked for, tick by tick. Pure: the orders come with the inputs and are recorded."""

from __future__ import annotations

import math

from cell.wire.types import OperatorCommand


class Operator:
    """The standing wishes.

    Attributes:
        hold: the arm is to wait on its path.
        cap: the tool is to be no faster than this [m/s]; infinity without a wish.
        resume: a latched stop is to be lifted.
        news: what changed, in words; whoever tells it clears it.
    """

    def __init__(self) -> None:
        self.hold = False
        self.cap = math.inf
        self.resume = False
        self.news: list[str] = []

    def update(self, orders: tuple[OperatorCommand, ...], stopped: bool) -> None:
        """Take in this tick's orders; one to resume counts only while the arm is stopped."""
        for order in orders:
            if order.order in ("hold", "go"):
                self.hold = order.order == "hold"
                self._tell(order, "hold" if self.hold else "go on")
            elif order.order == "cap":
                self.cap = order.value
                self._tell(order, f"no faster than {order.value:g} m/s")
            elif order.order == "resume" and stopped:
                self.resume = True
                self._tell(order, "resume after the stop")
        self.resume = self.resume and stopped

    def _tell(self, order: OperatorCommand, text: str) -> None:
        self.news.append(f"'{order.holder}' orders: {text}")
