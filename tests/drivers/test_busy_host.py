"""A host that was busy for longer than its lease: what it writes then comes about all the same."""

from retuner.drivers.device import CommandDone, CommandFailed, WriteDone, WriteFailed
from retuner.drivers.host.can_settings import CanDeviceSettings
from retuner.drivers.protocol.checksum import lease_stamp
from retuner.drivers.protocol.frames import Lease

LEASE_SAMPLES = 30
BUSY_SAMPLES = 40


def busy(bench, samples=BUSY_SAMPLES) -> None:
    """The host does something else: the device goes on, and nobody prolongs the lease."""
    for _ in range(samples):
        bench.clock.advance(bench.device.settings.sample_time_s)
        bench.on_bus.sample()


def test_a_write_that_begins_after_the_lease_ran_out_takes_the_lease_and_comes_about(bench) -> None:
    bench.run(10)
    before_s = bench.now_s
    busy(bench)
    assert bench.device.lease.owner == 0
    bench.host.begin_write(bench.SECOND, before_s)  # at the time of the sample that asked for it
    events = bench.run(12)
    assert [type(e) for e in events if isinstance(e, WriteDone | WriteFailed)] == [WriteDone]
    assert bench.device.running.gains == bench.SECOND


def test_a_lease_that_runs_out_while_the_gains_are_staged_is_taken_again(bench) -> None:
    bench.run(10)
    bench.host.begin_write(bench.SECOND, bench.now_s)
    bench.on_bus.answer()  # staged, and read back; the host hears of it only after a long time
    busy(bench)
    events = bench.run(14)
    assert [type(e) for e in events if isinstance(e, WriteDone | WriteFailed)] == [WriteDone]
    assert bench.device.running.gains == bench.SECOND


def test_a_lease_that_another_host_took_meanwhile_ends_the_write_and_says_whose_it_is(bench) -> None:
    bench.run(10)
    busy(bench)
    dev = bench.device
    dev.lease.request(Lease(77, lease_stamp(dev.epoch, dev.sample), 6000, 1), dev.epoch, dev.sample)
    bench.host.begin_write(bench.SECOND, bench.now_s)
    events = bench.run(20)
    failed = [e for e in events if isinstance(e, WriteFailed)]
    assert [e.reason for e in failed] == ["host 77 holds the lease"]
    assert bench.device.running.gains == bench.FIRST


def test_a_setpoint_after_the_lease_ran_out_is_carried_out(bench) -> None:
    bench.run(10)
    before_s = bench.now_s
    busy(bench)
    bench.host.send_setpoint(60.0, before_s)
    events = bench.run(8)
    assert [e for e in events if isinstance(e, CommandDone | CommandFailed)] == [CommandDone("setpoint")]
    assert bench.device.sp == 60.0


def test_a_lease_counts_from_the_request_that_was_answered_and_not_from_one_that_was_not(make_bench) -> None:
    bench = make_bench(host=CanDeviceSettings(lease_samples=float(LEASE_SAMPLES)))
    bench.run(10)
    keeper = bench.host.lease
    bench.silence(LEASE_SAMPLES + 5)  # asks all the time, and nobody answers
    assert not keeper.held
