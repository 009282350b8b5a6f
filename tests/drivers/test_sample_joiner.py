"""Telemetry to samples: wrap, loss, repetition, order, stray halves and restarts."""

import random
from dataclasses import replace

import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from retuner.drivers.protocol.checksum import sample_crc
from retuner.drivers.protocol.frames import TelemetryPv, TelemetrySp
from retuner.drivers.telemetry.device_counter import Said
from retuner.drivers.telemetry.sample_assembly import AssembledSample, SampleJoiner


def halves(number: int, revision: int = 1) -> tuple[TelemetryPv, TelemetrySp]:
    pv = TelemetryPv(number % 256, float(number), 50.0)
    sp = TelemetrySp(number % 256, 7.0, 1, 0, revision, 0)
    return pv, replace(sp, crc=sample_crc(1, pv, sp))


def feed(joiner: SampleJoiner, number: int) -> list[AssembledSample]:
    return [joined for half in halves(number) if (joined := joiner.take(half)) is not None]


def test_nothing_before_the_first_reference() -> None:
    joiner = SampleJoiner(2.0)
    assert feed(joiner, 3) == []
    joiner.set_reference(3)
    assert [j.sample.t_s for j in feed(joiner, 4)] == [8.0]


def test_counter_wraps() -> None:
    joiner = SampleJoiner(0.5)
    joiner.set_reference(250)
    got = []
    for n in range(251, 2000):
        got += feed(joiner, n)
        if n % 100 == 0:
            joiner.set_reference(n)
    assert [j.sample.t_s for j in got] == [0.5 * n for n in range(251, 2000)]
    assert [j.sample.pv for j in got] == [float(n) for n in range(251, 2000)]
    assert {j.lost for j in got} == {0}


@pytest.mark.uncounted
@given(seed=st.integers(0, 10**6), loss=st.floats(0.0, 0.6))
@settings(max_examples=examples(100))
def test_whatever_arrives_the_samples_are_true_and_the_loss_is_counted(seed: int, loss: float) -> None:
    rng = random.Random(seed)
    joiner = SampleJoiner(1.0)
    joiner.set_reference(0)
    arriving = [
        (2 * n + i + rng.choice((0, 0, 0, 3, 7)), rng.random(), half)
        for n in range(1, 600)
        for i, half in enumerate([*halves(n), *([n] if n % 5 == 0 else [])])
        for _ in range(rng.choices((0, 1, 2), (loss, 1 - loss, 0.1))[0])
    ]
    got = []
    for _, _, arrived in sorted(arriving, key=lambda a: a[:2]):
        if isinstance(arrived, int):
            joiner.set_reference(arrived)
        elif (joined := joiner.take(arrived)) is not None:
            got.append(joined)
    numbers = [round(j.sample.t_s) for j in got]

    assert all(j.sample.pv == j.sample.t_s for j in got)
    assert numbers == sorted(set(numbers))
    assert sum(j.lost for j in got[1:]) == numbers[-1] - numbers[0] - (len(numbers) - 1)


def test_a_stray_half_is_not_joined_with_a_later_sample() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1)
    joiner.take(halves(60, revision=9)[1])
    got = [j for n in range(2, 80) for j in feed(joiner, n)]
    assert {j.sample.revision for j in got} == {1}
    assert len(got) == 78


def test_a_stray_sample_further_ahead_than_the_heartbeats_have_said_counts_for_nothing() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1)
    feed(joiner, 2)
    assert feed(joiner, 102) == []
    got = [j for n in range(3, 30) for j in feed(joiner, n)]
    assert [(j.sample.t_s, j.lost) for j in got] == [(float(n), 0) for n in range(3, 30)]


def test_heartbeats_that_stay_away_end_the_telemetry_until_the_next_one() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1)
    assert [j.sample.t_s for n in range(2, 900) for j in feed(joiner, n)] == [float(n) for n in range(2, 102)]
    joiner.set_reference(900)  # far ahead: the next one has to agree
    assert feed(joiner, 901) == []
    joiner.set_reference(905)
    (joined,) = feed(joiner, 906)
    assert (joined.sample.t_s, joined.lost) == (906.0, 906 - 102)


def test_one_heartbeat_far_ahead_or_behind_moves_nothing() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1000)
    said = []
    for n in range(1001, 1060):
        said += [joiner.set_reference(stray) for stray in (70_000 + n, 3) if n % 7 == 0]
        (joined,) = feed(joiner, n)
        assert (joined.sample.t_s, joined.lost) == (n, 0)
        if n % 5 == 0:
            said.append(joiner.set_reference(n))
    assert Said.CONTRADICTS in said


def test_contact_lost_for_longer_than_the_counter_needs_a_new_reference() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(1)
    feed(joiner, 2)
    joiner.forget()
    assert feed(joiner, 1000) == []
    joiner.set_reference(1000)
    (joined,) = feed(joiner, 1001)
    assert (joined.sample.t_s, joined.lost) == (1001.0, 998)


def test_time_goes_on_over_a_restart() -> None:
    joiner = SampleJoiner(1.0)
    joiner.set_reference(500)
    feed(joiner, 501)
    joiner.restart(3, 20)
    (joined,) = feed(joiner, 4)
    assert (joined.sample.t_s, joined.lost) == (522.0, 1)


def test_an_unknown_variable_is_refused() -> None:
    with pytest.raises(ValueError, match='variable = "mv"; give'):
        SampleJoiner(1.0, "mv")
