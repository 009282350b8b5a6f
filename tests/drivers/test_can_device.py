"""The host's client against the virtual device in lock-step: the good way, and every bad way with its verified end."""

import itertools
import math
import random
from dataclasses import replace
from types import SimpleNamespace

import pytest

from retuner import LoopMode, PidGains
from retuner.drivers.device import (
    CommandDone,
    CommandFailed,
    DeviceConflict,
    DeviceMismatchError,
    DeviceRestarted,
    DeviceSilentError,
    LinkChanged,
    LinkState,
    RunningChanged,
    SamplesLost,
    WriteDone,
    WriteFailed,
    WriteRefusedError,
    WriteUnknown,
)
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.protocol import frames
from retuner.drivers.protocol.checksum import to_wire
from retuner.drivers.protocol.codec import Codec
from retuner.drivers.protocol.frames import GainBox

CODEC = Codec(1)


def drop(bench, kinds, *, to_host):
    """From now on, frames of these kinds do not arrive."""
    link = bench.near if to_host else bench.far
    receive = link.receive_all
    link.receive_all = lambda: [m for m in receive() if not isinstance(CODEC.decode(m), kinds)]
    return lambda: setattr(link, "receive_all", receive)


def test_connecting_reads_what_runs(make_bench) -> None:
    bench = make_bench()
    assert (bench.host.connected, bench.host.running) == (False, None)
    events = bench.run(4)

    assert bench.others(events) == [LinkChanged(LinkState.UP, "controller found, active gains read back")]
    assert bench.host.running.gains == bench.FIRST
    assert bench.host.running.seq == 0


def test_samples_are_those_of_the_device(bench) -> None:
    samples = bench.samples(bench.run(300))

    assert len(samples) == 300
    assert [s.t_s for s in samples] == [2.0 * (6 + i) for i in range(300)]
    last = samples[-1]
    assert last.pv == pytest.approx(bench.device.pv, rel=1e-7)
    assert last.co == pytest.approx(bench.device.co, abs=5e-5)
    assert (last.sp, last.mode, last.limited, last.x, last.revision) == (50.0, LoopMode.AUTO, 0, 50.0, 0)


@pytest.mark.parametrize("variable", ["sp", "pv", "co"])
def test_the_scheduling_variable_is_filled_in(make_bench, variable: str) -> None:
    bench = make_bench(host=CanDeviceSettings(variable=variable))
    sample = bench.samples(bench.run(9))[-1]
    assert sample.x == getattr(sample, variable)


def test_a_write_ends_in_the_gains_that_run_as_float32_within_ten_samples(bench) -> None:
    asked = PidGains(1.1, 0.07, 0.3)
    seq = bench.host.begin_write(asked, bench.now_s)
    assert bench.host.writing
    events = bench.run(10)

    (done,) = bench.others(events)
    assert isinstance(done, WriteDone)
    assert done.seq == seq == 1
    assert done.gains == to_wire(asked) == bench.device.running.gains
    assert done.gains != asked
    assert bench.host.running == done.running
    assert not bench.host.writing
    assert bench.samples(events)[-1].revision == 1


def test_setpoint_mode_and_load_are_acknowledged_and_done(bench) -> None:
    bench.host.send_setpoint(60.0, bench.now_s)
    bench.host.send_mode(auto=False, co=33.5, now_s=bench.now_s)
    bench.host.send_load(-5.0, bench.now_s)
    events = bench.run(3)

    assert {e.command for e in events if isinstance(e, CommandDone)} == {"setpoint", "mode", "load"}
    sample = bench.samples(events)[-1]
    assert (sample.sp, sample.mode, sample.co) == (60.0, LoopMode.MANUAL, 33.5)
    assert bench.device.load == -5.0
    bench.host.send_mode(auto=True, co=0.0, now_s=bench.now_s)
    assert bench.samples(bench.run(3))[-1].mode == LoopMode.AUTO


def test_lost_commands_are_repeated_and_done_once(bench) -> None:
    heal = drop(bench, frames.Setpoint, to_host=False)
    bench.host.send_setpoint(61.0, bench.now_s)
    bench.run(5)
    assert bench.device.sp == 50.0
    heal()
    assert CommandDone("setpoint") in bench.run(6)
    assert bench.device.sp == 61.0


def test_a_command_that_nobody_answers_is_reported(bench) -> None:
    drop(bench, frames.Load, to_host=False)
    bench.host.send_load(1.0, bench.now_s)
    assert CommandFailed("load", "no answer to 10 frames") in bench.run(40)


def test_a_setpoint_outside_the_range_is_refused_by_the_device(make_bench) -> None:
    bench = make_bench(sp_min=0.0, sp_max=100.0)
    bench.run(5)
    bench.host.send_setpoint(101.0, bench.now_s)
    assert CommandFailed("setpoint", "the device refused it: out of range") in bench.run(3)
    assert bench.device.sp == 50.0


def test_a_second_host_that_starts_its_counters_anew_is_heard_all_the_same(bench) -> None:
    for sp in range(51, 60):
        bench.host.send_setpoint(float(sp), bench.now_s)
        bench.run(2)
    bench.host.commands._counters.clear()  # what a restarted host knows
    bench.host.send_setpoint(70.0, bench.now_s)
    assert CommandDone("setpoint") in bench.run(4)
    assert bench.device.sp == 70.0


@pytest.mark.parametrize("value", [math.nan, math.inf, 2e9])
def test_values_that_must_not_travel_are_refused_at_once(bench, value: float) -> None:
    with pytest.raises(WriteRefusedError, match=r"node 1 on virtual .*SETPOINT\.sp = .*give a number from"):
        bench.host.send_setpoint(value, bench.now_s)
    with pytest.raises(WriteRefusedError, match="MODE"):
        bench.host.send_mode(auto=False, co=value, now_s=bench.now_s)
    with pytest.raises(WriteRefusedError, match="LOAD"):
        bench.host.send_load(value, bench.now_s)
    assert bench.others(bench.run(3)) == []


def test_writes_are_refused_when_not_connected_busy_or_not_on_the_wire(make_bench) -> None:
    bench = make_bench()
    with pytest.raises(WriteRefusedError, match="not connected"):
        bench.host.begin_write(bench.SECOND, 0.0)
    with pytest.raises(WriteRefusedError, match="unknown"):
        bench.host.store(0.0)
    bench.run(5)
    with pytest.raises(WriteRefusedError, match="float32"):
        bench.host.begin_write(PidGains(1e39, 1.0), bench.now_s)
    with pytest.raises(WriteRefusedError, match=r"STAGE\.value"):
        bench.host.begin_write(PidGains(1e13, 1.0), bench.now_s)
    bench.host.begin_write(bench.SECOND, bench.now_s)
    with pytest.raises(WriteRefusedError, match="under way"):
        bench.host.begin_write(bench.SECOND, bench.now_s)


@pytest.mark.parametrize(
    ("gains", "reason"),
    [
        (PidGains(11.0, 0.0625, 0.5), "ratio (kp)"),
        (PidGains(1.0, 0.0625, 0.01), "ratio (kd)"),
        (PidGains(9.0, 0.6, 4.0), "outside box (ki)"),
        (PidGains(-1.0, -0.06, -0.5), "outside box (kp)"),
    ],
)
def test_what_the_device_refuses_ends_on_the_old_set_read_back(make_bench, gains: PidGains, reason: str) -> None:
    bench = make_bench(box=GainBox(kp_max=20.0, ki_max=0.5, kd_max=5.0, ratio_max=10.0, direction=1))
    bench.run(5)
    seq = bench.host.begin_write(gains, bench.now_s)
    (failed,) = bench.others(bench.run(12))

    assert failed == WriteFailed(seq, f"the device refused it: {reason}", bench.host.running)
    assert failed.running.gains == bench.FIRST == bench.device.running.gains
    bench.host.begin_write(bench.SECOND, bench.now_s)
    assert isinstance(bench.others(bench.run(10))[0], WriteDone)


def test_silence_makes_the_running_set_unknown_and_its_end_reads_it_again(bench) -> None:
    events = bench.silence(12)
    (silent,) = bench.others(events)
    assert isinstance(silent, LinkChanged)
    assert silent.state in {LinkState.SILENT, LinkState.DOWN}
    assert (bench.host.connected, bench.host.running) == (False, None)

    events = bench.run(10)
    assert [e.state for e in events if isinstance(e, LinkChanged)] == [LinkState.UP]
    assert bench.host.running.gains == bench.FIRST
    times = [s.t_s for s in bench.samples(bench.events)]
    assert all(b > a for a, b in itertools.pairwise(times))


def test_a_restart_is_noticed_and_time_goes_on(bench) -> None:
    bench.host.begin_write(bench.SECOND, bench.now_s)
    bench.run(10)
    bench.device.restart()
    events = bench.run(10)

    restarted = next(e for e in events if isinstance(e, DeviceRestarted))
    assert restarted.epoch == 2
    assert restarted.running.gains == bench.FIRST == bench.host.running.gains
    times = [s.t_s for s in bench.samples(bench.events)]
    assert all(0 < b - a <= 10 for a, b in itertools.pairwise(times))
    assert not any(isinstance(e, RunningChanged) for e in events)


def test_a_write_by_somebody_else_is_noticed(bench) -> None:
    other = bench.device.running._replace(seq=7, gains=bench.SECOND)
    bench.device.pages.running = other
    (changed,) = bench.others(bench.run(6))

    assert changed == RunningChanged(bench.host.running)
    assert changed.running.gains == bench.SECOND


def test_lost_samples_are_told(bench) -> None:
    heal = drop(bench, frames.TelemetryPv, to_host=True)
    bench.run(3)
    heal()
    events = bench.run(2)

    assert [e.count for e in events if isinstance(e, SamplesLost)] == [3]


def test_frames_of_another_host_are_counted(bench) -> None:
    bench.far.send(CODEC.encode(frames.Setpoint(9, 1.0, 2)))
    bench.run(1)
    assert bench.host.foreign_commands == 1


def test_nobody_there_is_one_clear_line(make_bench) -> None:
    bench = make_bench()
    with pytest.raises(
        DeviceSilentError, match=r"node 1 on virtual bench-\d+: no answer within 40 s of the loop's time; is"
    ):
        bench.silence(100)


@pytest.mark.parametrize(
    ("settings", "message"), [(CanDeviceSettings(sample_time_s=1.0), "its sample time is 2 s, configured are 1 s")]
)
def test_a_device_that_is_not_the_expected_one_is_refused(make_bench, settings, message: str) -> None:
    with pytest.raises(DeviceMismatchError, match=message):
        make_bench(host=settings).run(5)


def test_another_protocol_or_layout_is_refused(make_bench, monkeypatch: pytest.MonkeyPatch) -> None:
    other = SimpleNamespace(**{**vars(frames), "PROTOCOL_VERSION": 9})
    monkeypatch.setattr("retuner.drivers.controller.virtual_device.wire", other)
    with pytest.raises(DeviceMismatchError, match="protocol 9, this host 3"):
        make_bench().run(5)
    monkeypatch.undo()
    monkeypatch.setattr("retuner.drivers.controller.virtual_device.schema", lambda: 0xABCD)
    with pytest.raises(DeviceMismatchError, match="frame layout is 0xabcd"):
        make_bench().run(5)


@pytest.mark.parametrize("name", ["sample_time_s", "reply_samples", "silent_samples"])
def test_settings_are_checked(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        CanDeviceSettings(**{name: 0.0})


def test_two_devices_under_one_number_are_noticed_and_nothing_is_written(make_bench) -> None:
    bench = make_bench(heartbeat_samples=1)
    twin = make_bench(link=bench.far.settings, heartbeat_samples=1)
    twin.device.epoch = 900
    twin.device._boot()
    bench.run(5)
    for _ in range(60):
        bench.run(1)
        twin.on_bus.sample()
    assert any(isinstance(e, DeviceConflict) for e in bench.events)
    assert not bench.host.connected
    with pytest.raises(WriteRefusedError, match="not connected"):
        bench.host.begin_write(bench.SECOND, bench.now_s)
    bench.run(60)  # the twin is off
    assert bench.host.connected
    assert bench.host.running.gains == bench.FIRST


def test_events_between_polls_are_told_at_the_next(bench) -> None:
    drop(bench, frames.Ack, to_host=True)
    bench.host.begin_write(bench.SECOND, bench.now_s)
    for _ in range(20):
        bench.run(1)
        bench.host.send_load(0.0, bench.now_s)  # also sends what is due, and may find the result unknown
    assert sum(isinstance(e, WriteUnknown) for e in bench.events) == 1


def test_a_device_that_rounds_silently_gets_nothing_committed(bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The read-back is compared bit by bit: fixed-point firmware shows before anything runs."""
    stage = bench.device.pages.stage
    monkeypatch.setattr(bench.device.pages, "stage", lambda f: stage(replace(f, value=round(f.value * 4) / 4)))
    bench.host.begin_write(PidGains(1.1, 0.07, 0.5), bench.now_s)
    (failed,) = [e for e in bench.run(40) if isinstance(e, WriteFailed)]
    assert "holds kp 1, kd 0.5 where kp 1.1, ki 0.07, kd 0.5 was sent: it rounds or limits" in failed.reason
    assert bench.device.running.gains == bench.FIRST


def test_no_write_begins_while_the_telemetry_is_wrong(bench) -> None:
    receive = bench.near.receive_all

    def garbled() -> list:
        messages = receive()
        for message in messages:
            if isinstance(CODEC.decode(message), frames.TelemetryPv):
                message.data[6] ^= 1
        return messages

    bench.near.receive_all = garbled
    assert bench.samples(bench.run(8)) == []
    with pytest.raises(WriteRefusedError, match="too many of the latest telemetry frames were wrong"):
        bench.host.begin_write(bench.SECOND, bench.now_s)
    bench.near.receive_all = receive
    bench.run(20)
    bench.host.begin_write(bench.SECOND, bench.now_s)
    assert any(isinstance(e, WriteDone) for e in bench.run(8))


def beside(bench, twin, samples: int) -> None:
    """Both devices go on, and both answer."""
    for _ in range(samples):
        twin.on_bus.sample()
        bench.run(1)
        twin.on_bus.answer()


@pytest.mark.parametrize("every", [1, 5, 20])
def test_two_devices_of_different_epochs_from_the_start_are_named(make_bench, every: int) -> None:
    """It had said: no answer within 40 s."""
    bench = make_bench(host=CanDeviceSettings(connect_samples=200), heartbeat_samples=every)
    twin = make_bench(link=bench.far.settings, heartbeat_samples=every)
    twin.device.epoch = 900
    twin.device._boot()
    try:
        beside(bench, twin, 300)
    except DeviceSilentError as error:
        assert "two devices answer under this number" in str(error)  # noqa: PT017
    assert any(isinstance(event, DeviceConflict) for event in bench.events)
    assert not bench.host.connected


def test_two_devices_alike_in_everything_are_not_written(make_bench) -> None:
    """Of one epoch and at rest: both had been written."""
    bench = make_bench(heartbeat_samples=5)
    twin = make_bench(link=bench.far.settings, heartbeat_samples=5)
    beside(bench, twin, 80)
    assert any(isinstance(event, DeviceConflict) for event in bench.events)
    with pytest.raises(WriteRefusedError, match="not connected"):
        bench.host.begin_write(bench.SECOND, bench.now_s)
    beside(bench, twin, 40)
    assert not bench.host.connected
    bench.run(60)  # the twin is off
    assert bench.host.connected


def test_a_bus_that_doubles_many_frames_is_no_second_device(make_bench) -> None:
    bench = make_bench(heartbeat_samples=5)
    chance = random.Random(1)
    own = bench.near.receive_all
    bench.near.receive_all = lambda: [m for m in own() for _ in range(1 + (chance.random() < 0.5))]
    bench.run(600)
    assert bench.host.connected
    assert not any(isinstance(event, DeviceConflict) for event in bench.events)
