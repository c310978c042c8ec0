"""What the pendant shows."""

from __future__ import annotations

from collections.abc import Callable


class Pendant:
    """Pop-up and operational mode.

    Attributes:
        popup: text shown; empty if none is.
        operational_mode: NONE, MANUAL or AUTOMATIC; as set from outside, it changes nothing.
        listeners: told the text of every pop-up.
    """

    def __init__(self) -> None:
        self.popup = ""
        self.operational_mode = "NONE"
        self.listeners: list[Callable[[str], None]] = []

    def show(self, text: str) -> None:
        """Show a pop-up."""
        self.popup = text
        for listener in self.listeners:
            listener(text)

    def close(self) -> None:
        """Take it away."""
        self.popup = ""
