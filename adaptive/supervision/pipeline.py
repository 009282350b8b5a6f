"""What a completed response leads to, a stage at a time; each may end it with its reason.

The stages stand in STAGES, in the order of developers/how-it-works.md. They are functions over one Findings: all that
the result depends on is in its Question, so another process may work it out. The Retuner keeps what was learned.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from retuner.adaptive.decision_numbers import NO_NUMBERS, Basis
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.second_opinion import SWINGING, from_rest_to_rest
from retuner.adaptive.guard import prove
from retuner.adaptive.identification.structure_choice import too_few
from retuner.adaptive.region_model.boundary_crossing import (
    Crossing,
    fitted_crossing,
    taught_beside,
    update_across,
    ways_of,
)
from retuner.adaptive.region_model.from_neighbours import as_wide_as_known, borrowed
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import ANEW, Agreement, Learned, on_the_way, update_region_model
from retuner.adaptive.signals.growth import grows
from retuner.adaptive.signals.sample import LoopMode
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.by_book import by_all_samples, robust_by_book
from retuner.adaptive.supervision.causes import (
    NOT_CONFIRMED,
    NOT_THE_LOOP,
    above_noise,
    basis_of,
    beside_sequences,
    by_sequences,
    doubt_of,
    exempt_from_confirmation,
    hidden,
    in_danger,
    is_known,
    joined_step_sequence,
    known_of_swing,
    not_as_modelled,
    one_more_other_cause,
    stands,
    swing_by_other_cause,
    unambiguous,
    wanted_of,
    wrong_way,
)
from retuner.adaptive.supervision.judge_evidence import beside_walk, may_follow, posterior_of, prediction_of_verdict
from retuner.adaptive.supervision.open_loop_unstable import cut_refuted, runaway
from retuner.adaptive.supervision.other_regions import elsewhere
from retuner.adaptive.supervision.pipeline_types import (
    OTHER_LOOP,
    Findings,
    Question,
    ResponseRecord,
    StageResult,
    admitted,
    not_evaluated,
)
from retuner.adaptive.supervision.proof_and_choice import chosen, lost_on_all, proved, unproved_request
from retuner.adaptive.supervision.proposal_from_model import RobustProposal, too_bold
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.rollback import NOTHING_KNOWN, StillAllowed
from retuner.adaptive.without_model.proposal_without_model import Proposed, without_model

NOT_KNOWN = "not_identifiable"
"""Code: what is known of the process does not carry settings yet."""


def decide(question: Question) -> StageResult:
    """The answer to a question: a pure function of plain values.

    Whatever a stage raises closes the question: nothing is learned or changed, and the answer says why.

    Raises
    ------
    MemoryError
        That hangs on the machine, not on the question.
    """
    found, name = Findings(question), ""
    if question.spoilt:
        found.stop(OTHER_LOOP, question.spoilt)
    try:
        for stage in STAGES:
            name = stage.name
            if question.alone:
                due = stage.alone
            else:
                due = found.end is None or stage.always
            if due:
                stage.run(found)
        result = replace(found.result(), code=OTHER_LOOP) if question.spoilt else found.result()
        return question.after(question, result) if question.after else result
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001  a record that breaks one stage must not end the supervision
        return not_evaluated(name, error)


WRONG_WAY = "wrong_way"
"""Code: the controller acts the wrong way, which no gains of its sign can cure."""


def action(found: Findings) -> None:
    """Does what the controller does against an error make it grow?"""
    if found.record.samples[-1].mode != LoopMode.AUTO:
        return
    wrong = wrong_way(found)
    if wrong is not None:
        found.diagnosis = wrong
        found.stop(WRONG_WAY, wrong.reason)


def admission(found: Findings) -> None:
    """May this response teach its region?"""
    record = found.record
    if found.steps is not None:  # co followed its law from sample to sample: nothing is missing or at a limit
        return
    refused = admitted(record, found.settings)
    if refused.admitted:
        return
    found.diagnosis, found.numbers, reason = refused.diagnosis(), refused.numbers, refused.sentence
    if refused.ground is Ground.SETPOINT_LED and record.passed_over:
        found.numbers = replace(refused.numbers, passed_over=float(record.passed_over))
        reason = f"{reason}; {record.passed_over} such responses were skipped since the last report"
    found.stop(refused.ground.name.lower(), reason)


def swing(found: Findings) -> None:
    """Is a swing without a setpoint step, or what had another cause before, still due to none of tuning?"""
    record, settings = found.record, found.settings
    if record.crossed:
        return
    found.growth = grows(record.samples, record.response.band, settings.growth)
    foreign = swing_by_other_cause(found)
    if foreign is not None:
        found.explained_otherwise(foreign)


def identification(found: Findings) -> None:
    """The record is taken into what is known of the region, or of its neighbours where nothing is."""
    if found.steps is None and (short := too_few(found.record.window)):
        found.stop(NOT_KNOWN, short)
        return
    learned = by_sequences(found) if found.steps is not None else _by_itself(found)
    if learned is None:
        found.stop(NOT_KNOWN, "no model explains how pv follows the setpoint")
        return
    found.learned = learned = beside_sequences(found, learned)
    found.unexplained = learned.estimate.unexplained(float(np.ptp(found.record.window.pv)))
    if learned.valve is not None:  # what the loop by itself leaves open
        found.unexplained = max(found.unexplained, learned.valve.left)


def _by_itself(found: Findings) -> Learned:
    """What one response as it came teaches."""
    record = found.record
    known = record.region_models.get(record.region) or _from_neighbours(record, found.settings)
    return _across(found, known) if record.crossed else _inside(found, known)


def _inside(found: Findings, known: RegionModel | None) -> Learned:
    """What a response teaches the region in which it began and ended.

    The farther it went, the less one linear model of it says of the region. One that went far is fitted in motion
    first. Where that does not agree with what is known, or does not settle it, it is judged as any other: the process
    may have changed in time.
    """
    record, settings = found.record, found.settings
    if record.moved:
        learned = _across(found, known)
        settled = learned.region_model is not None and learned.region_model.identifiable
        if settled and learned.agreement in {Agreement.FIRST, Agreement.AGREES}:
            return learned
    tracker = on_the_way(settings.tracker, record.share)
    learned = update_region_model(known, record.window, record.in_force, tracker, settings.fit, record.at)
    return as_wide_as_known(learned) if record.share else learned


def _across(found: Findings, known: RegionModel | None) -> Learned:
    """What a response teaches the region in which it ended, and those that it came through."""
    record, settings = found.record, found.settings
    crossing = Crossing(
        record.window,
        ways_of(record.table.regions, list(record.samples)[-len(record.window.t_s) :]),
        record.response.t_start_s,
        record.in_force,
        record.table.regions,
        record.region_models,
        settings.tracker,
        settings.fit,
    )
    shown = fitted_crossing(crossing)
    found.beside = taught_beside(crossing, shown, record.region)
    return update_across(crossing, shown, record.region, known)


def _from_neighbours(record: ResponseRecord, settings: RetunerSettings) -> RegionModel | None:
    """What the neighbours' models say of a region without a record."""
    now, sign = float(record.window.t_s[-1]), record.in_force.direction
    regions = record.table.regions
    return borrowed(record.region_models, record.region, regions, now, sign, settings.borrowing, settings.tracker)


def hidden_cause(found: Findings) -> None:
    """Does something else hide under the response, which its model leaves open?"""
    foreign = None if found.record.crossed else hidden(found)
    if foreign is not None:
        found.explained_otherwise(foreign)


def region_model(found: Findings) -> None:
    """What is known of the region now, what it rests on, and what tuning would follow from it."""
    record, settings, learned = found.record, found.settings, _learned(found)
    found.excitation_now = record.excitation.with_response(record.response)
    if learned.region_model is None:
        return
    swinging = None if record.crossed or found.steps is not None else known_of_swing(record, settings)
    found.in_use = found.region_model = swinging or learned.region_model
    found.excitation_before = record.excitation if swinging else basis_of(record, learned.agreement)
    found.clear = unambiguous(found, learned)
    now = found.excitation_before
    if not swinging and learned.agreement != Agreement.SILENT:  # what cannot tell is nothing that a model rests on
        rested = from_rest_to_rest(record.samples, record.response, settings.swing)
        now = now.with_response(record.response, clear=found.clear, rested=rested)
    if learned.agreement == Agreement.CONTRADICTS:
        now = replace(now, alternative=int(found.clear))
    now = replace(now, lost=0)  # until the proof says otherwise
    found.excitation = found.excitation_now = now
    found.tuning = wanted_of(record, found.in_use, settings)


def _of_two_sets(why: str, *, crossed: bool) -> str:
    """Why a pattern tells nothing; why : what is said before."""
    came = "crossed a boundary" if crossed else "began under other gains"
    return f"two sets of gains shaped this response{'' if came in why else f', because it {came}'}"


def without_a_model(found: Findings) -> None:
    """A small step by rules that need no model, where nothing is identified and only the tuning can be behind it."""
    if found.tuning is not None and found.tuning.ready and (_in_use(found).identifiable or above_noise(found)):
        return
    record, learned = found.record, _learned(found)
    if found.steps is not None:
        found.stop(NOT_KNOWN, learned.estimate.reason)
        return
    why = found.in_use.reason if found.in_use is not None else learned.estimate.reason
    if record.pattern is None:
        found.stop(NOT_KNOWN, f"{why}; {_of_two_sets(why, crossed=record.crossed)}")
        return
    locks = found.settings.locks_of(record.region)
    own = _own_fault(found)
    proposed = without_model(record.response, record.window, record.in_force, own, found.settings.without_model, locks)
    reason, found.numbers = f"{why}; {proposed.sentence}", proposed.numbers
    silent = learned.agreement == Agreement.SILENT and not record.response.sp_changed  # noise has peaks as well
    if proposed.tuning is None or silent:
        found.stop(NOT_KNOWN, reason)
        return
    stored = record.table.stored_for(record.region, proposed.tuning.gains, *record.at)
    if stored is None:
        found.stop(NOT_KNOWN, f"{reason}; no gains of this region give that next to its neighbours'")
        return
    after = record.table.with_gains(record.region, stored).at(record.region, *record.at)
    bold = too_bold((found.in_use or learned.estimate).plausible, record.in_force, after, found.settings)
    if bold:
        found.stop(NOT_KNOWN, f"{reason}; not done: {bold}")
        return
    found.proposal = replace(proposed.tuning, gains=stored)
    _small_step(found, proposed, learned, reason)


def _own_fault(found: Findings) -> Diagnosis | None:
    """The diagnosis of a swing that grows; None of any other."""
    growth = found.growth
    if growth is None:
        return None
    found.diagnosis = Diagnosis(Cause.AGGRESSIVE, 0.9, growth.to_dict(), growth.sentence)
    return found.diagnosis


def _small_step(found: Findings, proposed: Proposed, learned: Learned, reason: str) -> None:
    """Whether the step without a model is made."""
    record, excitation = found.record, found.excitation_now
    if found.growth is None and not unambiguous(found, learned):
        doubt = doubt_of(found)
        if doubt is not None:
            found.excitation, found.numbers = excitation, NO_NUMBERS
            one_more_other_cause(found, doubt)
            found.doubted(replace(doubt, reason=f"{reason}; {doubt.reason}"))
            return
    found.excitation, found.basis = excitation, proposed.basis
    assert found.proposal is not None
    tables, damping = (record.table, record.commissioned), record.response.damping
    request = unproved_request(found.proposal, record.region, tables, found.settings, damping)
    found.verdict = prove(request, found.settings.guard)
    found.stop(found.verdict.code, reason if found.verdict.accepted else found.verdict.sentence)


def cause(found: Findings) -> None:
    """Is the tuning in force the cause?"""
    found.diagnosis = told = _wanted(found).diagnosis
    if told.retune:
        return
    if _learned(found).agreement is Agreement.CONTRADICTS:
        reason = f"by what is known of the region, {told.reason}; this response {Agreement.CONTRADICTS}"
        found.doubted(Diagnosis(Cause.UNKNOWN, 0.5, told.evidence, reason))
        return
    found.stop(str(told.cause), told.reason)


def proof(found: Findings) -> None:
    """May the region have the gains that the rule gives?"""
    wanted = _wanted(found)
    found.verdict = proved(found, _in_use(found), wanted)
    found.proposal, found.basis = wanted.tuning, Basis.MODEL
    if lost_on_all(found.verdict.allowed, found.record.in_force, found.settings):
        lost = found.record.excitation.lost + 1
        found.excitation = found.excitation_now = replace(found.excitation_now, lost=lost)
    if not found.verdict.accepted:
        found.stop(found.verdict.ruling.name.lower(), found.verdict.sentence)


def refutation(found: Findings) -> None:
    """Does the loop itself refute the model: is what it says of the swing not to be seen?"""
    doubt = not_as_modelled(found)
    if doubt is None:
        return
    swings_by_it = found.diagnosis is not None and found.diagnosis.cause in SWINGING
    found.forget = _learned(found).agreement not in ANEW and swings_by_it
    found.region_model = found.excitation = None  # the record's own model was not known before: that stays
    found.doubted(doubt)


def worth(found: Findings) -> None:
    """Is the change expected to cost less than staying, over all models and something else?

    Weighed are the proved change and steps on its way (choice/expected_cost.py).
    """
    if found.verdict is None or not found.verdict.accepted:
        return
    choice, verdict = chosen(found, _in_use(found), _wanted(found), found.verdict)
    found.numbers = choice.numbers
    if choice.index == 0:
        found.verdict = found.basis = None
        found.stop(ONE_RECORD if choice.waits else NOT_WORTH, choice.reason)
        return
    found.verdict, found.expected = verdict, choice.reason
    found.prediction = prediction_of_verdict(found, verdict)


ONE_RECORD = "one_record"
"""Code: a second record that agrees would make the change worth it."""
NOT_WORTH = "not_worth"
"""Code: the gains in force are expected to cost no more, or hardly more, than others."""


def confirmation(found: Findings) -> None:
    """A case that is not clear is put to the whole diagnosis before gains change, unless the change is sure anyway.

    None is clear where pv stands while the output travels.
    """
    learned, verdict, wanted = _learned(found), found.verdict, _wanted(found)
    assert verdict is not None
    if found.record.crossed and not (found.clear or is_known(found, learned)):
        found.verdict = found.basis = None
        found.stop("unconfirmed", "the response crossed a boundary, and more than the setpoint may be behind it")
        return
    sure = found.clear or is_known(found, learned) or exempt_from_confirmation(found, verdict, learned, _in_use(found))
    if not sure or stands(found):
        doubt = doubt_of(found, wanted.diagnosis)
        if doubt is not None and not in_danger(found, doubt):
            _not_confirmed(found, doubt)
            return
        _confirmed(found)
    assert found.verdict is not None
    assert found.diagnosis is not None
    found.stop(found.verdict.ruling.name.lower(), f"{found.diagnosis.reason}; {found.expected}")


def _confirmed(found: Findings) -> None:
    """A setpoint response that the whole diagnosis has confirmed is as good as a clear one: what agrees with it later
    needs no second confirmation.
    """
    if found.record.response.sp_changed and found.excitation is not None:
        found.excitation = replace(found.excitation, clear=found.excitation.clear + 1)


def _not_confirmed(found: Findings, doubt: Diagnosis) -> None:
    """The change is not made; a record of something else is not kept either, and counts as one of that."""
    if doubt.cause in NOT_THE_LOOP:
        found.region_model = None
        one_more_other_cause(found, doubt)
        if _learned(found).agreement in ANEW:  # what was known before stays, and what that rested on
            before = found.record.excitation.with_response(found.record.response)
            found.excitation = replace(before, lost=found.excitation_now.lost)
    wanted = found.diagnosis.reason if found.diagnosis is not None else ""
    found.doubted(replace(doubt, reason=NOT_CONFIRMED.format(wanted=wanted, doubt=doubt.reason)))


def expectation(found: Findings) -> None:
    """What the proved gains promise, where they may be written at all."""
    verdict = found.verdict
    if (
        found.prediction is None
        and verdict is not None
        and verdict.accepted
        and may_follow(found.question.trial, found.settings)
    ):
        found.prediction = prediction_of_verdict(found, verdict)


def check_after_trial(found: Findings) -> None:
    """What the record of a trial says of the tried set and of the one before."""
    trial = found.question.trial
    if found.question.spoilt:
        return
    if trial.phase is TrialPhase.TRIAL and found.end is not None and found.end.code != Ground.SATURATED.name.lower():
        found.posterior = posterior_of(found.record, found.learned, trial, found.settings)
    if trial.phase is TrialPhase.TRIAL:
        found.beside_walk = NOTHING_KNOWN if robust_by_book(found) else _beside_walk(found)


def _beside_walk(found: Findings) -> StillAllowed | None:
    """What may speak against the set on trial, beside a load that wanders."""
    record, learned = found.record, found.learned
    model = found.region_model or record.region_models.get(record.region)
    known = model.plausible if model is not None else ()
    against = learned.estimate.plausible if learned is not None and found.posterior is not None else known
    return beside_walk(record, against or known, found.question.trial, found.settings)


def _learned(found: Findings) -> Learned:
    """What the record taught, after the stage of identification."""
    assert found.learned is not None
    return found.learned


def _in_use(found: Findings) -> RegionModel:
    """The model that decides, after the stage without a model."""
    assert found.in_use is not None
    return found.in_use


def _wanted(found: Findings) -> RobustProposal:
    """What follows from the model that decides, after the stage without a model."""
    assert found.tuning is not None
    return found.tuning


class PipelineStage(NamedTuple):
    """name : as in developers/how-it-works.md. run : what it does. always : also when an earlier one has decided."""

    name: str
    run: Callable[[Findings], None]
    always: bool = False
    alone: bool = False


STAGES = (
    PipelineStage("joining", joined_step_sequence),
    PipelineStage("action", action),
    PipelineStage("admission", admission),
    PipelineStage("swing", swing),
    PipelineStage("identification", identification),
    PipelineStage("hidden cause", hidden_cause),
    PipelineStage("region model", region_model),
    PipelineStage("without a model", without_a_model),
    PipelineStage("cause", cause),
    PipelineStage("proof", proof),
    PipelineStage("refutation", refutation),
    PipelineStage("worth", worth),
    PipelineStage("runaway", runaway),
    PipelineStage("confirmation", confirmation),
    PipelineStage("return", cut_refuted, always=True),
    PipelineStage("all samples", by_all_samples, always=True, alone=True),
    PipelineStage("expectation", expectation, always=True, alone=True),
    PipelineStage("check after a trial", check_after_trial, always=True),
    PipelineStage("elsewhere", elsewhere, always=True),
)
"""The stages in their order: what else may be behind the response before the tuning, a proof before any change."""
