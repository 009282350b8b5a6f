"""What ends a trial acts at once, whatever question is open; what the record teaches comes later."""

import pytest
from rig import GOOD
from test_retuner_trial import NEW, Stand, learned_by_a_runaway

from retuner import Action, TrialEvent
from retuner.adaptive.region_model.update import Agreement
from retuner.adaptive.supervision.decide import decide
from retuner.adaptive.supervision.question import Step


def step_until(stand: Stand, *, decision: bool = False, question: bool = False) -> Step:
    """The first step with a decision, or with a question."""
    for sample in stand.rig.run(2000):
        step = stand.retuner.step(sample)
        if (decision and step.decision) or (question and step.question):
            return step
    raise AssertionError("nothing came")


@pytest.mark.parametrize("known", [False, True])
def test_a_runaway_is_taken_back_before_anything_is_fitted(*, known: bool) -> None:
    """The answer teaches afterwards as it does with `observe`: a model that promised wrongly stays forgotten."""
    at_once, stand = Stand(), Stand()
    for one in (at_once, stand):
        one.retuner.region_models = {0: learned_by_a_runaway()} if known else {}
        assert list(one.run(40)) == []
        one.rig.sp = 5.0
    whole = next(at_once.run(100))
    step = step_until(stand, decision=True)
    assert step.question is not None
    assert (step.decision.code, step.decision.action, step.decision.number) == ("undo_runaway", Action.RESTORE, 2)
    assert (step.decision.gains_before, step.decision.gains_after) == (NEW, GOOD)
    assert (stand.retuner.table.gains, stand.retuner.region_models) == ((GOOD,), {})
    for sample in stand.rig.run(5):
        assert stand.retuner.step(sample) == (None, None)
    assert stand.retuner.restored() == (0,)
    late = stand.retuner.enter(step.question, decide(step.question), stand.retuner.sample_number)
    assert (late.number, late.action) == (3, Action.NONE)
    assert late.to_dict()["estimate"] == whole.to_dict()["estimate"]
    assert late.agreement is whole.agreement is (Agreement.AGREES if known else Agreement.FIRST)
    assert stand.retuner.region_models.keys() == at_once.retuner.region_models.keys() == (set() if known else {0})
    assert stand.retuner.excitation == at_once.retuner.excitation


def test_a_trial_that_ends_meanwhile_overtakes_the_answer() -> None:
    stand = Stand(GOOD)
    stand.rig.sp = 5.0
    question = step_until(stand, question=True).question
    assert question is not None
    assert stand.retuner.abort(TrialEvent.LINK_LOST) is not None
    late = stand.retuner.enter(question, decide(question), stand.retuner.sample_number)
    assert (late.code, late.judgement) == ("overtaken_trial_ended", None)
