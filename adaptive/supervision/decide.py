"""One decision, from the record of a response to the gains that win. Each step stands in the file beside it.

    findings_of          what does the record say, and what does its region know with it?        findings.py
    without_a_model,     what follows from that: a proposal (region_proposal.py), its proof, is  by_model.py
    by_model             it worth its risk, and is it sure?
    gains_that_win       of what follows from the model, the set before and all samples: which   here, by_book.py
                         gains win, and why?
    expectation,         what are these gains held to, what does a trial's record say of both    judge_evidence.py
    check_after_trial    sets?
    elsewhere            where nothing changes here: what is due in other regions?               other_regions.py

The book of a region says how likely each process is by all samples up to now (explanations/book.py). The retuner
raises the question, and enters the outcome as a decision, where mode and trial allow a change (retuner.py). The session
hands its gains to the writer (loop_session.py, gain_writer.py). All that the outcome depends on is in the question, so
another process may work it out.
"""

from dataclasses import replace

from retuner.adaptive.decision_numbers import NO_NUMBERS, Basis
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.oscillation_online import alike_on_both_sides, through_a_change
from retuner.adaptive.guard import prove
from retuner.adaptive.guard.request import Support
from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.by_book import LOOKED, all_samples, objection, proposal_by_book, robust_by_book
from retuner.adaptive.supervision.by_model import by_model, without_a_model
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import Findings, findings_of
from retuner.adaptive.supervision.judge_evidence import beside_walk, may_follow, posterior_of, prediction_of_proof
from retuner.adaptive.supervision.other_regions import elsewhere
from retuner.adaptive.supervision.question import OTHER_LOOP, Question, not_evaluated
from retuner.adaptive.supervision.region_proposal import KnownProcesses, known_of, unproved_request
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.rollback import LOST_WORDS, NOTHING_KNOWN, less_stable
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains
from retuner.schedule.table import Lookup


def decide(question: Question) -> Outcome:
    """The answer to a question: a pure function of plain values.

    Whatever a step raises closes the question: nothing is learned or changed, and the answer says why.

    Raises MemoryError: that hangs on the machine, not on the question.
    """
    try:
        outcome = _decided(question)
        outcome = replace(outcome, code=OTHER_LOOP) if question.spoilt else outcome
        return question.after(question, outcome) if question.after else outcome
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001  a record that breaks one step must not end the supervision
        return not_evaluated(_step_of(error), error)


def _decided(question: Question) -> Outcome:
    """The decision; read it from the top."""
    if question.alone or question.spoilt:  # no response to judge: nothing but all samples
        found = Findings(question)
        code, reason = (OTHER_LOOP, question.spoilt) if question.spoilt else (LOOKED, "no response to judge")
        return expectation(found, gains_that_win(found, found.outcome(code, reason)))
    found = findings_of(question)
    own = found.ended or without_a_model(found) or by_model(found)
    winner = gains_that_win(found, own)
    winner = expectation(found, winner)
    winner = check_after_trial(found, winner)
    return replace(winner, elsewhere=elsewhere(found, winner))


def gains_that_win(found: Findings, own: Outcome) -> Outcome:
    """Which gains win, and why: the one place that chooses between the model's, the set before and all samples'.

    1. Those that follow from the response, with the models of its region.
    2. Where a tone goes on through the last change to less action: the set that ran before it.
    3. None, where the book of all samples speaks against these.
    4. Those of the book, where there are none by now, and it is one to ask.
    """
    winner = set_before(found, own) or own
    seen = all_samples(found, winner)
    if winner.changes:
        winner = objection(found, winner, seen) or winner
    if not winner.changes:
        winner = proposal_by_book(found, winner, seen) or winner
    return seen.entered(winner)


def set_before(found: Findings, own: Outcome) -> Outcome | None:
    """The set that ran before, on trial, where less action was the answer to a tone from outside; else None.

    own : what the response leads to by itself.

    Less action was written because a model said that the loop swings by itself. A tone that goes on through that change
    as it was before, and that no process explains under both sets, refutes the model: the swing was not the loop's own.
    What a clear setpoint step has shown of the process is not refuted so. As for every way back
    (trial/rollback.py): where the models that are still allowed call that set less stable, it stays out.
    """
    record, trial, cause = found.record, found.question.trial, own.diagnosis
    if cause is None or cause.cause is not Cause.EXTERNAL or trial.phase is not TrialPhase.IDLE or record.crossed:
        return None
    before = _cut_from(trial, record.in_force, found.settings.trial.harmless_decay)
    if before is None or record.excitation.clear or record.table.lookup is Lookup.INTERPOLATED:
        return None
    settings = found.settings
    here = [sample for sample in record.samples if sample.t_s >= record.entered_s]
    period_s = through_a_change(here, record.in_force, settings.diagnosis)
    if period_s is None or found.growth is not None or not alike_on_both_sides(here, period_s, record.response.band):
        return None
    now_s = float(record.window.t_s[-1])
    known = known_of(KnownProcesses(record.table, record.region_models, now_s, settings), record.region)
    if known.processes:
        kept_out = less_stable(before, record.in_force, known, settings.trial.harmless_ms)
    else:
        kept_out = LOST_WORDS if trial.sets.lost else ""
    if kept_out:
        return replace(own, code="tone_goes_on", reason=found.words(NOT_BACK.format(period=period_s, why=kept_out)))
    tuning, tables = Tuning("set that ran before", "parallel", before), (record.table, record.commissioned)
    request = unproved_request(tuning, record.region, tables, settings)
    request = replace(request, evidence=replace(request.evidence, support=Support.RAN))
    proof = prove(request, settings.guard)
    reason = found.words(REFUTED.format(period=period_s, ruling=proof.sentence))
    told = replace(own, code=proof.code, reason=reason, forget=True, region_model=None, excitation=None)
    if not proof.accepted:
        return told
    return replace(told, proposal=tuning, proof=proof, basis=Basis.RAN, numbers=NO_NUMBERS)


NOT_BACK = (
    "the oscillation of {period:.3g} s goes on as before the last change, so it comes from outside. The previous gains "
    "do not come back: {why}. A setpoint step would show the process"
)
"""The reason where a tone goes on, and the way back is closed."""
REFUTED = (
    "the oscillation of {period:.3g} s goes on as before the last change. No process explains it under both gain sets, "
    "so it comes from outside and less action was no cure; {ruling}"
)
"""The reason where a cut is rolled back."""


def _cut_from(trial: Trial, in_force: PidGains, harmless_decay: float) -> PidGains | None:
    """The newest set that ran before and acted more, where the last change was less action against a swing."""
    if trial.prediction is None or trial.new != in_force:
        return None
    said = trial.prediction
    swung = max(said.decay_before(setpoint=True), said.decay_before(setpoint=False), said.decay_seen or 0.0)
    if said.models and swung <= harmless_decay:
        return None
    ran = (gains for gains in trial.earlier if gains != in_force and less_of_everything(gains, in_force))
    return next(ran, None)


def expectation(found: Findings, winner: Outcome) -> Outcome:
    """What do the proved gains predict, where they may be written at all?"""
    follows = winner.changes and may_follow(found.question.trial, found.settings)
    if winner.proof is None or winner.prediction is not None or not follows:
        return winner
    return replace(winner, prediction=prediction_of_proof(found, winner.proof))


def check_after_trial(found: Findings, winner: Outcome) -> Outcome:
    """Of a response under gains on trial: what does its record say of them and of those before?"""
    record, learned, trial, settings = found.record, found.learned, found.question.trial, found.settings
    if trial.phase is not TrialPhase.TRIAL:
        return winner
    if winner.code != Ground.SATURATED.name.lower():
        winner = replace(winner, posterior=posterior_of(record, learned, trial, settings))
    if robust_by_book(found, winner):
        return replace(winner, beside_walk=NOTHING_KNOWN)
    model = winner.region_model or record.region_models.get(record.region)
    known = model.plausible if model is not None else ()
    against = learned.estimate.plausible if learned is not None and winner.posterior is not None else known
    return replace(winner, beside_walk=beside_walk(record, against or known, trial, settings))


def _step_of(error: BaseException) -> str:
    """Name of the step in which an error was raised: what the story called."""
    names, at = list[str](), error.__traceback__
    while at is not None:
        names.append(at.tb_frame.f_code.co_name)
        at = at.tb_next
    return next((name for name in names if name not in STORY), names[-1]).replace("_", " ")


STORY = ("decide", "_decided", "findings_of", "gains_that_win", "by_model")  # functions that only call the steps
