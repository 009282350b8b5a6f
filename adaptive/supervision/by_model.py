"""What follows from the findings about a response: gains that are proved and worth their risk, or the reason why none.

by_model         the rule's proposal for what is known (region_proposal.py), proved by the guard (guard/proof.py),
                 weighed against staying and steps on its way (choice/expected_cost.py), and confirmed: the loop
                 itself may refute the model, the process may run away by itself, and a case that is not clear is
                 put to the whole diagnosis before gains change
without_a_model  a small step by rules that need no model, where nothing is identified
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.choice.expected_cost import (
    Choice,
    Choosable,
    LoopSettings,
    ModelEvidence,
    Outlook,
    choose,
    outlooks,
)
from retuner.adaptive.decision_numbers import Basis
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.oscillation_online import stretch
from retuner.adaptive.diagnosis.second_opinion import SWINGING, TOWARDS_SAFETY, Excitation, runs_away, unconfirmed
from retuner.adaptive.diagnosis.swing_checks import at_own_crossover, foretold, not_seen
from retuner.adaptive.diagnosis.unstable_process import UnstableProcess, unstable_process, worse_on
from retuner.adaptive.guard import GuardSettings, Proof, prove
from retuner.adaptive.guard.both_sides_of_border import worst_between
from retuner.adaptive.guard.step_size import along
from retuner.adaptive.identification.estimate import log_controller
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.loop.sampled import SampledLaw
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import ANEW, Agreement, Learned
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.sample import LoopMode, LoopSample, Window
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import (
    FEWEST_SAMPLES,
    NOT_KNOWN,
    NOT_THE_LOOP,
    OTHER_CAUSES,
    Findings,
    known_to_swing,
    swings_between_limits,
    unambiguous,
    wanted_of,
)
from retuner.adaptive.supervision.judge_evidence import prediction_of_proof
from retuner.adaptive.supervision.question import ResponseRecord
from retuner.adaptive.supervision.region_proposal import (
    KnownProcesses,
    RobustProposal,
    change_request,
    too_bold,
    unproved_request,
)
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.batch_responses import ClosedLoop
from retuner.adaptive.trial.prediction import decay_seen
from retuner.adaptive.valve.stand_still import stand_still
from retuner.adaptive.without_model.proposal_without_model import without_model
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import replace

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
        return _stays(found, cause, learned)
    proof = proved(found, model, wanted)  # may the region have the gains that the rule gives?
    lost = 0
    if lost_on_all(proof.allowed, found.record.in_force, found.settings):
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
    choice, proof = worth(found, model, wanted, proof)  # is it expected to cost less than staying?
    if choice.index == 0:
        code, reason = ONE_RECORD if choice.waits else NOT_WORTH, found.words(choice.reason)
        return replace(change, code=code, reason=reason, basis=None, proof=None, numbers=choice.numbers)
    prediction = prediction_of_proof(found, proof)
    change = replace(change, proof=proof, numbers=choice.numbers, prediction=prediction)
    if doubt := runaway(found, proof):  # does the process run away by itself, and would the change hold it worse?
        return found.unconfirmed(change, doubt)
    return confirmation(found, change, proof, choice.reason, lost)


def _stays(found: Findings, cause: Diagnosis, learned: Learned) -> Outcome:
    """The outcome where what is known of the region gives no reason to retune."""
    if learned.agreement is not Agreement.CONTRADICTS:
        return found.outcome(str(cause.cause), cause.reason, cause)
    reason = f"by what is known of the region, {cause.reason}; this response {Agreement.CONTRADICTS}"
    return found.unconfirmed(found.outcome("", ""), Diagnosis(Cause.UNKNOWN, 0.5, cause.evidence, reason))


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
        return found.outcome(NOT_KNOWN, f"{why}; {_of_two_sets(why, crossed=record.crossed)}")
    locks, growth = found.settings.locks_of(record.region), found.growth
    own = Diagnosis(Cause.AGGRESSIVE, 0.9, growth.to_dict(), growth.sentence) if growth is not None else None
    proposed = without_model(record.response, record.window, record.in_force, own, found.settings.without_model, locks)
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


def _of_two_sets(why: str, *, crossed: bool) -> str:
    """Why a pattern tells nothing; why : what is said before."""
    came = "crossed a boundary" if crossed else "began under other gains"
    return f"two sets of gains shaped this response{'' if came in why else f', because it {came}'}"


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
    worst = worst_between(known.borders(region), process, gains, settings.sample_time_s, settings.filter_s)
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


def lost_on_all(allowed: Sequence[Plausible], gains: PidGains, settings: RetunerSettings) -> bool:
    """Whether a loop is unstable with these gains on every model, of which there is one at least."""
    dt_s, filter_s = settings.sample_time_s, settings.filter_s
    processes = (one.model.seen_by_controller(dt_s).linear() for one in allowed)
    return bool(allowed) and all(math.isinf(sensitivity_peak(process, gains, filter_s)) for process in processes)


def worth(found: Findings, model: RegionModel, wanted: RobustProposal, proof: Proof) -> tuple[Choice, Proof]:
    """Is the change, or a step on its way, expected to cost less than staying?

    Returns the choice between the gains in force, the proved change and steps on its way, and the best one's proof.
    """
    record, settings = found.record, found.settings
    known = record.known_with(model, settings)
    ways = [proof, *_steps(found, known, wanted, proof)]
    whole = _proof_of(found, known, wanted.tuning, settings.guard.whole_step()) if proof.step < 1.0 else None
    sets = [record.table.gains_of(record.region), *(one.gains for one in ways), whole.gains if whole else None]
    placed = [choosable(record, known, gains) for gains in sets if gains is not None]
    seen, asked = _seen(found, model), 1 + len(ways)
    looked = _looked(found, proof.allowed, placed, seen)
    way = looked[asked] if len(looked) > asked else None
    choice = choose(looked[:asked], way, seen, settings.choice)
    return choice, ways[choice.best - 1]


def _looked(
    found: Findings, allowed: Sequence[Plausible], sets: Sequence[Choosable], seen: ModelEvidence
) -> list[Outlook]:
    """What each set is expected to do on models; these are less sure where no setpoint step is among the records."""
    settings = found.settings
    loop = LoopSettings(settings.sample_time_s, settings.setpoint_weight, settings.filter_s)
    by_setpoint = found.excitation_now.setpoints > 0 or found.joined > 0
    return outlooks(allowed, sets, seen.decay, loop, settings.choice if by_setpoint else settings.choice.by_loads())


def _steps(found: Findings, known: KnownProcesses, wanted: RobustProposal, proof: Proof) -> list[Proof]:
    """Parts of a proved change that are proved as well."""
    now, accepted = found.record.table.gains_of(found.record.region), []
    assert proof.gains is not None
    for share in PARTS:
        part = replace(wanted.tuning, gains=along(now, proof.gains, share), tau_c_s=None)
        one = _proof_of(found, known, part, found.settings.guard)
        if one.accepted:
            notes = (
                *proof.notes,
                f"{share:.0%} of the proved change, because that is expected to be better than the full change",
            )
            accepted.append(replace(one, step=proof.step * share, tau_c_s=proof.tau_c_s, notes=notes))
    return accepted


PARTS = (0.75, 0.5, 0.25)  # shares of a proved change that are weighed beside it


def _seen(found: Findings, model: RegionModel) -> ModelEvidence:
    """What bears on whether the models are a fiction."""
    record, learned = found.record, found.learned
    assert learned is not None  # after the stage of identification
    return ModelEvidence(
        model.records + int(found.joined > 0),
        found.excitation_before.clear + int(found.clear and not record.response.taken_over),
        len(learned.estimate.load_times_s),
        any(sample.limited for sample in record.own),
        found.unexplained > found.settings.swing.unexplained,
        decay_seen(record.pattern),
    )


def refutation(found: Findings, cause: Diagnosis, allowed: Sequence[Plausible]) -> Diagnosis | None:
    """Why the loop does not swing as the model says, if so; at the output's limits no linear model can say.

    cause : why the gains would be changed. allowed : the models on which the change is proved.

    Loads of unknown shape beside it let a model explain any swing. A setpoint step from rest that needs none has shown
    the loop as the model says it is, wherever the peaks of it lie.
    """
    record, settings = found.record, found.settings
    if record.pattern is None or found.steps is not None or _by_the_setpoint_alone(found):
        return None
    if cause.cause not in SWINGING or not allowed or _swings_wider(record, settings):
        return None
    if any(sample.limited for sample in record.samples if sample.t_s >= record.response.t_start_s):
        return None
    model = allowed[0].model.seen_by_controller(settings.sample_time_s)
    loop = ClosedLoop(model.linear(), record.in_force, settings.setpoint_weight, settings.filter_s)
    said = foretold(record.response, loop, found.learned.estimate.ramp_s if found.learned is not None else 0.0)
    reason = not_seen(record.response, said, settings.swing)
    return Diagnosis(Cause.UNKNOWN, 0.5, cause.evidence, reason) if reason else None


def _by_the_setpoint_alone(found: Findings) -> bool:
    """Whether the loop by itself explains a setpoint step from rest, to the noise and without a load."""
    return found.clear and found.learned is not None and not found.learned.estimate.load_times_s


def _swings_wider(record: ResponseRecord, settings: RetunerSettings) -> bool:
    """Whether a response of three peaks grows: a model that says unstable is listened to, however fast it says so."""
    damping = record.response.damping
    return damping is not None and damping > settings.swing.grows


def confirmation(found: Findings, change: Outcome, proof: Proof, worth: str, lost: int) -> Outcome:
    """The change, where the case is clear or the whole diagnosis names the tuning as well; else the outcome without it.

    worth : why it is. lost : responses in a row at which the loop was unstable on every plausible model. No case is
    clear where pv stands while the output travels.
    """
    learned, model, cause = found.learned, found.in_use, change.diagnosis
    assert learned is not None
    assert model is not None
    assert cause is not None
    agrees = found.clear or is_known(found, learned)
    if found.record.crossed and not agrees:
        reason = found.words("the response crossed a boundary, and more than the setpoint may be behind it")
        return replace(change, code="unconfirmed", reason=reason, basis=None, proof=None)
    if not (agrees or exempt_from_confirmation(found, proof, learned, model)) or stands(found):
        doubt = doubt_of(found, cause)
        if doubt is not None and not in_danger(found, doubt, lost):
            return _not_confirmed(found, change, cause, doubt, lost)
        if found.record.response.sp_changed and found.excitation is not None and not learned.contested:
            # As good as a clear one: what agrees with it later needs no second confirmation
            clear = found.excitation.clear + 1
            change = replace(change, excitation=replace(found.excitation, clear=clear))
    return replace(change, code=proof.code, reason=found.words(f"{cause.reason}; {worth}"))


def _not_confirmed(found: Findings, change: Outcome, cause: Diagnosis, doubt: Diagnosis, lost: int) -> Outcome:
    """The change is not made; a record of something else is not kept either, and counts as one of that."""
    assert found.learned is not None
    if doubt.cause in NOT_THE_LOOP:
        change = replace(change, region_model=None, foreign=counted_cause(found, doubt))
        if found.learned.agreement in ANEW:  # what was known before stays, and what that rested on
            before = found.record.excitation.with_response(found.record.response)
            change = replace(change, excitation=replace(before, lost=lost))
    reason = f"by what is known of the region, {cause.reason}; {doubt.reason}"
    return found.unconfirmed(change, replace(doubt, reason=reason))


def is_known(found: Findings, learned: Learned) -> bool:
    """Whether a response agrees with what is known, and that rests on a clear setpoint step or is borne out by records
    that settle the process by themselves: it is one record more of that.

    That something else is behind them all is in the cost that the change is expected to have. Where this response has
    put another structure in the lead, it is so only if a change was due before it: one record turned a loop that five
    held for robust into an integrator in danger.
    """
    record, now = found.record, learned.region_model
    before = record.region_models.get(record.region)
    if learned.agreement != Agreement.AGREES or before is None or now is None:
        return False
    same = before.log.type is now.log.type or wanted_of(record, before, found.settings).diagnosis.retune
    return same and (found.excitation_before.clear > 0 or records_agree(now, found.excitation_now, found.settings))


def records_agree(model: RegionModel, excitation: Excitation, settings: RetunerSettings) -> bool:
    """Whether the newest records settle the process each by itself, and alike.

    Loads that overlap can be explained in any way, but not twice in the same one. Setpoint responses must be among
    them, or each must lead from rest to rest: a tone under loads alone is the same fiction each time.
    """
    if excitation.setpoints < SETPOINTS and excitation.rested < settings.swing.alike_records:
        return False
    swing, dt_s = settings.swing, settings.sample_time_s
    best = model.log.model()
    at_s = best.seen_by_controller(dt_s).theta_s
    usual = log_controller(best, dt_s, at_s)
    settled = [
        point.log
        for point in model.points[-swing.alike_records :]
        if point.log.gain_uncertainty(dt_s) <= settings.fit.gain_std_limit
    ]
    alike = [abs(log_controller(log.model(), dt_s, at_s) - usual) <= swing.alike for log in settled]
    return len(alike) >= swing.alike_records and all(alike)


SETPOINTS = 2  # setpoint responses among the records that bear each other out


def exempt_from_confirmation(found: Findings, proof: Proof, learned: Learned, model: RegionModel) -> bool:
    """Whether a change by a response that is not clear needs no confirmation (see diagnosis/second_opinion.py).

    To agree with loads that were never confirmed proves nothing, so it counts what the model rested on before.
    """
    record, settings = found.record, found.settings
    swing, seen = settings.swing, (record.samples, record.response)
    if proof.ruling in TOWARDS_SAFETY and (found.growth is not None or known_to_swing(record, settings)):
        return True
    if runs_away(*seen, learned.estimate.explained, swing):
        return True
    process = model.log.model().seen_by_controller(settings.sample_time_s)
    return (
        proof.ruling in TOWARDS_SAFETY
        and swings_between_limits(record, settings)
        and at_own_crossover(record.response, process, record.in_force, settings.limit_swing)
    )


def doubt_of(found: Findings, wanted_for: Diagnosis | None = None) -> Diagnosis | None:
    """Why the whole diagnosis does not confirm a change, None when it does.

    wanted_for : why the gains would be changed, None where no model says so.
    """
    record, settings = found.record, found.settings
    # What was seen, whatever the model in use rests on: that begins anew with each record that contradicts it.
    # A setpoint step is one also where its fit does not tell.
    now = found.excitation_now
    return unconfirmed(
        _of_this_process(found),
        record.response,
        record.in_force,
        replace(now, setpoints=max(now.setpoints, 1)) if found.record.response.sp_changed else now,
        settings.swing,
        settings.diagnosis,
        wanted_for,
    )


def stands(found: Findings) -> bool:
    """Whether pv stands while the output travels, as behind a valve that sticks: a fit makes loads of its slips."""
    record, settings = found.record, found.settings
    seen = stretch(_of_this_process(found), -np.inf, settings.swing.same_gains)
    if len(seen) < FEWEST_SAMPLES:
        return False
    still = stand_still(Window.of(seen), record.in_force, settings.diagnosis.standing)
    return still is not None and still.stands


def _of_this_process(found: Findings) -> Sequence[LoopSample]:
    """The samples kept; where a second record says that the process has changed, those since the last one before."""
    record, learned = found.record, found.learned
    before = record.region_models.get(record.region)
    if learned is None or learned.agreement is not Agreement.CHANGED or before is None or len(before.points) < SECOND:
        return record.samples
    return [sample for sample in record.samples if sample.t_s > before.points[-SECOND].t_s]


def in_danger(found: Findings, doubt: Diagnosis, lost: int) -> bool:
    """Whether the loop was unstable on every plausible model at two responses in a row: what is proved makes it safer.

    Such a loop does not wait for a confirmation, only for another cause that is named; and not for a tone, or for an
    output at its limits, where it goes from limit to limit: that is how an unstable loop ends.
    """
    if lost < SECOND:
        return False
    held_up = doubt.cause in ENDS and swings_between_limits(found.record, found.settings)
    return held_up or doubt.cause not in NOT_THE_LOOP


ENDS = frozenset({Cause.SATURATION, Cause.EXTERNAL})  # what an unstable loop between its limits reads like


SECOND = 2  # the record at which such a loop is made safer at the latest


def counted_cause(found: Findings, cause: Diagnosis) -> int:
    """Responses behind which something else than the tuning was found (Outcome.foreign), this one among them."""
    counted = found.record.foreign if found.foreign is None else found.foreign
    return min(counted + (cause.cause in OTHER_CAUSES), found.settings.swing.most_counted)


SAMPLES_BEFORE_STEP = 5  # samples before a setpoint step that are looked at with it
FEWEST_OF_STEP = 3  # samples of such a window


def runaway(found: Findings, proof: Proof) -> Diagnosis | None:
    """Does the process run away by itself, and would the proved change hold it worse?

    The last setpoint step under these gains shows it. The models that settings follow from have no unstable pole; they
    have an integrator in its place, on which less gain looks safer.
    """
    record, settings = found.record, found.settings
    if proof.gains is None or found.steps is not None or record.pattern is None:
        return None
    window = _last_step(record)
    if window is None:
        return None
    law = SampledLaw(record.in_force, settings.sample_time_s, settings.setpoint_weight, settings.filter_s)
    shown = unstable_process(window, law)
    if shown is None:
        return None
    after = record.table.with_gains(record.region, proof.gains).at(record.region, *record.at)
    worse = worse_on(shown, law, after, len(window.pv), settings.cause.ms_high)
    return None if worse is None else _runaway_words(shown, *worse)


def _last_step(record: ResponseRecord) -> Window | None:
    """The last setpoint step under these gains, to the end of its response or to the load that came next.

    None where none is kept, or co did not follow its law.
    """
    response, revision = record.response, record.samples[-1].revision
    end_s = response.t_end_s if response.sp_changed else response.t_start_s
    kept = [s for s in record.samples if s.t_s <= end_s and s.revision == revision and s.t_s >= record.entered_s]
    at = next((i for i in range(len(kept) - 1, 0, -1) if kept[i].sp != kept[i - 1].sp), 0)
    own = kept[max(at - SAMPLES_BEFORE_STEP, 0) :]
    followed = all(sample.mode == LoopMode.AUTO and not sample.limited for sample in own)
    return Window.of(own) if at and followed and len(own) >= FEWEST_OF_STEP else None


def _runaway_words(shown: UnstableProcess, before: float, after: float) -> Diagnosis:
    """Why nothing changes. before, after : Ms on it."""
    then = f"Ms {before:.2f} -> {after:.2f}" if math.isfinite(after) else f"Ms {before:.2f} now"
    what = "make it less robust" if math.isfinite(after) else "not hold it"
    reason = (
        f"the process runs away by itself, by a factor of 2.7 in {shown.grows_s:.3g} s; the gains hold it. "
        f"What the rule gives would {what} ({then}); there is no rule for such a process"
    )
    evidence = {"runs_away_s": shown.grows_s, "ms": before}
    return Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason)
