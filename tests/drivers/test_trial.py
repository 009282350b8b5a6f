"""A committed set is on trial until it is confirmed: reverted in time, stored only afterwards, without a bump."""

import pytest
from speaking import FIRST, SECOND, acks, commit, device, say, step, write

from retuner.drivers.device import CommandDone, Reverted, WriteRefusedError
from retuner.drivers.host.lease_and_commands import Probation
from retuner.drivers.protocol.frames import Reason


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
