"""Where something else may well be behind one record, a loop that behaves waits for a second one that agrees."""

import pytest
from loop_bench import Bench, scaled, table

from retuner.adaptive.choice.choice_settings import ChoiceSettings
from retuner.adaptive.supervision.decision import Action, Decision, Mode
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.schedule.gains import PidGains


def first_two(gains: PidGains, doubt: float = ChoiceSettings().doubt) -> list[Decision]:
    """doubt : odds that something else than the models is behind one record."""
    settings = RetunerSettings(1.0, 10.0, Mode.AUTO, choice=ChoiceSettings(doubt=doubt))
    found = Bench(Retuner(table(gains), settings)).exercise(4)
    return [d for d in found if d.estimate is not None][:2]


@pytest.mark.slow
@pytest.mark.uncounted
def test_a_loop_that_behaves_is_moved_when_a_second_record_agrees() -> None:
    first, second = first_two(scaled(0.6, 0.6), doubt=2.0)
    assert first.code == "one_record"
    assert first.action is Action.NONE
    assert first.gains_after is None
    assert "a second record must agree" in first.reason
    assert second.action is Action.WRITE
    assert second.records == 2


@pytest.mark.uncounted
@pytest.mark.parametrize("share", [0.2, 0.6, 2.5])
def test_a_loop_that_is_slow_or_swings_is_moved_at_once_by_a_setpoint_step_from_rest(share: float) -> None:
    assert first_two(scaled(share, share))[0].action is Action.WRITE
