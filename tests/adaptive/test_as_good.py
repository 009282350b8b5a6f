"""A loop that does not swing is not made slower while a model that is as good holds it for robust."""

from dataclasses import replace

import pytest
from loop_bench import Bench, scaled, table

from retuner.adaptive.guard import Ruling, Verdict
from retuner.adaptive.signals.response import Ending, Peak, Response
from retuner.adaptive.signals.sample import LoopSample
from retuner.adaptive.supervision.decision import Decision, Mode
from retuner.adaptive.supervision.proposal_from_model import half_seen, no_gain
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.settings import RetunerSettings

USUAL = RetunerSettings(1.0, 10.0, Mode.AUTO)


def decided(settings: RetunerSettings, share: float) -> list[Decision]:
    """Of a loop with so many times the rule's gain, over several upsets."""
    return Bench(Retuner(table(scaled(share, share)), settings), seed=2).exercise()


@pytest.fixture(scope="module")
def bold() -> list[Decision]:
    """A little over its limit by the models, and slower by what the rule gives."""
    return decided(USUAL, 1.1)


def test_a_loop_in_order_is_left_alone(bold: list[Decision]) -> None:
    assert "commit" not in {str(d.action) for d in bold}
    assert [d.reason for d in bold if d.code == "as_good"]


def test_what_retuner_wrote_itself_is_corrected_where_that_costs_little() -> None:
    """The same gains, but they are not those that the session began with; here that costs a fifth of the IAE."""
    found, baseline = table(scaled(1.1, 1.1)), table(scaled(2.0, 2.0))
    for most, written in ((1.1, False), (1.25, True)):
        retuner = Retuner(found, replace(USUAL, own_iae=most), commissioned=baseline)
        actions = {str(d.action) for d in Bench(retuner, seed=2).exercise()}
        assert ("commit" in actions) is written


def test_a_persons_set_is_not_corrected_as_if_retuner_had_written_it() -> None:
    """The same gains and the same baseline, but a person has set them."""
    ours, theirs = scaled(0.8, 0.8), scaled(1.1, 1.1)
    retuner = Retuner(table(theirs), replace(USUAL, own_iae=1.25), commissioned=table(scaled(2.0, 2.0)))
    retuner.trials.edited(0, theirs, ours, -1e6)  # its hold is long over
    assert "commit" not in {str(d.action) for d in Bench(retuner, seed=2).exercise()}


def test_without_that_it_would_be_made_slower() -> None:
    assert "commit" in {str(d.action) for d in decided(replace(USUAL, worth_iae=2.0, behaving_records=1), 1.1)}


def test_a_loop_that_is_over_its_limit_on_every_model_is_made_slower() -> None:
    assert "commit" in {str(d.action) for d in decided(USUAL, 2.0)}


@pytest.mark.parametrize(
    ("ms", "iae", "urgent", "stays"),
    [
        (1.5, 0.95, False, True),
        (1.5, 2.0, False, True),
        (1.5, 0.8, False, False),
        (1.9, 1.2, False, False),
        (1.5, 1.2, True, False),
    ],
)
def test_a_robust_loop_is_not_moved_for_next_to_nothing(ms: float, iae: float, urgent: bool, stays: bool) -> None:
    verdict = Verdict(Ruling.ACCEPTED, scaled(2.0, 2.0), 1.0, 1.6, 1.8, ms, 5.0, urgent=urgent)
    assert bool(no_gain(verdict, iae, USUAL)) is stays


def test_small_steps_are_weighed_by_the_way_that_they_are_of() -> None:
    """Each of them brings less than a change must; together they bring much."""
    small = replace(USUAL, guard=replace(USUAL.guard, step_up_max=1.1))
    written = [
        d for d in Bench(Retuner(table(scaled(0.4, 0.4)), small), seed=2).exercise(4) if d.gains_after is not None
    ]
    assert len(written) >= 2
    assert all(d.gains_after.kp == pytest.approx(1.1 * d.gains_before.kp) for d in written if d.gains_after)


@pytest.mark.parametrize(
    ("limited", "ms", "urgent", "waits"),
    [(3, 1.4, False, True), (0, 1.4, False, False), (3, 2.0, False, False), (3, 1.4, True, False)],
)
def test_one_record_with_the_output_at_its_limit_gives_a_robust_loop_no_more(
    limited: int, ms: float, urgent: bool, waits: bool
) -> None:
    samples = [LoopSample(float(i), 1.0, 0.0, 50.0, limited=int(20 <= i < 20 + limited)) for i in range(60)]
    response = Response(10.0, 50.0, (Peak(12.0, 1.0),), Ending.QUIET, True, 0.1)
    verdict = Verdict(Ruling.ACCEPTED, scaled(2.0, 2.0), 1.0, 1.6, 1.8, ms, 5.0, urgent=urgent)
    assert bool(half_seen(samples, response, verdict, USUAL)) is waits
