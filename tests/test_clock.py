"""Wall clocks: in slow motion they agree with one another, and a wrong rate is refused."""

from __future__ import annotations

import pytest

from cell.clock import RATE_VARIABLE, WallClock, perf_s
from cell.errors import ConfigError


def test_slow_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RATE_VARIABLE, "0.25")
    clock, later = WallClock(), WallClock()
    assert abs(clock.now() - later.now()) < 0.05
    began, t = perf_s(), clock.now()
    clock.sleep_until(t + 0.02)
    assert perf_s() - began >= 0.08 and clock.now() >= t + 0.02
    assert WallClock(clock.offset).now() == pytest.approx(clock.now(), abs=0.05)


@pytest.mark.parametrize("text", ["0", "2", "-1", "nan", "fast"])
def test_a_rate_that_is_none(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RATE_VARIABLE, text)
    with pytest.raises(ConfigError, match=r"from 0\.05 to 1"):
        WallClock()
