"""A loop that behaves is not moved on the word of one record; one that does not is moved at once."""

import pytest
from loop_bench import made, scaled

from retuner.adaptive.supervision.decision import Action, Decision
from retuner.schedule.gains import PidGains


def first_two(gains: PidGains) -> list[Decision]:
    found = made(gains).exercise(4)
    return [d for d in found if d.estimate is not None][:2]


def test_a_loop_that_behaves_is_moved_when_a_second_record_agrees() -> None:
    first, second = first_two(scaled(0.6, 0.6))
    assert first.code == "one_record"
    assert first.action is Action.NONE
    assert first.gains_after is None
    assert "2 records must agree" in first.reason
    assert second.action is Action.COMMIT
    assert second.records == 2


@pytest.mark.parametrize("share", [0.2, 2.5])
def test_a_loop_that_is_slow_by_much_or_swings_is_moved_at_once(share: float) -> None:
    assert first_two(scaled(share, share))[0].action is Action.COMMIT
