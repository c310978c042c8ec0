"""The only place in the project that reads or waits for time.

Two clocks share one small interface: `WallClock` for real-time runs and hardware,
`StepClock` for lock-step runs, where time is a tick count times a fixed period and
moves only when somebody moves it. `perf_s` measures durations for reports; nothing
that decides may use it.
"""

from __future__ import annotations

import os
import time
from typing import Protocol

from cell.errors import ConfigError

RATE_VARIABLE = "CELL_CLOCK_RATE"
"""Environment variable: seconds of every `WallClock` in a second of the machine, 0.05 to 1; 1 if unset.

An emulated cell that a machine cannot run in real time runs on it in slow motion. Processes that belong
together need the same value. Never for a real arm, which keeps its own time.
"""


class Clock(Protocol):
    """What every component is given instead of the `time` module."""

    def now(self) -> float:
        """Present time [s]; wall clocks count from the Unix epoch, step clocks from 0."""
        ...

    def sleep_until(self, t: float) -> None:
        """Return when `now() >= t` [s]; a step clock never waits."""
        ...


class WallClock:
    """Unix time that never runs backwards (anchored once, advanced monotonically).

    In slow motion (see `RATE_VARIABLE`) it counts from the machine's start on, so that the clocks of
    all processes agree.

    Args:
        offset: of another process's wall clock on this machine; the two then agree.

    Attributes:
        offset: Unix time less the machine's monotonic time [s]. rate: seconds in a second of the machine.

    Raises:
        ConfigError: the environment's rate is none.
    """

    def __init__(self, offset: float | None = None) -> None:
        self.offset = time.time() - time.monotonic() if offset is None else offset
        self.rate = clock_rate()

    def now(self) -> float:
        return time.monotonic() * self.rate + self.offset

    def sleep_until(self, t: float) -> None:
        remaining = t - self.now()
        if remaining > 0.0:
            time.sleep(remaining / self.rate)


class StepClock:
    """Simulated time: `tick * period`, exact and identical on every run.

    Args:
        period: control period [s].
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self.tick = 0

    def now(self) -> float:
        return self.tick * self.period

    def advance(self, ticks: int = 1) -> None:
        """Move time forward by `ticks` periods."""
        self.tick += ticks

    def reset(self) -> None:
        """Back to time zero."""
        self.tick = 0

    def sleep_until(self, t: float) -> None:
        del t  # simulated time does not pass by waiting


def clock_rate() -> float:
    """Seconds of a wall clock in a second of the machine; raises `ConfigError` for a wrong variable."""
    text = os.environ.get(RATE_VARIABLE, "1")
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0.05 <= rate <= 1.0:
        raise ConfigError(f"{RATE_VARIABLE} must be a number from 0.05 to 1, got {text!r}")
    return rate


def perf_s() -> float:
    """Monotonic seconds for measuring durations; no decision may depend on it."""
    return time.perf_counter()


def to_stamp(t: float) -> tuple[int, int]:
    """Seconds -> ROS (sec, nanosec), rounded to the nearest nanosecond."""
    ns = round(t * 1e9)
    return ns // 1_000_000_000, ns % 1_000_000_000


def from_stamp(sec: int, nanosec: int) -> float:
    """ROS (sec, nanosec) -> seconds, the nearest float: a time sent twice stays what it was."""
    return (sec * 1_000_000_000 + nanosec) / 1_000_000_000
