"""Which program a script text is."""

from __future__ import annotations

import re

from cell.errors import BackendError
from hil.emulator.interfaces import Program
from hil.emulator.urscript import external_control, program, rtde_control
from hil.emulator.urscript.urcap import EXTERNAL_CONTROL, PORT, UrCap

_EXTERNAL = re.compile(r"^def\s+(\w+)\s*\(\s*\)\s*:", re.MULTILINE)
_COMMANDS = re.compile(r"\A(?:\s*(?:stop program|set robotmode run)[ \t]*\r?\n)+")
MAX_TEXT = 4_000_000
_URCAP = re.compile(r"\A\s*external_control\(\s*\"([^\"]+)\"\s*(?:,\s*(\d{1,5})\s*)?\)\s*\Z")
"""What stands for a program with the External Control URCap's node, which has no text of its own."""


def recognise(text: str, peer: str) -> Program:
    """The program to run for a script that was sent, or loaded.

    Besides scripts, `external_control("host", port)` stands for a program with the External Control
    URCap, which fetches its script there when it is played.

    Args:
        peer: who sent it, for messages.

    Raises:
        BackendError: saying what in the text cannot be run.
    """
    del peer
    if len(text) > MAX_TEXT:
        raise BackendError(f"a script may have {MAX_TEXT} characters, got {len(text)}")
    text = _COMMANDS.sub("", text.lstrip("\ufeff"))
    if urcap := _URCAP.match(text):
        return UrCap(EXTERNAL_CONTROL, urcap[1], int(urcap[2] or PORT))
    if rtde_control.HEAD.search(text):
        return rtde_control.read(text)
    if '"reverse_socket"' in text:
        head = _EXTERNAL.search(text)
        return external_control.read(head[1] if head else "externalControl", text)
    return program.read(text)
