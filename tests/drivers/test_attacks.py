"""What somebody with the DBC and a second node on the bus tried, each as it was found."""

from dataclasses import replace

import pytest
from speaking import CODEC, FIRST, OWNER, SECOND, acks, commit, device, say, stage, step, take_lease

from retuner.drivers.device import (
    DeviceConflict,
    DeviceRestarted,
    LinkChanged,
    LinkState,
    RunningChanged,
    WriteDone,
    WriteFailed,
)
from retuner.drivers.host.can_settings import fresh_owner
from retuner.drivers.protocol.authentication import code_frames, commit_code
from retuner.drivers.protocol.checksum import lease_stamp
from retuner.drivers.protocol.frames import Auth, Heartbeat, Identity, Kind, Lease, Page, Read, Reason, Status

KEY = bytes(range(16))


def lost(bench, kinds) -> None:
    """Frames of these kinds do not reach the host any more."""
    receive = bench.near.receive_all
    bench.near.receive_all = lambda: [m for m in receive() if not isinstance(CODEC.decode(m), kinds)]


def outcomes(events) -> list[WriteDone | WriteFailed]:
    return [event for event in events if isinstance(event, WriteDone | WriteFailed)]


# Identity


def other_sample_time(bench, seconds: float) -> None:
    """Somebody puts a controller with another sample time in the place of this one."""
    bench.device.restart()
    bench.device.settings = replace(bench.device.settings, sample_time_s=seconds)
    step_of_plant = type(bench.device).step
    bench.device.step = lambda _=None: step_of_plant(bench.device, 2.0)


def test_a_device_that_comes_back_with_another_sample_time_is_told_and_not_written_to(bench) -> None:
    other_sample_time(bench, 1.0)
    events = bench.others(bench.run(30))
    (told,) = [event for event in events if isinstance(event, LinkChanged)]
    assert told.state is LinkState.SILENT
    assert "sample time is 1 s" in told.reason
    assert not any(isinstance(event, DeviceRestarted) for event in events)
    assert not bench.host.connected


def test_the_right_device_is_asked_who_it_is_after_every_restart(bench) -> None:
    bench.device.restart()
    events = bench.others(bench.run(10))
    assert [event.epoch for event in events if isinstance(event, DeviceRestarted)] == [2]
    assert bench.host.connected


def test_a_restart_is_not_believed_before_the_device_has_said_who_it_is(bench) -> None:
    lost(bench, Identity)
    bench.device.restart()
    assert not any(isinstance(event, DeviceRestarted) for event in bench.run(20))
    assert not bench.host.connected


def test_a_mismatch_after_a_long_silence_is_told_once_and_its_end_as_well(bench) -> None:
    bench.silence(20)
    other_sample_time(bench, 1.0)
    told = [event for event in bench.others(bench.run(40)) if isinstance(event, LinkChanged)]
    assert [event.state for event in told] == [LinkState.SILENT]
    assert "sample time is 1 s" in told[0].reason
    other_sample_time(bench, 2.0)
    told = [event for event in bench.others(bench.run(20)) if isinstance(event, LinkChanged)]
    assert [event.state for event in told] == [LinkState.UP]


# Codes of strangers


def right_code(dev, seq: int) -> list[Auth]:
    (challenge,) = say(dev, Read(Page.CHALLENGE, 5))
    return code_frames(commit_code(KEY, 1, dev.epoch, challenge.nonce, OWNER, seq, dev.running.seq, SECOND), seq)


def test_wrong_codes_of_a_stranger_do_not_lock_the_honest_host_out() -> None:
    dev = device(key=KEY)
    for seq in range(1, 40):
        wrong = [Auth(part, seq % 16, seq) for part in (0, 1)]
        assert acks(say(dev, *stage(seq, SECOND), *wrong, commit(seq, SECOND))) == [Reason.WRONG_CODE]
    honest = say(dev, *stage(40, SECOND), *right_code(dev, 40), commit(40, SECOND))
    assert acks([*honest, *step(dev)]) == [Reason.OK]


# Leases


def test_the_status_says_who_owns_in_full() -> None:
    dev = device()
    say(dev, Lease(OWNER, lease_stamp(1, 0), 0, 2))
    take_lease(dev, owner=0x1700)
    (status,) = [frame for frame in say(dev, Read(Page.IDENTITY, 1)) if isinstance(frame, Status)]
    assert status.owner == 0x1700


def test_fresh_owners_have_low_bits_that_short_frames_can_tell_from_nobody() -> None:
    assert all(fresh_owner() % 64 for _ in range(2000))


# What a host believes


def forge(bench, *frames) -> None:
    for frame in frames:
        bench.far.send(CODEC.encode(frame))


@pytest.mark.parametrize("ahead", [1, 100, 32766, 32767])
def test_a_forged_status_fails_no_write(bench, ahead: int) -> None:
    for gains in (bench.SECOND, bench.FIRST):
        forge(bench, Status(bench.device.running.seq, (bench.device.pages.latest + ahead) % 65536, 0, 1))
        bench.run(1)
        bench.host.begin_write(gains, bench.now_s)
        (outcome,) = outcomes(bench.run(25))
        assert isinstance(outcome, WriteDone)
        assert bench.device.running.gains == gains


def test_what_runs_is_not_said_to_be_the_old_set_while_only_acknowledges_are_lost(bench) -> None:
    receive, of_gains = bench.near.receive_all, {Kind.COMMIT, Kind.ABORT}
    bench.near.receive_all = lambda: [m for m in receive() if getattr(CODEC.decode(m), "kind", 0) not in of_gains]
    bench.host.begin_write(bench.SECOND, bench.now_s)
    bench.run(12)
    assert bench.device.running.gains == bench.SECOND
    assert bench.host.running.gains == bench.SECOND
    assert bench.host.writing


def test_two_devices_with_equal_epochs_and_different_counters_are_noticed(bench) -> None:
    told = []
    for number in range(60):
        if number % 5 == 0:
            forge(bench, Heartbeat(100_000 + number, 1, 1))
        told += bench.run(1)
    assert any(isinstance(event, DeviceConflict) for event in told)


def test_two_devices_with_equal_epochs_and_equal_counters_are_noticed(make_bench) -> None:
    bench = make_bench()
    twin = device(gains=FIRST)
    twin.load = 5.0
    told = []
    for _ in range(60):
        for message in twin.step():
            bench.far.send(message)
        told += bench.run(1)
    assert any(isinstance(event, DeviceConflict) for event in told)


def test_a_repeater_of_telemetry_is_no_second_device(bench) -> None:
    receive = bench.near.receive_all
    telemetry = {0x12, 0x13}
    bench.near.receive_all = lambda: [
        m for message in receive() for m in [message] * (1 + (message.arbitration_id & 31 in telemetry))
    ]
    assert not any(isinstance(event, DeviceConflict | RunningChanged) for event in bench.run(60))


def test_a_repeater_of_everything_may_be_a_second_device_and_is_told(bench) -> None:
    receive = bench.near.receive_all
    bench.near.receive_all = lambda: [m for message in receive() for m in (message, message)]
    assert any(isinstance(event, DeviceConflict) for event in bench.run(100))
