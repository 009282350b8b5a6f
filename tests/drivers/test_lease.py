"""One host commands: the lease is granted, prolonged, refused, given back and runs out; two hosts on one bus."""

import pytest
from speaking import OWNER, SECOND, THIRD, acks, commit, device, say, stage, step, take_lease

from retuner.drivers.bus.link_settings import LinkSettings
from retuner.drivers.device import (
    CommandDone,
    ForeignHost,
    LeaseChanged,
    RunningChanged,
    WriteDone,
    WriteFailed,
    WriteRefusedError,
)
from retuner.drivers.host.can_device import CanDevice
from retuner.drivers.host.can_settings import CanDeviceSettings, fresh_owner
from retuner.drivers.host.lease_and_commands import UNATTENDED
from retuner.drivers.protocol.checksum import lease_stamp
from retuner.drivers.protocol.frames import Lease, Reason, Status

OTHER = 77


def test_a_lease_is_prolonged_for_ever_round_the_circle_of_its_counter() -> None:
    """A counter of 8 bits comes round after 256 requests: a session of hours must not lose its controller there."""
    dev = device()
    for counter in range(2, 600):
        assert take_lease(dev, samples=5, counter=counter % 256).reason == Reason.OK
        step(dev)
    assert dev.lease.owner == OWNER
    assert take_lease(dev, samples=6, counter=(599 - 3) % 256).reason == Reason.STALE


@pytest.mark.parametrize(("sample_s", "longest"), [(2.0, 600), (0.05, 600), (0.01, 600), (0.001, 6000), (1e-4, 60000)])
def test_a_lost_request_that_is_sent_again_locks_the_loop_for_the_longest_lease_only(sample_s, longest):
    """A repeater may send a request of 6,000 samples that never came through when its host is gone."""
    dev = device(sample_time_s=sample_s)
    lost = Lease(OTHER, lease_stamp(dev.epoch, dev.sample), 60000, 200)
    say(dev, Lease(OWNER, lease_stamp(dev.epoch, dev.sample), 0, 2))
    assert dev.lease.owner == 0
    assert acks(say(dev, lost)) == [Reason.OK]
    assert dev.settings.lease_longest == longest
    for _ in range(600 if longest == 600 else 0):
        assert dev.lease.owner == OTHER
        step(dev)
    assert dev.lease.owner == (0 if longest == 600 else OTHER)


def test_a_request_is_checked_by_its_stamp_then_its_owner_then_its_counter() -> None:
    dev = device()
    right, wrong = lease_stamp(dev.epoch, dev.sample), lease_stamp(dev.epoch, dev.sample + 640)
    take_lease(dev, counter=5)
    assert acks(say(dev, Lease(OTHER, wrong, 5, 9))) == [Reason.STALE]
    assert acks(say(dev, Lease(OTHER, right, 5, 9))) == [Reason.NOT_OWNER]
    assert acks(say(dev, Lease(OTHER, right, 0, 9))) == [Reason.NOT_OWNER]
    assert acks(say(dev, Lease(OWNER, right, 5, 4))) == [Reason.STALE]
    assert acks(say(dev, Lease(OWNER, right, 0, 4))) == [Reason.STALE]
    assert dev.lease.owner == OWNER


def test_a_lease_of_n_samples_is_over_in_the_status_of_the_nth_sample() -> None:
    dev = device(heartbeat_samples=1)
    take_lease(dev, samples=3, counter=2)
    told = [next(f.owner for f in step(dev) if isinstance(f, Status)) for _ in range(4)]
    assert told == [OWNER, OWNER, 0, 0]


def test_an_accepted_commit_stays_accepted_when_the_lease_ends() -> None:
    dev = device()
    say(dev, *stage(1, SECOND), commit(1, SECOND), Lease(OWNER, lease_stamp(dev.epoch, dev.sample), 0, 2))
    assert acks(step(dev)) == [Reason.OK]
    assert dev.running.gains == SECOND


@pytest.fixture
def two(make_bench):
    """A bench, and a second host on a link of its own."""
    made = make_bench(host=CanDeviceSettings(owner=OWNER))
    made.run(6)
    link = type(made.near)(LinkSettings(channel=made.near.settings.channel), made.clock)
    second = CanDevice(link, CanDeviceSettings(owner=OTHER))
    events = []

    def run(samples: int) -> None:
        for _ in range(samples):
            made.run(1)
            events.extend(made.others(second.poll(made.now_s)))
            made.on_bus.answer()

    yield made, second, events, run
    link.close()


def test_of_two_hosts_one_watches_and_gets_the_lease_when_the_other_gives_it_back(two) -> None:
    bench, second, events, run = two
    run(8)
    assert second.connected
    assert LeaseChanged(ours=False, owner=OWNER) in events
    with pytest.raises(WriteRefusedError, match=f"host {OWNER} holds the lease"):
        second.begin_write(SECOND, bench.now_s)
    bench.host.begin_write(SECOND, bench.now_s)
    run(8)
    assert any(isinstance(e, WriteDone) for e in bench.events)
    assert any(isinstance(e, RunningChanged) and e.running.gains == SECOND for e in events)
    assert next(e for e in events if isinstance(e, ForeignHost)) == ForeignHost(1)  # the first is told at once

    bench.host.release(bench.now_s)
    run(30)
    assert LeaseChanged(ours=True, owner=OTHER) in events
    second.begin_write(THIRD, bench.now_s)
    run(8)
    assert any(isinstance(e, WriteDone) for e in events)
    assert bench.device.running.gains == THIRD


def test_a_host_that_died_leaves_the_lease_behind_only_for_its_length(two) -> None:
    bench, second, _, run = two
    run(4)
    bench.host = second  # the first one is never polled again
    bench.run(45)
    assert bench.device.lease.owner == OTHER


def test_a_write_that_loses_the_lease_half_way_ends_on_the_old_set(bench) -> None:
    seq = bench.host.begin_write(SECOND, bench.now_s)
    bench.device.lease.boot()
    bench.device.pages.drop_staged()
    take_lease(bench.device, owner=OTHER)
    (failed,) = [e for e in bench.run(20) if isinstance(e, WriteFailed)]
    assert failed.seq == seq
    assert failed.reason == f"host {OTHER} holds the lease"
    assert bench.device.running.gains == bench.FIRST


def test_what_is_staged_under_a_lease_goes_with_it() -> None:
    dev = device()
    say(dev, *stage(1, SECOND))
    assert dev.pages.has_staged
    take_lease(dev, samples=0, counter=2)
    assert not dev.pages.has_staged


def test_a_command_waits_for_the_lease(bench) -> None:
    bench.device.lease.boot()
    bench.host.send_setpoint(60.0, bench.now_s)
    assert CommandDone("setpoint") in bench.run(20)
    assert bench.device.sp == 60.0


def test_owners_are_numbers_of_16_bits() -> None:
    assert all(1 <= fresh_owner() <= 65535 for _ in range(100))
    with pytest.raises(ValueError, match="owner = 0; give 1 to 65535"):
        CanDeviceSettings(owner=0)
    with pytest.raises(ValueError, match="at least 16"):
        CanDeviceSettings(key=b"short")
    with pytest.raises(ValueError, match="probation_samples = -1"):
        CanDeviceSettings(probation_samples=-1)


def test_an_unattended_lease_is_kept_for_four_times_its_length() -> None:
    assert UNATTENDED == 4.0  # docs/developers/safety.md promises it
