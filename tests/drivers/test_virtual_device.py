"""The firmware frame by frame: what it accepts, what it refuses by itself, and that control goes on."""

import math
from types import SimpleNamespace

import pytest
from speaking import FIRST, OWNER, SECOND, THIRD, acks, commit, device, say, stage, step

from retuner.drivers.clock import MonotonicClock, SimulatedClock
from retuner.drivers.controller.device_process import RunReport, run_devices
from retuner.drivers.controller.gain_memory import Slot
from retuner.drivers.controller.virtual_device import VirtualDeviceSettings
from retuner.drivers.protocol.frames import STORE_KEY, Confirm, GainBox, Mode, Reason, Setpoint, Store, TelemetryPv


def test_sequence_numbers_wrap() -> None:
    dev = device()
    dev.pages.running = dev.pages.running._replace(seq=65535)
    dev.pages.latest = 65535
    say(dev, *stage(0, SECOND), commit(0, SECOND, base=65535))
    assert acks(step(dev)) == [Reason.OK]
    assert dev.running == (0, SECOND)


def test_storing_needs_the_key_and_the_running_number_and_keeps_two_slots() -> None:
    dev = device()
    say(dev, *stage(1, SECOND), commit(1, SECOND))
    step(dev)
    assert acks(say(dev, Store(1, OWNER, 5), Store(0, OWNER, STORE_KEY))) == [Reason.WRONG_KEY, Reason.STALE]
    assert acks(say(dev, Store(1, OWNER), Confirm(1, OWNER))) == [Reason.NOT_CONFIRMED, Reason.OK]
    assert acks(say(dev, Store(1, OWNER), Store(1, OWNER))) == [Reason.OK, Reason.OK]
    say(dev, *stage(2, THIRD), commit(2, THIRD, base=1))
    step(dev)
    say(dev, Confirm(2, OWNER), Store(2, OWNER))
    assert {slot.content.seq for slot in dev.pages.slots if slot} == {1, 2}
    torn = next(slot for slot in dev.pages.slots if slot and slot.content.seq == 2)
    dev.pages.slots[dev.pages.slots.index(torn)] = Slot(torn.generation, torn.content, torn.crc ^ 1)
    dev.restart()
    assert dev.running == (1, SECOND)


def test_manual_and_back_is_bumpless() -> None:
    dev = device()
    say(dev, Setpoint(1, 60.0, OWNER), Mode(1, 0, 30.0, OWNER))
    for _ in range(20):
        step(dev)
    assert dev.co == 30.0
    say(dev, Mode(2, 1, 0.0, OWNER))
    step(dev)
    assert abs(dev.co - 30.0) < 1.0
    for _ in range(400):
        step(dev)
    assert dev.pv == pytest.approx(60.0, abs=0.01)


def test_the_pid_loop_is_that_of_the_telemetry() -> None:
    dev = device()
    pvs = []
    say(dev, Setpoint(1, 55.0, OWNER))
    for _ in range(100):
        pvs += [f.pv for f in step(dev) if isinstance(f, TelemetryPv)]
    assert pvs[0] == 50.0
    assert pvs[-1] == pytest.approx(55.0, abs=0.2)


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({"sample_time_s": 0.0}, "sample_time_s"),
        ({"co_min": 50.0, "co_max": 50.0}, r"co 50\.0"),
        ({"co_max": 1000.0}, "co 0"),
        ({"sp_min": 5.0, "sp_max": 1.0}, "sp_min"),
        ({"heartbeat_samples": 0}, "heartbeat_samples"),
    ],
)
def test_firmware_settings_are_checked(settings_: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        VirtualDeviceSettings(**{"gains": FIRST, **settings_})


@pytest.mark.parametrize(
    ("limits", "message"),
    [({"kp_max": 0.0}, "kp_max"), ({"ratio_max": 0.5}, "ratio_max"), ({"direction": 2}, "direction")],
)
def test_the_box_is_checked(limits: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GainBox(**limits)


def test_a_box_may_be_small_and_hold_gains_as_they_are() -> None:
    assert GainBox(kp_max=0.5, ki_max=1e-3, kd_max=0.1, ratio_max=1.0).ratio_max == 1.0


def test_a_machine_that_falls_behind_skips_samples_and_says_so(make_bench) -> None:
    class Slow(SimulatedClock):
        """Every sample costs five sample times."""

        def wait_until(self, t_s: float) -> None:
            super().wait_until(t_s)
            self.advance(10.0)

    bench = make_bench()
    clock = Slow()
    bench.far._clock = clock
    report = run_devices([bench.on_bus], clock, until_s=60.0)
    assert report.samples + report.overruns == pytest.approx(30, abs=6)
    assert report.overruns > 15


def test_devices_of_a_slow_machine_keep_step_as_a_plant_that_they_share_wants() -> None:
    clock = SimulatedClock()

    class Costs:
        """A device whose samples cost some time."""

        def __init__(self, cost_s: float) -> None:
            self.device, self.link = SimpleNamespace(sample_time_s=1.0), clock
            self.cost_s, self.samples, self.overruns = cost_s, 0, 0

        def answer(self) -> None: ...

        def sample(self) -> None:
            self.samples += 1
            clock.advance(self.cost_s)

    quick, slow = Costs(0.0), Costs(5.0)
    run_devices([quick, slow], clock, until_s=100.0)  # type: ignore[list-item]
    assert abs(quick.samples - slow.samples) <= 1
    assert slow.overruns > 3 * slow.samples


def test_simulated_time_needs_no_waiting(make_bench) -> None:
    bench = make_bench()
    assert run_devices([bench.on_bus], bench.clock, until_s=600.0) == RunReport(300, 0)
    stops = iter([False] * 10 + [True])
    report = run_devices([bench.on_bus], bench.clock, stop=lambda: next(stops))
    assert 4 <= report.samples <= 10


# ---- Clocks


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
