"""Faults as users write them: `kind[:key=value,...]`, e.g. `cut:port=30004,at=8`.

`KINDS` says what each kind takes; `docs/emulator.md` says what each does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cell.errors import ConfigError, one_of
from hil.emulator.interfaces_faults import Server

PORTS = {
    29999: Server.DASHBOARD,
    30001: Server.PRIMARY,
    30002: Server.SECONDARY,
    30003: Server.REALTIME,
    30004: Server.RTDE,
    63352: Server.GRIPPER,
}
"""A fault names a server by its usual port or by its name."""
WAYS = ("out", "in", "both")


@dataclass(frozen=True)
class Fault:
    """One fault as asked for.

    Attributes:
        kind: one of `KINDS`. values: all its keys, with defaults filled in.
    """

    kind: str
    values: Mapping[str, Any]

    def __getitem__(self, key: str) -> Any:
        return self.values[key]


def _seconds(text: str) -> float:
    value = float(text)
    if not value >= 0.0:
        raise ValueError("must be 0 or more seconds")
    return value


def _share(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 1.0:
        raise ValueError("must be from 0 to 1")
    return value


def _port(text: str) -> Server:
    try:
        return PORTS[int(text)] if text.isdigit() else Server(text)
    except (KeyError, ValueError):
        legal = [*PORTS, *(str(server) for server in Server)]
        raise ValueError(one_of(text, legal)) from None


def _way(text: str) -> str:
    if text not in WAYS:
        raise ValueError(one_of(text, WAYS))
    return text


def _version(text: str) -> tuple[int, ...]:
    parts = text.split(".")
    if not 2 <= len(parts) <= 4 or not all(part.isdigit() and len(part) <= 9 for part in parts):
        raise ValueError("must look like 5.22 or 3.15.8.106339")
    return tuple([*map(int, parts), 0, 0][:4])


def _name(text: str) -> str:
    if not text:
        raise ValueError("must be the name of an RTDE input, e.g. speed_slider_mask")
    return text


REQUIRED = object()
"""The default of a key that must be given."""
_Key = tuple[Callable[[str], Any], Any]
_WINDOW: dict[str, _Key] = {"at": (_seconds, 0.0), "for": (_seconds, math.inf)}
_MOMENT: dict[str, _Key] = {"at": (_seconds, 0.0)}
_SERVER: dict[str, _Key] = {"port": (_port, None)}
_MESSAGES: dict[str, _Key] = {**_SERVER, **_WINDOW, "way": (_way, "out"), "share": (_share, 1.0)}

KINDS: dict[str, dict[str, _Key]] = {
    "delay": {**_MESSAGES, "by": (_seconds, 0.05), "jitter": (_seconds, 0.0)},
    "drop": {**_MESSAGES, "share": (_share, 0.05)},
    "duplicate": {**_MESSAGES, "share": (_share, 0.05)},
    "freeze": {**_SERVER, **_WINDOW},
    "cut": {**_SERVER, **_MOMENT, "every": (_seconds, 0.0)},
    "refuse": {**_SERVER, **_WINDOW},
    "slow": {**_WINDOW, "by": (_seconds, 0.004), "share": (_share, 1.0)},
    "protective_stop": _MOMENT,
    "violation": _MOMENT,
    "emergency_stop": _WINDOW,
    "safeguard_stop": _WINDOW,
    "version": {"is": (_version, REQUIRED)},
    "in_use": {"name": (_name, REQUIRED)},
    "local_control": {},
}
"""Key -> (reader, default) of every kind. Times are seconds, `at` counts from the controller's start."""


def parse_fault(text: str) -> Fault:
    """Read one fault; raises `ConfigError` that says what would be right."""
    kind, _, rest = text.partition(":")
    if kind not in KINDS:
        raise ConfigError(f"--fault: {one_of(kind, KINDS)}")
    keys = KINDS[kind]
    values = {key: default for key, (_, default) in keys.items()}
    for part in rest.split(",") if rest else []:
        key, equals, value = part.partition("=")
        if key not in keys:
            legal = ", ".join(keys) or "none"
            raise ConfigError(f"--fault {kind}: got key {key!r}; legal keys: {legal}")
        if not equals:
            raise ConfigError(f"--fault {kind}: {key} needs a value, as in {key}=...")
        try:
            values[key] = keys[key][0](value)
        except ValueError as error:
            raise ConfigError(f"--fault {kind}: {key}={value}: {error}") from None
    for key, value in values.items():
        if value is REQUIRED:
            raise ConfigError(f"--fault {kind} needs {key}=..., as in {kind}:{key}={_EXAMPLES[key]}")
    return Fault(kind, values)


_EXAMPLES = {"is": "3.15.8", "name": "speed_slider_mask"}
