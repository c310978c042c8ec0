"""Child processes of ours watch their standard input, and end when it closes."""

from __future__ import annotations

import subprocess
from contextlib import suppress

WARNING = "warning: "
"""Lines on a child's standard error that begin like this are for the user at once."""


def end_child(process: subprocess.Popen[str] | subprocess.Popen[bytes], patience: float) -> None:
    """Close its standard input and wait for its end, at most `patience` [s]; kill it if it does not come."""
    if process.stdin is not None:
        with suppress(OSError):  # it is gone already
            process.stdin.close()
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
