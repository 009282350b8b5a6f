"""Clocks."""

import math

import pytest

from retuner.drivers.clock import MonotonicClock, SimulatedClock


def test_simulated_time_passes_when_told() -> None:
    clock = SimulatedClock(5.0)
    clock.advance(2.0)
    clock.wait_until(6.0)
    assert (clock.now_s(), clock.stamp_s(), clock.left_s(100.0)) == (7.0, 7.0, 0.0)
    clock.wait_until(9.0)
    assert clock.now_s() == 9.0
    for bad in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="positive, finite"):
            clock.advance(bad)
    assert clock.now_s() == 9.0


def test_monotonic_time_runs_at_its_speed_whatever_the_wall_clock_does(monkeypatch: pytest.MonkeyPatch) -> None:
    now, slept = [100.0], []
    monkeypatch.setattr("retuner.drivers.clock.time.monotonic", lambda: now[0])
    monkeypatch.setattr("retuner.drivers.clock.time.sleep", slept.append)
    monkeypatch.setattr("retuner.drivers.clock.time.time", lambda: -3600.0)
    clock = MonotonicClock(speed=10.0)
    now[0] += 0.5
    assert clock.now_s() == 5.0
    assert clock.left_s(6.0) == pytest.approx(0.1)
    clock.wait_until(4.0)
    clock.wait_until(6.0)
    assert slept == [pytest.approx(0.1)]
    monkeypatch.setattr("retuner.drivers.clock.time.time", lambda: -7200.0)  # somebody sets the wall clock back
    assert clock.stamp_s() == -3599.5
    for bad in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="speed"):
            MonotonicClock(bad)
