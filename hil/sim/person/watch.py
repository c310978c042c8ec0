"""How long a person holds a sign: until the robot shows that it understood, or patience ends."""

from __future__ import annotations

from hil.sim.person.persona import Persona

_ANSWERS = {"up": ("collaborative",), "down": ("requested", "industrial")}
"""What the mode light shows when a sign was understood."""


class SignWatch:
    """One sign that is held up since `shown` [s].

    Attributes:
        answered: when the person had seen the answer [s]; negative as long as there was none.
    """

    def __init__(self, who: Persona, sign: str, shown: float) -> None:
        self._who, self._answers, self._shown = who, _ANSWERS[sign], shown
        self._since: float | None = None
        self.answered = -1.0

    def over(self, now: float, signal: str) -> bool:
        """Whether to take the hand down, with the mode light showing `signal`."""
        if self.answered < 0.0:
            if signal not in self._answers:
                self._since = None
            elif self._since is None:
                self._since = now
            elif now - self._since >= self._who.reaction:
                self.answered = now
        if self.answered >= 0.0:
            return now - self._shown >= self._who.hold
        return now - self._shown >= self._who.patience
