"""The fields of the Real-Time Data Exchange: names, types, directions, and since which version.

`fields.tsv` has one line per field: name, type, `in` or `out`. Inputs may be asked for in an output
recipe, too, where they are registers.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib.resources import files

NOT_FOUND = "NOT_FOUND"
IN_USE = "IN_USE"
"""These stand in place of a type in the controller's answer."""


class FieldType(StrEnum):
    """Types as they are written in answers."""

    BOOL = "BOOL"
    UINT8 = "UINT8"
    UINT32 = "UINT32"
    INT32 = "INT32"
    UINT64 = "UINT64"
    DOUBLE = "DOUBLE"
    VECTOR3D = "VECTOR3D"
    VECTOR6D = "VECTOR6D"
    VECTOR6INT32 = "VECTOR6INT32"
    VECTOR6UINT32 = "VECTOR6UINT32"


FORMATS: dict[FieldType, tuple[str, int]] = {
    FieldType.BOOL: ("?", 1),
    FieldType.UINT8: ("B", 1),
    FieldType.UINT32: ("I", 1),
    FieldType.INT32: ("i", 1),
    FieldType.UINT64: ("Q", 1),
    FieldType.DOUBLE: ("d", 1),
    FieldType.VECTOR3D: ("d", 3),
    FieldType.VECTOR6D: ("d", 6),
    FieldType.VECTOR6INT32: ("i", 6),
    FieldType.VECTOR6UINT32: ("I", 6),
}
"""Format character of `struct`, and how many of them."""


@dataclass(frozen=True)
class Field:
    """One field.

    Attributes:
        input: a client may write it.
        since: first version (major, minor) that has it, as far as it matters here.
    """

    name: str
    type: FieldType
    input: bool
    since: tuple[int, int] = (0, 0)


_SINCE = {
    "actual_current_as_torque": (5, 23),
    "ft_raw_wrench": (5, 9),
    "payload": (5, 6),
    "payload_cog": (5, 6),
    "payload_inertia": (5, 11),
}
"""What clients ask for only from this version on; an older controller does not know it."""


@cache
def fields() -> dict[str, Field]:
    """All fields by name."""
    table = {}
    for line in (files("hil.rtde") / "fields.tsv").read_text("utf-8").splitlines():
        name, kind, direction = line.split("\t")
        table[name] = Field(name, FieldType(kind), direction == "in", _SINCE.get(name, (0, 0)))
    return table
