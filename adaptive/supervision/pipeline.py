"""What a completed response leads to, a line a stage; each stage may end it with its reason.

    response -> admission -> swing? -> learning -> hidden cause? -> tuning? -> proposal -> proof -> outcome

Pure functions over one `ResponseRecord`: everything that the outcome depends on is in it. The Retuner keeps what was
learned.
"""

from dataclasses import replace

import numpy as np

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.oscillation_online import Standing, goes_on, hidden_cause, swing_cause, swings
from retuner.adaptive.diagnosis.second_opinion import (
    SWINGING,
    TOWARDS_SAFETY,
    Excitation,
    calm_before,
    is_clear,
    is_safer_and_known,
    on_top,
    runs_away,
    thinned,
    unconfirmed,
)
from retuner.adaptive.diagnosis.swing_checks import (
    FOREIGN_SWINGS,
    at_own_crossover,
    not_seen,
    swings_anyway,
    touches_limits,
)
from retuner.adaptive.guard import Verdict, prove
from retuner.adaptive.region_model.from_neighbours import borrowed
from retuner.adaptive.region_model.region_model import Belief
from retuner.adaptive.region_model.update import ANEW, Learned, Surprise, learn, predicted
from retuner.adaptive.supervision.admission import Admission, Ground, admit, inside_region
from retuner.adaptive.supervision.decision import Basis
from retuner.adaptive.supervision.guard_request import change_request, unproved_request
from retuner.adaptive.supervision.on_trial import may_follow, posterior_of, promise_of
from retuner.adaptive.supervision.pipeline_types import Question, ResponseRecord, StageResult
from retuner.adaptive.supervision.proposal_from_model import RobustProposal, propose
from retuner.adaptive.supervision.proposal_without_model import without_model
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.adaptive.trial.phase import TrialPhase
from retuner.schedule.table import Lookup

FOREIGN = frozenset({Cause.EXTERNAL, Cause.STICTION, Cause.NOISE, Cause.SATURATION})
"""Causes that leave nothing in a record from which the process could be learned."""


NOT_KNOWN = "not_identifiable"
"""Code: what is known of the process does not carry settings yet."""


def decide(question: Question) -> StageResult:
    """The answer to a question: a pure function, so another process may work it out.

    What is asked of it beyond the pipeline is what entering the answer needs and what costs time: the promise of gains
    that may be written, and what the record says of both sets of a trial under which it was taken.
    """
    record, trial, settings = question.record, question.trial, question.settings
    result = answer(record, settings)
    promise, posterior = None, None
    if result.verdict is not None and result.verdict.accepted and may_follow(trial, settings.trial):
        promise = promise_of(result, record.table, record.region, record.at, record.response, settings)
    if trial.phase is TrialPhase.TRIAL and result.code != Ground.SATURATED.name.lower():
        posterior = posterior_of(record, result.learned, trial, settings)
    return replace(result, promise=promise, posterior=posterior)


def answer(case: ResponseRecord, settings: RetunerSettings) -> StageResult:
    """The pipeline."""
    if case.table.lookup == Lookup.INTERPOLATED:
        settings = replace(settings, swing=replace(settings.swing, same_gains=False))
    admission = _admission(case, settings)
    if not admission.admitted:
        return StageResult(
            admission.ground.name.lower(),
            admission.sentence,
            diagnosis=admission.diagnosis(),
            numbers=admission.numbers,
        )
    cause, standing = _swing(case, settings)
    if cause is not None:
        return StageResult(str(cause.cause), cause.reason, diagnosis=cause, standing=standing)
    waiting = thinned(case.response, case.excitation, settings.swing)
    if waiting is not None:
        counted = case.excitation.with_response(case.response)
        return StageResult("waiting", waiting.reason, diagnosis=waiting, excitation=counted)
    return _learned(case, settings)


def _swing(case: ResponseRecord, settings: RetunerSettings) -> tuple[Diagnosis | None, Standing | None]:
    """Why the loop swings on without a setpoint step, where that is none of tuning."""
    again = goes_on(case.response, case.standing, settings.swing) or on_top(
        case.samples, case.response, case.standing, settings.swing
    )
    if again is not None:
        return again, case.standing
    if not swings(case.response, settings.swing):
        return None, None
    cause, standing = swing_cause(case.samples, case.response, case.in_force, settings.swing, settings.diagnosis)
    return (None, None) if _held_up(case, cause, settings) else (cause, standing)


def _held_up(case: ResponseRecord, cause: Diagnosis | None, settings: RetunerSettings) -> bool:
    """Whether a swing taken for one from outside is held up by the output's limits: then the model decides."""
    if cause is None or cause.cause not in FOREIGN_SWINGS:
        return False
    return touches_limits(case.samples, case.response, settings.limit_swing)


def _learned(case: ResponseRecord, settings: RetunerSettings) -> StageResult:
    """Learning, unless something else hides under the response; then what is known decides."""
    try:
        known = case.beliefs.get(case.region) or _lent(case, settings)
        learned = learn(known, case.window, case.in_force, settings.tracker, settings.fit, case.at)
    except np.linalg.LinAlgError as error:  # a record that breaks the arithmetic must not break the supervision
        return StageResult("fit_failed", f"the fit failed: {error}")
    left = learned.estimate.unexplained(float(np.ptp(case.window.pv)))
    if left > settings.swing.unexplained:
        hidden, standing = hidden_cause(case.samples, case.response, case.in_force, settings.swing, settings.diagnosis)
        if hidden is not None and not _held_up(case, hidden, settings):
            return StageResult(str(hidden.cause), hidden.reason, learned, diagnosis=hidden, standing=standing)
    if learned.belief is None:
        counted = case.excitation.with_response(case.response)
        return _without_model(case, learned, left, learned.estimate.reason, counted, settings)
    return _weighed(case, learned, _known_of_limit_swing(case, settings) or learned.belief, left, settings)


def _known_of_limit_swing(case: ResponseRecord, settings: RetunerSettings) -> Belief | None:
    """What was known, of a loop that swings between the output's limits as was known that it would; else None.

    Such a swing shows one frequency, through a nonlinearity. Taken in record by record, it led away from a process
    that its setpoint steps had shown well.
    """
    before = case.beliefs.get(case.region)
    if before is None or not before.identifiable:
        return None
    if not touches_limits(case.samples, case.response, settings.limit_swing):
        return None
    log = predicted(before, float(case.window.t_s[-1]), settings.tracker)
    return before if propose(before, log, case.in_force, settings).diagnosis.cause in SWINGING else None


def _lent(case: ResponseRecord, settings: RetunerSettings) -> Belief | None:
    """What the neighbours' models say of a region without a record."""
    now, sign = float(case.window.t_s[-1]), case.in_force.direction
    return borrowed(case.beliefs, case.region, case.table.regions, now, sign, settings.borrowing, settings.tracker)


def _weighed(
    case: ResponseRecord, learned: Learned, belief: Belief, left: float, settings: RetunerSettings
) -> StageResult:
    """What is known decides; before gains change, a case that is not clear is put to the whole diagnosis."""
    known = _rested_on(case.excitation, learned.surprise)
    clear = is_clear(case.samples, case.response, left, len(learned.estimate.load_times_s), settings.swing)
    excitation = known.with_response(case.response, clear=clear)
    if learned.surprise == Surprise.ODD:
        excitation = replace(excitation, rival=int(clear))
    log = predicted(belief, float(case.window.t_s[-1]), settings.tracker)
    wanted = propose(belief, log, case.in_force, settings)
    if not wanted.ready:
        unsettled = _without_model(case, learned, left, belief.reason, excitation, settings)
        return replace(unsettled, belief=belief, excitation=unsettled.excitation or excitation)
    outcome = _tuned(case, learned, belief, wanted, settings)
    if outcome.verdict is None or not outcome.verdict.accepted:
        return replace(outcome, belief=belief, excitation=excitation)
    doubt = _not_seen(case, outcome, settings)
    if doubt is not None:  # a model that is this record's own was not known before: what was known then stays
        swings_by_it = outcome.diagnosis is not None and outcome.diagnosis.cause in SWINGING
        refuted = learned.surprise not in ANEW and swings_by_it
        return StageResult("unconfirmed", doubt.reason, learned, None, doubt, outcome.proposal, forget=refuted)
    if clear or _is_sure(case, outcome.verdict, learned, belief, known, settings):
        return replace(outcome, belief=belief, excitation=excitation)
    earlier = _was_known(case, learned, known, settings)
    if earlier is not None:
        return replace(earlier, belief=belief, excitation=excitation)
    return _asked(case, learned, belief, outcome, excitation, settings)


def _asked(
    case: ResponseRecord,
    learned: Learned,
    belief: Belief,
    outcome: StageResult,
    excitation: Excitation,
    settings: RetunerSettings,
) -> StageResult:
    """A change that the whole diagnosis has to confirm."""
    wanted_for = outcome.diagnosis.cause if outcome.diagnosis else None
    doubt, excitation = unconfirmed(
        case.samples, case.response, case.in_force, excitation, settings.swing, settings.diagnosis, wanted_for
    )
    if doubt is None:
        return replace(outcome, belief=belief, excitation=excitation)
    taken = None if doubt.cause in FOREIGN else belief
    if taken is None and learned.surprise in ANEW:  # what was known before stays, and what that rested on
        counted = case.excitation.with_response(case.response)
        excitation = replace(counted, asked=counted.loads)
    return StageResult("unconfirmed", doubt.reason, learned, taken, doubt, outcome.proposal, excitation=excitation)


def _rested_on(excitation: Excitation, surprise: Surprise) -> Excitation:
    """What the model rested on before this response."""
    if surprise == Surprise.CHANGED:
        return excitation.of_rival()
    return Excitation() if surprise in ANEW else excitation


def _is_sure(
    case: ResponseRecord,
    verdict: Verdict,
    learned: Learned,
    belief: Belief,
    known: Excitation,
    settings: RetunerSettings,
) -> bool:
    """Whether a change by a response that is not clear needs no confirmation (see diagnosis/confirmation.py).

    known : what the model rested on before it: to agree with loads that were never confirmed proves nothing.
    """
    swing = settings.swing
    seen = (case.samples, case.response)
    if runs_away(*seen, learned.estimate.explained, swing):
        return True
    calm, agrees = calm_before(*seen, swing), learned.surprise == Surprise.AGREES
    if is_safer_and_known(verdict.ruling, agrees, known, calm, len(case.response.peaks)):
        return True
    model = belief.log.model().seen_by_controller(settings.sample_time_s)
    return (
        verdict.ruling in TOWARDS_SAFETY
        and touches_limits(case.samples, case.response, settings.limit_swing)
        and at_own_crossover(case.response, model, case.in_force, settings.limit_swing)
    )


def _not_seen(case: ResponseRecord, outcome: StageResult, settings: RetunerSettings) -> Diagnosis | None:
    """Why the loop does not swing as the model says, if so; at the output's limits no linear model can say."""
    found, allowed, swing = outcome.diagnosis, outcome.verdict.allowed if outcome.verdict else (), settings.swing
    if found is None or not allowed:
        return None
    if any(sample.limited for sample in case.samples if sample.t_s >= case.response.t_start_s):
        return None
    reason = swings_anyway(case.response, swing) if found.cause == Cause.SLUGGISH else ""
    if found.cause in SWINGING:
        model = allowed[0].model.seen_by_controller(settings.sample_time_s)
        reason = not_seen(case.response, model, case.in_force, settings.setpoint_weight, settings.filter_s, swing)
    return Diagnosis(Cause.UNKNOWN, 0.5, found.evidence, reason) if reason else None


def _was_known(
    case: ResponseRecord, learned: Learned, known: Excitation, settings: RetunerSettings
) -> StageResult | None:
    """The change that was known to be due before this response, by a clear case with which it agrees; None when none.

    known : what the earlier model rests on.
    """
    before = case.beliefs.get(case.region)
    if before is None or not known.clear or learned.surprise != Surprise.AGREES:
        return None
    wanted = propose(before, predicted(before, float(case.window.t_s[-1]), settings.tracker), case.in_force, settings)
    if not before.identifiable:
        return None
    outcome = _tuned(case, learned, before, wanted, settings)
    return outcome if outcome.verdict is not None and outcome.verdict.accepted else None


def _tuned(
    case: ResponseRecord, learned: Learned, belief: Belief, wanted: RobustProposal, settings: RetunerSettings
) -> StageResult:
    """Whether the tuning is the cause, what the rule would give, and the proof."""
    tuning, diagnosis = wanted.tuning, wanted.diagnosis
    if not diagnosis.retune:
        return StageResult(str(diagnosis.cause), diagnosis.reason, learned, diagnosis=diagnosis)
    beliefs, now = {**case.beliefs, case.region: belief}, float(case.window.t_s[-1])
    tables = (case.table, case.commissioned)
    damping = case.response.damping
    asked = change_request(tuning, case.region, tables, beliefs, learned, now, settings, damping)
    verdict = prove(asked, settings.guard)
    return StageResult(
        verdict.ruling.name.lower(),
        diagnosis.reason if verdict.accepted else verdict.sentence,
        learned,
        diagnosis=diagnosis,
        proposal=tuning,
        basis=Basis.MODEL,
        verdict=verdict,
    )


def _without_model(
    case: ResponseRecord, learned: Learned, left: float, why: str, excitation: Excitation, settings: RetunerSettings
) -> StageResult:
    """Not identifiable: a small step by the rules that need no model, where nothing but the tuning can be behind it.

    excitation : of what is known, with this response.
    """
    found = without_model(
        case.response, case.window, case.in_force, None, settings.without_model, settings.locks_of(case.region)
    )
    reason = f"{why}; {found.sentence}"
    silent = learned.surprise == Surprise.SILENT and not case.response.sp_changed  # noise has peaks as well
    if found.tuning is None or silent:
        return StageResult(NOT_KNOWN, reason, learned, numbers=found.numbers)
    stored = case.table.stored_for(case.region, found.tuning.gains, *case.at)
    if stored is None:
        return StageResult(
            NOT_KNOWN,
            f"{reason}; beside its neighbours' no set of this region puts that in force",
            learned,
            numbers=found.numbers,
        )
    tuning = replace(found.tuning, gains=stored)
    if not is_clear(case.samples, case.response, left, len(learned.estimate.load_times_s), settings.swing):
        doubt, excitation = unconfirmed(
            case.samples, case.response, case.in_force, excitation, settings.swing, settings.diagnosis
        )
        if doubt is not None:
            return StageResult("unconfirmed", doubt.reason, learned, None, doubt, tuning, excitation=excitation)
    tables = (case.table, case.commissioned)
    verdict = prove(unproved_request(tuning, case.region, tables, settings, case.response.damping), settings.guard)
    return StageResult(
        verdict.code,
        reason if verdict.accepted else verdict.sentence,
        learned,
        proposal=tuning,
        basis=found.basis,
        verdict=verdict,
        excitation=excitation,
        numbers=found.numbers,
    )


def _admission(case: ResponseRecord, settings: RetunerSettings) -> Admission:
    """Whether the response may teach its region. The gains of an interpolated table move with it; the fit allows it."""
    rules = settings.admission
    if case.table.lookup == Lookup.INTERPOLATED:
        rules = replace(rules, changes_most=len(case.samples))
    return admit(case.window, case.samples, case.response, rules, inside_region(case.table.regions, case.region))
