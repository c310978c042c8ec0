"""`python -m cell.record.recorder_child`: the recorder that `RecorderProcess` starts.

It reads its settings as one line of JSON from standard input, prints "ready" once it hears the wire, and
takes coded decisions from standard input until that closes. It then finishes the file and prints what
became of everything, as JSON. Warnings go to standard error.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import msgspec

from cell.child import WARNING
from cell.config import from_dict
from cell.errors import CellError, DecodeError
from cell.record.decision import CodedDecision
from cell.record.recorder import Recorder
from cell.record.recorder_process import LENGTH_BYTES, Settings

_NICE = 10
"""Added to the priority in real time."""
_MOST = 64 * 1024 * 1024
"""Largest coded decision [bytes]."""


def main() -> int:
    """Record until standard input ends; returns the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the supervisor's to handle
    logging.basicConfig(format=f"{WARNING}%(message)s", level=logging.WARNING, stream=sys.stderr)
    try:
        settings = msgspec.json.decode(sys.stdin.buffer.readline(), type=Settings)
        if not settings.patient:
            _give_way()
        recorder = Recorder(
            from_dict(settings.config),
            settings.path,
            settings.max_waiting,
            settings.about,
            settings.lossless,
            settings.patient,
        )
        try:
            print("ready", flush=True)
            _take(sys.stdin.buffer, recorder)
        finally:
            counts = recorder.close()
        with suppress(OSError):  # who started it may be gone
            print(msgspec.json.encode(counts).decode(), flush=True)
    except (CellError, msgspec.MsgspecError) as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    return 0


def _give_way() -> None:
    """Let what moves the arm come first, also where the system shares by sessions and not by processes.

    Not altogether: whoever sends waits a few milliseconds for a receiver that does not listen.
    """
    with suppress(OSError):
        os.nice(_NICE)
    with suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(_NICE))


def _take(stream: BinaryIO, recorder: Recorder) -> None:
    """Pass decisions on until the stream ends, whole or within one."""
    decoder = msgspec.msgpack.Decoder(CodedDecision)
    while len(head := stream.read(LENGTH_BYTES)) == LENGTH_BYTES:
        size = int.from_bytes(head, "big")
        if size > _MOST:
            raise DecodeError(f"a decision of {size} bytes, at most {_MOST} are allowed")
        data = stream.read(size)
        if len(data) < size:
            return
        recorder.decided(decoder.decode(data))


if __name__ == "__main__":
    sys.exit(main())
