"""The firmware frame by frame: what it accepts, what it refuses by itself, and that control goes on."""

import itertools
import math
from types import SimpleNamespace

import can
import pytest
from bus_simulation.firmware import FirmwareDevice
from speaking import FIRST, OWNER, SECOND, THIRD, acks, commit, device, say, stage, step, take_lease, write

from retuner.adaptive.process.model import LinearProcess
from retuner.drivers.clock import MonotonicClock, SimulatedClock
from retuner.drivers.controller.device_process import RunReport, run_devices
from retuner.drivers.controller.gain_memory import Slot
from retuner.drivers.controller.virtual_device import VirtualDevice, VirtualDeviceSettings
from retuner.drivers.device import CommandDone, Reverted, WriteRefusedError
from retuner.drivers.host.lease_and_commands import Probation
from retuner.drivers.plants.linear_plant import LinearPlant
from retuner.drivers.protocol.frames import (
    STORE_KEY,
    Abort,
    Ack,
    Commit,
    Confirm,
    Frame,
    GainBox,
    Heartbeat,
    Mode,
    Read,
    Reason,
    Setpoint,
    Store,
    TelemetryPv,
    TelemetrySp,
)
from retuner.drivers.telemetry.telemetry_quality import (
    MAX_WRONG,
    TRANSITIONS,
    WINDOW,
    Arrival,
    ArrivalCheck,
    Stream,
    TelemetryVerdict,
)


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


# What a device answers where two things are wrong at once, and in which sample what ends: as protocol.md says. The
# virtual device and the firmware in C are told the same


TRIAL = 4
OTHER = 77


class Both:
    """The two of them, told the same: what one of them answers is what the other answers."""

    def __init__(self) -> None:
        box = GainBox(kp_max=20.0, ki_max=2.0, kd_max=5.0, ratio_max=10.0, direction=1)
        settings = VirtualDeviceSettings(
            FIRST, box=box, trial_samples=TRIAL, sp_min=0.0, sp_max=100.0, co_min=0.0, co_max=100.0
        )
        self.virtual, self.firmware = (
            make(settings, LinearPlant(LinearProcess(1.2, (30.0,), (), 4.0), start_pv=50.0, start_co=40.0))
            for make in (VirtualDevice, FirmwareDevice)
        )
        self.settings = settings

    @property
    def epoch(self) -> int:
        return self.virtual.epoch

    @property
    def sample(self) -> int:
        return self.virtual.sample

    def receive(self, message: can.Message) -> list[can.Message]:
        told = self.virtual.receive(message)
        assert [m.data for m in told] == [m.data for m in self.firmware.receive(message)]
        return told

    def step(self) -> list[can.Message]:
        told = self.virtual.step()
        assert [m.arbitration_id for m in told] == [m.arbitration_id for m in self.firmware.step()]
        return told


@pytest.fixture
def dev() -> Both:
    """With its lease taken, on the set of number 0."""
    both = Both()
    take_lease(both)
    return both


def reasons(dev: Both, *frames: Frame) -> list[Reason]:
    return acks(say(dev, *frames))


def runs(dev: Both) -> int:
    """Low bits of the running number in the next sample."""
    return next(f.running for f in step(dev) if isinstance(f, TelemetrySp))


def test_commands_are_checked_by_owner_then_counter_then_range(dev: Both) -> None:
    assert reasons(dev, Setpoint(10, 60.0, OWNER)) == [Reason.OK]
    assert reasons(dev, Setpoint(9, 1e6, OTHER)) == [Reason.NOT_OWNER]
    assert reasons(dev, Setpoint(9, 1e6, OWNER)) == [Reason.STALE]
    assert reasons(dev, Setpoint(11, 1e6, OWNER)) == [Reason.OUT_OF_RANGE]
    assert reasons(dev, Setpoint(11, 61.0, OWNER)) == [Reason.OK]  # the counter was not used up
    assert reasons(dev, Setpoint(11, 62.0, OWNER)) == [Reason.STALE]
    assert next(f.sp for f in step(dev) if isinstance(f, TelemetrySp)) == 61.0
    assert reasons(dev, Mode(1, 0, -50.0, OWNER), Mode(1, 1, -50.0, OWNER)) == [Reason.OUT_OF_RANGE, Reason.OK]
    assert next(f.flags for f in say(dev, Read(3, 1)) if isinstance(f, Heartbeat)) & 1


def test_an_abort_of_a_newer_number_ends_a_commit_that_waits_and_one_of_an_older_does_not(dev: Both) -> None:
    assert reasons(dev, *stage(5, SECOND), commit(5, SECOND)) == []
    assert reasons(dev, Abort(4)) == [Reason.STALE]
    assert runs(dev) == 5
    assert reasons(dev, *stage(6, THIRD), commit(6, THIRD, base=5)) == []
    assert reasons(dev, Abort(7)) == [Reason.OK]
    frames = step(dev)
    assert acks(frames) == []
    assert next(f.running for f in frames if isinstance(f, TelemetrySp)) == 5
    assert reasons(dev, commit(6, THIRD, base=5)) == [Reason.STALE]


def test_a_commit_that_is_not_staged_or_comes_beside_another_burns_nothing(dev: Both) -> None:
    assert reasons(dev, *stage(3, SECOND), commit(8, SECOND)) == [Reason.NOT_STAGED]
    assert reasons(dev, commit(3, SECOND), Commit(3, 0, 1)) == [Reason.BUSY]
    assert runs(dev) == 3
    assert reasons(dev, *stage(8, THIRD), commit(8, THIRD, base=3)) == []
    assert runs(dev) == 8


def test_confirm_and_store_of_another_number_are_stale_whatever_else_is_wrong(dev: Both) -> None:
    say(dev, *stage(3, SECOND), commit(3, SECOND))
    step(dev)
    for other in (0, 2, 4):
        assert reasons(dev, Confirm(other, OWNER)) == [Reason.STALE]
        assert reasons(dev, Store(other, OWNER % 256)) == [Reason.STALE]
    assert reasons(dev, Store(3, OWNER % 256)) == [Reason.NOT_CONFIRMED]
    assert reasons(dev, Confirm(0, OTHER), Store(0, OTHER)) == [Reason.NOT_OWNER] * 2


def test_a_trial_of_n_samples_ends_in_the_nth_sample_after_the_swap_before_its_output(dev: Both) -> None:
    say(dev, *stage(3, SECOND), commit(3, SECOND))
    shown = [runs(dev) for _ in range(TRIAL)]
    frames = step(dev)
    assert shown == [3] * TRIAL
    told = [f for f in frames if isinstance(f, Ack | TelemetrySp)]
    assert isinstance(told[0], Ack)
    assert (told[0].seq, told[0].reason) == (3, Reason.REVERTED)
    assert isinstance(told[1], TelemetrySp)
    assert told[1].running == 0


# Classification of a stream: every arrival, every state, every way between them


@pytest.mark.parametrize(
    ("steps", "arrival"),
    [
        (1, Arrival.OK),
        (0, Arrival.REPEATED),
        (2, Arrival.SOME_LOST),
        (90, Arrival.SOME_LOST),
        (-1, Arrival.WRONG_SEQUENCE),
    ],
)
def test_the_counter_classifies(steps: int, arrival: Arrival) -> None:
    check = ArrivalCheck()
    assert check.ahead(steps) is arrival
    assert check.counts[arrival] == 1


def test_two_good_frames_make_a_stream_valid_and_repeated_ones_do_not() -> None:
    check = ArrivalCheck()
    for _ in range(50):
        check.ahead(0)
    assert check.state is Stream.INIT
    check.ahead(1)
    assert check.state is Stream.INIT
    check.ahead(3)
    assert check.state is Stream.VALID


@pytest.mark.parametrize("wrong", [Arrival.WRONG_CRC, Arrival.WRONG_SEQUENCE])
def test_too_many_wrong_frames_make_it_invalid_until_they_are_past(wrong: Arrival) -> None:
    check = ArrivalCheck()
    for _ in range(WINDOW):
        check.ahead(1)
    for _ in range(MAX_WRONG):
        check.note(wrong)
    assert check.state is Stream.VALID
    check.note(wrong)
    assert check.state is Stream.INVALID
    for _ in range(WINDOW - MAX_WRONG - 1):
        check.ahead(1)
        assert check.state is Stream.INVALID
    check.ahead(1)
    assert check.state is Stream.VALID


def test_silence_forgets() -> None:
    check = ArrivalCheck()
    check.ahead(1)
    check.ahead(1)
    check.note(Arrival.TIMEOUT)
    assert check.state is Stream.NO_DATA
    check.ahead(1)
    assert check.state is Stream.INIT


def test_the_table_has_no_way_that_is_not_meant() -> None:
    stays = {
        (Stream.NO_DATA, TelemetryVerdict.SILENCE),
        (Stream.INIT, TelemetryVerdict.FEW),
        (Stream.VALID, TelemetryVerdict.FEW),
        (Stream.VALID, TelemetryVerdict.ENOUGH),
        (Stream.INVALID, TelemetryVerdict.FEW),
        (Stream.INVALID, TelemetryVerdict.WRONG),
    }
    assert set(itertools.product(Stream, TelemetryVerdict)) - set(TRANSITIONS) == stays
    assert all(new is not old for (old, _), new in TRANSITIONS.items())


# A committed set is on trial until it is confirmed: reverted in time, stored only afterwards, without a bump


def test_going_back_is_without_a_bump() -> None:
    dev = device(trial_samples=6)
    for _ in range(5):
        step(dev)
    write(dev, 1, SECOND, 0)
    before = dev.co
    for _ in range(12):
        step(dev)
        assert abs(dev.co - before) < 1e-6  # at rest co stays where it is through both swaps
    assert dev.running.gains == FIRST


def test_a_set_that_was_taken_back_is_not_said_to_run_when_its_commit_comes_again() -> None:
    dev = device(trial_samples=2)
    write(dev, 1, SECOND, 0)
    step(dev)
    step(dev)
    assert dev.running.gains == FIRST
    assert acks(say(dev, commit(1, SECOND))) == [Reason.STALE]


def test_a_host_confirms_what_it_has_seen_running(make_bench) -> None:
    bench = make_bench(trial_samples=15)
    bench.run(5)
    bench.host.begin_write(bench.SECOND, bench.now_s)
    bench.run(5)
    assert bench.device.pages.on_trial
    with pytest.raises(WriteRefusedError, match="on probation"):
        bench.host.store(bench.now_s)
    bench.run(10)
    assert not bench.device.pages.on_trial
    bench.run(30)
    assert bench.device.running.gains == bench.SECOND
    bench.host.store(bench.now_s)
    assert CommandDone("store") in bench.run(3)


def test_a_host_that_comes_back_too_late_is_told(make_bench) -> None:
    bench = make_bench(trial_samples=15)
    bench.run(5)
    bench.host.begin_write(bench.SECOND, bench.now_s)
    bench.run(4)
    for _ in range(20):
        bench.on_bus.sample()
        bench.clock.advance(2.0)
    bench.near.receive_all()
    events = bench.run(10)
    assert Reverted(bench.host.running) in events
    assert bench.host.running.gains == bench.FIRST


def test_a_lost_confirmation_is_repeated(make_bench) -> None:
    bench = make_bench(trial_samples=40)
    bench.run(5)
    bench.host.begin_write(bench.SECOND, bench.now_s)
    bench.run(4)
    receive, bench.far.receive_all = bench.far.receive_all, list
    bench.run(8)
    bench.far.receive_all = receive
    bench.run(8)
    assert not bench.device.pages.on_trial


def test_a_probation_counts_only_samples_of_its_set() -> None:
    probation = Probation(3)
    assert probation.sample(1) is None
    probation.begin(7)
    assert [probation.sample(r) for r in (6, 7, 6, 7, 7, 7, 7)] == [None, None, None, None, None, 7, None]
    probation.again()
    assert [probation.sample(7) for _ in range(5)] == [None, None, None, 7, None]
    probation.end()
    assert probation.sample(7) is None
