"""A latched stop within a round: wait for an operator, lift it when told to, or give the round up."""

from __future__ import annotations

from cell.decision.io import Inputs
from cell.decision.operator import Operator
from cell.decision.primitives import Primitives

_BUSY = "busy"
"""Code of the reply of an arm that is still preparing itself: ask again."""


class StoppedRound:
    """What is done while the arm is stopped.

    Args:
        patience: how long an operator may take [s]; 0: the round ends at once.

    Attributes:
        news: what people should know; whoever tells it clears it.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._since: float | None = None
        self._ticket = 0
        self.news: list[str] = []

    def wait(self, inputs: Inputs, operator: Operator, body: Primitives) -> bool:
        """One tick of a stop; False when the round is to be given up."""
        if self._since is None:
            self._since, self._ticket = inputs.t, 0
            body.forget_set_point()
            if self._patience > 0.0:
                self.news.append(
                    f"stopped: {inputs.arm.stop_reason}; an operator may resume within {self._patience:g} s"
                )
        if inputs.t - self._since >= self._patience:
            return False
        for ticket, reply in inputs.replies:
            if ticket == self._ticket:
                self._ticket = 0
                if not reply.accepted and reply.code != _BUSY:
                    operator.resume = False
                    self.news.append(f"resume refused: {reply.code}: {reply.reason}")
        if operator.resume and not self._ticket and not inputs.arm.moving:
            self._ticket = body.resume()
        return True

    def over(self) -> bool:
        """The arm is stopped no more; True once after a stop."""
        was, self._since = self._since is not None, None
        return was
