"""Scheduling for the threads whose lateness a moving arm would notice, as far as the system grants it."""

from __future__ import annotations

import os
from contextlib import suppress


def ask_for_real_time(priority: int, thread: int = 0) -> None:
    """For one thread only, where the system grants it; what it starts is scheduled as usual.

    Args:
        priority: 1..99; nothing that waits for others in a busy loop may have one.
        thread: native id; 0: the calling one.
    """
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def prefer_process() -> None:
    """This process with all its threads: before everything that is not real-time.

    A thread that has the interpreter's lock but no processor would hold up the real-time ones.
    """
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))


def be_ordinary() -> None:
    """This process as any other, whatever started it."""
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def threads() -> list[int]:
    """Native ids of this process's threads, those of libraries too; empty where that cannot be known."""
    with suppress(OSError):
        return [int(name) for name in os.listdir("/proc/self/task")]
    return []
