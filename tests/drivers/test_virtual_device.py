"""The firmware frame by frame: what it accepts, what it refuses by itself, and that control goes on."""

import math
import struct
from types import SimpleNamespace

import can
import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from speaking import CODEC, FIRST, OWNER, SECOND, THIRD, acks, commit, device, say, stage, step, take_lease

from retuner.drivers.clock import MonotonicClock, SimulatedClock
from retuner.drivers.controller.device_process import RunReport, run_devices
from retuner.drivers.controller.gain_memory import Slot
from retuner.drivers.controller.virtual_device import VirtualDeviceSettings
from retuner.drivers.protocol.checksum import frame_crc, page_crc, set_crc
from retuner.drivers.protocol.frames import (
    STORE_KEY,
    Abort,
    Commit,
    Confirm,
    Frame,
    GainBox,
    Heartbeat,
    Item,
    Mode,
    Page,
    PageEnd,
    PageItem,
    Read,
    Reason,
    Setpoint,
    Stage,
    Store,
    TelemetryPv,
    TelemetrySp,
)
from retuner.schedule.gains import PidGains


def test_a_commit_runs_from_the_next_sample_on_and_its_ack_is_repeated() -> None:
    dev = device()
    assert say(dev, *stage(1, SECOND), commit(1, SECOND)) == []
    assert dev.running.gains == FIRST
    frames = step(dev)
    assert acks(frames) == [Reason.OK]
    assert dev.running.gains == SECOND
    assert next(f for f in frames if isinstance(f, TelemetrySp)).running == 1
    for _ in range(3):
        assert acks(say(dev, commit(1, SECOND))) == [Reason.OK]


def test_pages_are_read_as_they_stand() -> None:
    dev = device()
    say(dev, *stage(1, SECOND)[:2])
    partial = say(dev, Read(Page.STAGED, 3))
    assert partial[-1] == PageEnd(Page.STAGED, 0, 3, 1, 0)
    assert [f.item for f in partial if isinstance(f, PageItem)] == [Item.KP, Item.KI]
    say(dev, *stage(1, SECOND))
    for page, token, seq, gains in [
        (Page.STAGED, 4, 1, SECOND),
        (Page.RUNNING, 5, 0, FIRST),
        (Page.STORED, 262, 0, FIRST),
    ]:
        crc = page_crc(set_crc(1, 1, seq, gains), token)
        assert say(dev, Read(page, token))[-1] == PageEnd(page, 1, token % 16, seq, crc)


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        ([commit(1, SECOND)], Reason.NOT_STAGED),
        ([*stage(1, SECOND)[:2], commit(1, SECOND)], Reason.INCOMPLETE),
        ([*stage(1, SECOND), commit(1, SECOND, base=4)], Reason.WRONG_BASE),
        ([*stage(1, SECOND), commit(1, THIRD)], Reason.WRONG_CRC),
        ([*stage(1, SECOND), commit(1, SECOND, epoch=2)], Reason.WRONG_CRC),
        ([*stage(1, SECOND), commit(1, SECOND, node=2)], Reason.WRONG_CRC),
        ([*stage(1, PidGains(1.0, 3.0, 0.5)), commit(1, PidGains(1.0, 3.0, 0.5))], Reason.OUTSIDE_BOX),
        ([*stage(1, PidGains(-1.0, -0.0625, -0.5)), commit(1, PidGains(-1.0, -0.0625, -0.5))], Reason.OUTSIDE_BOX),
        ([*stage(1, PidGains(11.0, 0.0625, 0.5)), commit(1, PidGains(11.0, 0.0625, 0.5))], Reason.RATIO),
        ([*(Stage(item, OWNER, 0.0, 1) for item in Item), Commit(1, 0, 0)], Reason.OUTSIDE_BOX),
    ],
)
def test_bad_commits_are_refused_with_their_reason_and_burn_the_number(frames: list[Frame], reason: Reason) -> None:
    dev = device()
    assert acks(say(dev, *frames)) == [reason]
    assert acks(say(dev, frames[-1])) in ([reason], [Reason.STALE])
    step(dev)
    assert dev.running.gains == FIRST
    if reason is not Reason.NOT_STAGED:
        assert acks(say(dev, stage(1, SECOND)[0])) == [Reason.STALE]
    assert say(dev, *stage(2, SECOND), commit(2, SECOND)) == []
    assert acks(step(dev)) == [Reason.OK]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30])
def test_numbers_that_are_none_are_not_staged(value: float) -> None:
    dev = device()
    message = CODEC.encode(Stage(Item.KP, OWNER, 1.0, 1))
    message.data[1:5] = struct.pack("<f", value)
    message.data[-1] = frame_crc(message.arbitration_id, message.data[:-1])
    assert dev.receive(message) == []
    assert dev.refused == 1
    assert not dev.pages.has_staged


def test_an_abort_fences_a_number_off() -> None:
    dev = device()
    assert acks(say(dev, *stage(1, SECOND), commit(1, SECOND), Abort(1))) == [Reason.OK]
    step(dev)
    assert dev.running.gains == FIRST
    assert acks(say(dev, commit(1, SECOND), stage(1, SECOND)[0])) == [Reason.STALE, Reason.STALE]
    assert acks(say(dev, Abort(1))) == [Reason.STALE]
    assert acks(say(dev, Abort(9), stage(9, SECOND)[0])) == [Reason.OK, Reason.STALE]
    say(dev, *stage(10, SECOND), commit(10, SECOND))
    step(dev)
    assert acks(say(dev, Abort(10))) == [Reason.ALREADY_RUNNING]
    assert dev.running.seq == 10


def test_nothing_is_staged_over_a_commit_that_waits() -> None:
    dev = device()
    say(dev, *stage(1, SECOND), commit(1, SECOND))
    assert acks(say(dev, stage(2, THIRD)[0], commit(2, THIRD), commit(1, SECOND))) == [Reason.BUSY, Reason.BUSY]
    step(dev)
    assert dev.running.gains == SECOND


def test_an_old_set_replayed_as_a_whole_is_refused() -> None:
    dev = device()
    old = [*stage(1, SECOND), commit(1, SECOND)]
    say(dev, *old)
    step(dev)
    say(dev, *stage(2, THIRD), commit(2, THIRD, base=1))
    step(dev)
    assert Reason.OK not in acks(say(dev, *old))
    step(dev)
    assert dev.running.gains == THIRD
    dev.restart()
    take_lease(dev)
    assert acks(say(dev, *old)) == [Reason.WRONG_CRC]  # another epoch


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


def test_a_device_without_a_store_starts_on_its_first_set() -> None:
    dev = device()
    say(dev, *stage(1, SECOND), commit(1, SECOND))
    step(dev)
    dev.restart()
    assert dev.running == (0, FIRST)
    assert dev.epoch == 2
    heartbeat = next(f for f in step(dev) if isinstance(f, Heartbeat))
    assert (heartbeat.sample, heartbeat.epoch) == (1, 2)


@given(ids=st.lists(st.tuples(st.integers(32, 63), st.binary(max_size=8)), max_size=30))
@settings(max_examples=examples(300))
def test_any_frames_whatsoever_leave_the_loop_controlled_by_the_same_gains(ids: list[tuple[int, bytes]]) -> None:
    dev, calm = device(), device()
    for id_, data in ids:
        for reply in dev.receive(can.Message(arbitration_id=id_, is_extended_id=False, data=data)):
            assert isinstance(CODEC.decode(reply), Frame)
    if dev.auto == calm.auto and (dev.sp, dev.load) == (calm.sp, calm.load):
        assert [m.data for m in dev.step() if m.arbitration_id & 31 == 18] == [
            m.data for m in calm.step() if m.arbitration_id & 31 == 18
        ]
    assert dev.running.gains == FIRST


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
