"""One decision, from the record of a response to the gains that win. Other steps stand in the file beside them.

    findings_of          what does the record say, what does its region know with it, and what   findings.py
                         settings follow from that?
    without_a_model,     what follows: are these settings proved (guard/proof.py), are they      here,
    by_model             worth their risk (choice/expected_cost.py), and is it sure?             confirmation.py
    gains_that_win       of what follows from the model and from all samples: which gains win,   here,
                         and why?                                                                by_all_samples.py
    expectation,         what are these gains held to, what does a trial's record say of both    judge_evidence.py
    check_after_trial    sets?
    elsewhere            where nothing changes here: what is due in other regions?               other_regions.py

The book of a region says how likely each process is by all samples up to now (explanations/book.py). The retuner
raises the question, and enters the outcome as a decision, where mode and trial allow a change (retuner.py). The session
hands its gains to the writer (loop_session.py, gain_writer.py). All that the outcome depends on is in the question, so
another process may work it out.
"""

import math
from dataclasses import replace

from retuner.adaptive.choice.expected_cost import Choice, Choosable, LoopSettings, ModelEvidence, choose, outlooks
from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.second_opinion import SWINGING
from retuner.adaptive.guard.both_sides_of_boundary import worst_between
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.proof import prove
from retuner.adaptive.guard.ruling import Proof
from retuner.adaptive.guard.step_size import along
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import ANEW, Agreement
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.by_all_samples import (
    LOOKED,
    all_samples,
    objection,
    proposal_by_all_samples,
    refuted_by_trial,
    robust_by_all_samples,
)
from retuner.adaptive.supervision.confirmation import confirmation, counted_cause, doubt_of, refutation, runaway
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import (
    NOT_KNOWN,
    Findings,
    RobustProposal,
    findings_of,
    over_limit,
    too_bold,
    unambiguous,
)
from retuner.adaptive.supervision.judge_evidence import may_follow, posterior_of, prediction_of_proof
from retuner.adaptive.supervision.known_processes import KnownProcesses, change_request, unproved_request
from retuner.adaptive.supervision.other_regions import elsewhere
from retuner.adaptive.supervision.question import OTHER_LOOP, Question, ResponseRecord, not_evaluated
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.prediction import decay_seen
from retuner.adaptive.without_model.proposal_without_model import step_without_model
from retuner.schedule.gains import PidGains


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


ONE_RECORD = "one_record"  # Code: a second record that agrees would make the change worth it
NOT_WORTH = "not_worth"  # Code: the gains in force are expected to cost no more, or hardly more, than others


def by_model(found: Findings) -> Outcome:
    """What follows from the model of the region: cause, proof, refutation, worth, runaway, confirmation."""
    learned, model, wanted = found.learned, found.in_use, found.wanted
    assert learned is not None
    assert model is not None
    assert wanted is not None  # after the findings, where these carry settings
    cause = wanted.diagnosis
    if not cause.retune:  # is the active tuning the cause?
        if learned.agreement is not Agreement.CONTRADICTS:
            return found.outcome(str(cause.cause), cause.reason, cause)
        reason = f"by what is known of the region, {cause.reason}; this response {Agreement.CONTRADICTS}"
        return found.unconfirmed(found.outcome("", ""), Diagnosis(Cause.UNKNOWN, 0.5, cause.evidence, reason))
    proof = proved(found, model, wanted)  # may the region have the gains that the rule gives?
    lost = 0
    if over_limit(proof.allowed, found.record.in_force, found.settings, math.inf, math.inf):
        lost = found.record.excitation.lost + 1
        found = replace(found, excitation=replace(found.excitation_now, lost=lost))
    change = replace(
        found.outcome(proof.code, proof.sentence, cause),
        proposal=wanted.tuning, basis=Basis.MODEL, proof=proof,
    )  # fmt: skip
    if not proof.accepted:
        return change
    if doubt := refutation(found, cause, proof.allowed):  # does the loop itself refute the model?
        forget = learned.agreement not in ANEW and cause.cause in SWINGING
        refuted = found.unconfirmed(change, doubt)
        return replace(refuted, forget=forget, region_model=None, excitation=None)  # what was known before stays
    choice, chosen = worth(found, model, wanted, proof)  # is it expected to cost less than staying?
    if choice.index == 0:
        code, notes = (ONE_RECORD, ()) if choice.waits else (NOT_WORTH, proof.notes)  # a limit may be what makes it so
        reason = found.words("; ".join((choice.reason, *notes)))
        return replace(change, code=code, reason=reason, basis=None, proof=None, numbers=choice.numbers)
    prediction = prediction_of_proof(found, chosen)
    change = replace(change, proof=chosen, numbers=choice.numbers, prediction=prediction)
    if doubt := runaway(found, chosen):  # does the process run away by itself, and would the change hold it worse?
        return found.unconfirmed(change, doubt)
    return confirmation(found, change, chosen, choice.reason, lost)


def without_a_model(found: Findings) -> Outcome | None:
    """A small step by rules that need no model, where nothing is identified and only the tuning can be behind it.

    None where a model carries settings.
    """
    record, learned = found.record, found.learned
    assert learned is not None  # after the identification
    model, wanted = found.in_use, found.wanted
    if model is not None and wanted is not None and wanted.ready and (model.identifiable or _above_noise(found)):
        return None
    if found.steps is not None:
        return found.outcome(NOT_KNOWN, learned.estimate.reason)
    why = model.reason if model is not None else learned.estimate.reason
    if record.pattern is None:
        came = "crossed a boundary" if record.crossed else "began under other gains"
        told = "" if came in why else f", because it {came}"
        return found.outcome(NOT_KNOWN, f"{why}; two sets of gains shaped this response{told}")
    locks, growth = found.settings.locks_of(record.region), found.growth
    own = Diagnosis(Cause.AGGRESSIVE, 0.9, growth.to_dict(), growth.sentence) if growth is not None else None
    proposed = step_without_model(
        record.response, record.window, record.in_force, own, found.settings.without_model, locks
    )
    reason = f"{why}; {proposed.sentence}"
    silent = learned.agreement == Agreement.SILENT and not record.response.sp_changed  # noise has peaks as well
    if proposed.tuning is None or silent:
        return found.outcome(NOT_KNOWN, reason, own, proposed.numbers)
    stored = record.table.stored_for(record.region, proposed.tuning.gains, *record.at)
    if stored is None:
        reason = f"{reason}; no gains of this region give that next to its neighbours'"
        return found.outcome(NOT_KNOWN, reason, own, proposed.numbers)
    after = record.table.with_gains(record.region, stored).at(record.region, *record.at)
    if bold := too_bold((model or learned.estimate).plausible, record.in_force, after, found.settings):
        return found.outcome(NOT_KNOWN, f"{reason}; not done: {bold}", own, proposed.numbers)
    found, tuning = replace(found, excitation=found.excitation_now), replace(proposed.tuning, gains=stored)
    if growth is None and not unambiguous(found, learned) and (doubt := doubt_of(found)) is not None:
        step = replace(found.outcome("", ""), proposal=tuning, foreign=counted_cause(found, doubt))
        return found.unconfirmed(step, replace(doubt, reason=f"{reason}; {doubt.reason}"))
    tables, damping = (record.table, record.commissioned), record.response.damping
    proof = prove(unproved_request(tuning, record.region, tables, found.settings, damping), found.settings.guard)
    step = found.outcome(proof.code, reason if proof.accepted else proof.sentence, own, proposed.numbers)
    return replace(step, proposal=tuning, basis=proposed.basis, proof=proof)


def _above_noise(found: Findings) -> bool:
    """Whether the response rises out of the noise: a danger of which nothing is seen asks for no relief at once.

    The first peak of a setpoint's response is the step itself, and the noise on top of it is no part of that.
    """
    record, response = found.record, found.record.response
    sizes = [abs(peak.e) for peak in response.peaks]
    if response.sp_changed:
        sizes = [abs(record.samples[-1].sp - float(record.window.sp[0])), *sizes[1:]]
    return max(sizes, default=0.0) >= found.settings.admission.excitation_bands * response.band


def choosable(record: ResponseRecord, known: KnownProcesses, gains: PidGains) -> Choosable:
    """A set of the record's region as it would run there, with its Ms on the ways to the neighbours."""
    region, settings = record.region, known.settings
    runs = known.table.with_gains(region, gains).at(region, *record.at)
    if len(known.table.regions) == 1:
        return Choosable(runs)
    process = known.likeliest(region).model()
    worst = worst_between(known.boundaries(region), process, gains, settings.sample_time_s, settings.filter_s)
    return Choosable(runs, worst.ms / settings.guard.ms_border if worst is not None else 0.0)


def proved(found: Findings, model: RegionModel, wanted: RobustProposal) -> Proof:
    """May the region have the gains that the rule gives for a model?"""
    settings = found.settings
    return _proof_of(found, found.record.known_with(model, settings), wanted.tuning, settings.guard)


def _proof_of(found: Findings, known: KnownProcesses, tuning: Tuning, guard: GuardSettings) -> Proof:
    """The guard's word on a tuning for the response's region."""
    record = found.record
    damping = record.pattern.damping if record.pattern is not None else None
    return prove(change_request(tuning, record.region, record.commissioned, known, found.learned, damping), guard)


def worth(found: Findings, model: RegionModel, wanted: RobustProposal, proof: Proof) -> tuple[Choice, Proof]:
    """Is the change, or a step on its way, expected to cost less than staying?

    Returns the choice between the gains in force, the proved change and steps on its way, and the best one's proof.
    """
    record, settings = found.record, found.settings
    known = record.known_with(model, settings)
    now, ways = record.table.gains_of(record.region), [proof]
    assert proof.gains is not None
    for share in PARTS:
        part = replace(wanted.tuning, gains=along(now, proof.gains, share), tau_c_s=None)
        one = _proof_of(found, known, part, settings.guard)
        if one.accepted:
            why = f"{share:.0%} of the proved change, because that is expected to be better than the full change"
            ways.append(replace(one, step=proof.step * share, tau_c_s=proof.tau_c_s, notes=(*proof.notes, why)))
    whole = _proof_of(found, known, wanted.tuning, settings.guard.whole_step()) if proof.step < 1.0 else None
    sets = [now, *(one.gains for one in ways), whole.gains if whole else None]
    placed = [choosable(record, known, gains) for gains in sets if gains is not None]
    learned, asked = found.learned, 1 + len(ways)
    assert learned is not None  # after the stage of identification
    seen = ModelEvidence(  # what bears on whether the models are a fiction
        model.records + int(found.joined > 0),
        found.excitation_before.clear + int(found.clear and not record.response.taken_over),
        len(learned.estimate.load_times_s),
        any(sample.limited for sample in record.own),
        found.unexplained > settings.swing.unexplained,
        decay_seen(record.pattern),
    )
    loop = LoopSettings(settings.sample_time_s, settings.setpoint_weight, settings.filter_s)
    by_setpoint = found.excitation_now.setpoints > 0 or found.joined > 0
    surely = settings.choice if by_setpoint else settings.choice.by_loads()  # by loads alone models are less sure
    looked = outlooks(proof.allowed, placed, seen.decay, loop, surely)
    way = looked[asked] if len(looked) > asked else None
    choice = choose(looked[:asked], way, seen, settings.choice)
    return choice, ways[choice.best - 1]


PARTS = (0.75, 0.5, 0.25)  # shares of a proved change that are weighed beside it


def gains_that_win(found: Findings, own: Outcome) -> Outcome:
    """Which gains win, and why: the one place that chooses between the model's, the set before and all samples'.

    1. Those that follow from the response, with the models of its region.
    2. None, where the book of all samples speaks against these.
    3. Those of the book, where there are none by now, and it is one to ask. The book does not ask for more action where
       a clear response by itself asked for less: it may be wrong in what it objects to.

    How far the model's gains go is weighed before, by `worth`.
    """
    seen, winner = all_samples(found, own), own
    less = own.changes and found.clear and own.asks_for_less(found.record.in_force)
    if winner.changes:
        winner = objection(found, winner, seen) or winner
    if not winner.changes and (refuted := refuted_by_trial(found, winner, seen)):
        return refuted
    if not winner.changes and not (less and seen.told is not None and seen.told.leans > 0):
        winner = proposal_by_all_samples(found, winner, seen) or winner
    return seen.entered(winner)


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
    return replace(winner, robust=robust_by_all_samples(found, winner))


def _step_of(error: BaseException) -> str:
    """Name of the step in which an error was raised: what the story called."""
    names, at = list[str](), error.__traceback__
    while at is not None:
        names.append(at.tb_frame.f_code.co_name)
        at = at.tb_next
    return next((name for name in names if name not in STORY), names[-1]).replace("_", " ")


STORY = ("decide", "_decided", "findings_of", "gains_that_win", "by_model")  # functions that only call the steps
