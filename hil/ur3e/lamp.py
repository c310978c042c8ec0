"""The mode light on a real controller: a red-green-blue lamp on three standard digital outputs.

| signal | DO0 red | DO1 green | DO2 blue |
|---|---|---|---|
| off | 0 | 0 | 0 |
| stopped | 1 | 0 | 0 |
| collaborative | 0 | 1 | 0 |
| industrial | 0 | 0 | 1 |
| requested | 1 | 1 | 0 |
| hold | 1 | 1 | 1 |

Magenta and cyan mean nothing.
"""

from __future__ import annotations

from cell.errors import BackendError, one_of

RED, GREEN, BLUE = 0b001, 0b010, 0b100
"""Bits of the standard digital outputs."""
MASK = RED | GREEN | BLUE
"""The outputs that the lamp hangs on."""
BITS = {
    "off": 0,
    "stopped": RED,
    "collaborative": GREEN,
    "industrial": BLUE,
    "requested": RED | GREEN,
    "hold": RED | GREEN | BLUE,
}
"""Outputs of each of `vocabulary.SIGNALS`."""
_SIGNALS = {bits: signal for signal, bits in BITS.items()}


def lamp_bits(signal: str) -> int:
    """Outputs, within `MASK`, that show a signal; raises `BackendError` listing the signals."""
    if signal not in BITS:
        raise BackendError(f"light: {one_of(signal, BITS)}")
    return BITS[signal]


def lamp_signal(digital_out: int) -> str:
    """What the lamp shows with these digital outputs; a colour without a meaning counts as off."""
    return _SIGNALS.get(digital_out & MASK, "off")
