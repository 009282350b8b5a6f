"""Classification of a stream: every arrival, every state, every way between them."""

import itertools

import pytest

from retuner.drivers.telemetry.telemetry_quality import (
    MAX_WRONG,
    TRANSITIONS,
    WINDOW,
    Arrival,
    ArrivalCheck,
    Stream,
    TelemetryVerdict,
)


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
