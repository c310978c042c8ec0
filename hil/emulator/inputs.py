"""What clients write by RTDE: registers, outputs with their masks, and the speed slider."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

import numpy as np

from hil.emulator.controller import MIN_SLIDER, Controller
from hil.rtde.codec import Value
from hil.rtde.fields import fields

Setter = Callable[[Value], None]
_MA = 0.001


class Inputs:
    """Takes input values into the controller.

    Values that belong together (a mask and what it masks) act when all of a packet are in.
    """

    def __init__(self, controller: Controller) -> None:
        self._c = controller
        self._latched: dict[str, Value] = {}
        self._actions: dict[str, Callable[[], None]] = {
            "speed_slider_fraction": self._slider,
            "standard_digital_output": lambda: self._digital("standard", 0),
            "configurable_digital_output": lambda: self._digital("configurable", 8),
            "tool_digital_output": lambda: self._digital("tool", 16),
            "standard_analog_output_mask": self._analog,
            "external_force_torque": self._wrench,
        }

    def taker(self, names: Sequence[str]) -> Callable[[Sequence[Value]], None]:
        """A function that takes the values of these fields; of a short packet, the first ones."""
        setters = [self._setter(name) for name in names]
        actions = [action for name, action in self._actions.items() if name in names]

        def take(values: Sequence[Value]) -> None:
            for setter, value in zip(setters, values, strict=False):
                setter(value)
            for action in actions:
                action()

        return take

    def _setter(self, name: str) -> Setter:
        registers = self._c.registers
        if name.startswith("input_bit_registers"):
            first = 0 if name.endswith("0_to_31") else 32
            return lambda value: _set_word(registers.in_bit, first, int(value))  # type: ignore[arg-type]
        stem, _, index = name.rpartition("_")
        bank: dict[str, list[float] | list[bool]] = {
            "input_double_register": registers.in_double,
            "input_bit_register": registers.in_bit,
        }
        if stem == "input_int_register":
            return _counted(registers.in_int, registers.in_int_writes, int(index))
        if stem in bank:
            return _element(bank[stem], int(index))
        assert fields()[name].input, name
        return lambda value: self._latched.__setitem__(name, value)

    def _number(self, name: str) -> float:
        value = self._latched.get(name, 0)
        return float(value) if not isinstance(value, tuple) else 0.0

    def _slider(self) -> None:
        fraction = self._number("speed_slider_fraction")
        if self._number("speed_slider_mask") and isfinite(fraction):
            self._c.io.speed_slider = min(1.0, max(MIN_SLIDER, fraction))

    def _digital(self, which: str, shift: int) -> None:
        mask = int(self._number(f"{which}_digital_output_mask")) << shift
        value = int(self._number(f"{which}_digital_output")) << shift
        self._c.io.digital_out = self._c.io.digital_out & ~mask | value & mask

    def _analog(self) -> None:
        """Ratios 0..1 become 0-10 V or 4-20 mA."""
        mask = int(self._number("standard_analog_output_mask"))
        kinds = int(self._number("standard_analog_output_type"))
        io = self._c.io
        for i in range(2):
            ratio = self._number(f"standard_analog_output_{i}")
            if not (mask >> i & 1 and isfinite(ratio)):
                continue
            ratio = min(1.0, max(0.0, ratio))
            voltage = kinds >> i & 1
            io.analog_out_type = io.analog_out_type & ~(1 << i) | voltage << i
            io.analog_out[i] = 10.0 * ratio if voltage else (4.0 + 16.0 * ratio) * _MA

    def _wrench(self) -> None:
        wrench = self._latched.get("external_force_torque")
        if isinstance(wrench, tuple):
            self._c.external_wrench = np.array(wrench, float)


def _element(bank: Any, i: int) -> Setter:
    return lambda value: bank.__setitem__(i, value)


def _counted(bank: Any, writes: list[int], i: int) -> Setter:
    def set_it(value: Value) -> None:
        bank[i] = value
        writes[i] += 1

    return set_it


def _set_word(bits: list[bool], first: int, word: int) -> None:
    for i in range(32):
        bits[first + i] = bool(word >> i & 1)
