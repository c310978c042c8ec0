"""Script text on the ports 30001-30003: where one ends, and what is not a program."""

from __future__ import annotations

import re

from cell.errors import DecodeError
from hil.emulator.controller import Controller
from hil.emulator.programs import MAX_TEXT

_HEADS = (b"def ", b"sec ")
_OPENS = re.compile(rb"(?:def|sec|thread|if|while|for|switch)\b.*:\s*(?:#.*)?\Z")
_CLOSES = re.compile(rb"end\s*(?:#.*)?\Z")
_QUIET = 0.05
"""A program's last line is "end", and nothing follows for this long [s]."""
_PATIENCE = 1.0
"""After this long [s] a program that does not end so is handed over all the same."""


def split_script(buffer: bytearray, quiet: float) -> list[bytes]:
    """Take whole programs and whole single lines off the front.

    Args:
        quiet: time since the last byte came [s].

    Raises:
        DecodeError: too long for a script.
    """
    if len(buffer) > MAX_TEXT:
        raise DecodeError(f"a script may have {MAX_TEXT} bytes")
    messages = []
    while buffer:
        start = _first_line(buffer, 0)
        if buffer.startswith(_HEADS, start):
            if end := _next_program(buffer, start):
                messages.append(bytes(buffer[:end]))
                del buffer[:end]
                continue
            ends = buffer.rstrip().endswith(b"end")
            if quiet < (_QUIET if ends else _PATIENCE):
                break
            messages.append(bytes(buffer))
            buffer.clear()
            break
        end = buffer.find(b"\n", start)
        if end < 0:
            if quiet >= _PATIENCE:
                messages.append(bytes(buffer[start:]))
                buffer.clear()
            break
        messages.append(bytes(buffer[start:end]))
        del buffer[: end + 1]
    return [message for message in messages if message.strip()]


def _next_program(buffer: bytearray, start: int) -> int:
    """Where a program that follows the one at `start` begins, not indented; 0: none surely does."""
    if all(buffer.find(b"\n" + head, start) < 0 for head in _HEADS):
        return 0
    depth, at = 0, start
    while (end := buffer.find(b"\n", at)) >= 0:
        line, at = bytes(buffer[at:end]).strip(), end + 1
        if _OPENS.match(line):
            depth += 1
        elif _CLOSES.match(line):
            depth -= 1
            if depth <= 0:
                after = _first_line(buffer, at)
                return after if buffer[after - 1 : after] == b"\n" and buffer.startswith(_HEADS, after) else 0
    return 0


def _first_line(buffer: bytearray, at: int) -> int:
    """Where the first line from `at` on starts that is neither empty nor a comment."""
    while at < len(buffer):
        end = buffer.find(b"\n", at)
        line = buffer[at:] if end < 0 else buffer[at:end]
        if end < 0 or (line.strip() and not line.lstrip().startswith(b"#")):
            return at + len(line) - len(line.lstrip())
        at = end + 1
    return at


def take_script(text: str, peer: str, controller: Controller) -> None:
    """Run it: a command of the controller, or a program."""
    words = text.split()
    if words == ["stop", "program"]:
        controller.runtime.stop()
    elif words == ["set", "robotmode", "run"]:
        controller.brake_release()
    elif words == ["power", "on"]:
        controller.power_on()
    elif words == ["power", "off"]:
        controller.power_off()
    elif words == ["set", "unlock", "protective", "stop"]:
        refusal = controller.unlock_protective_stop()
        if refusal:
            controller.message(refusal, 2)
    else:
        controller.upload(text, peer)
