"""Whether a change that is proved and worth it is sure.

The loop itself may refute the model (`refutation`), the process may run away by itself (`runaway`), and a case that is
not clear is put to the whole diagnosis before gains change (`confirmation`). Whether a valve may stick is asked once
more before a change: by how pv stands (`stands`), by the diagnosis (`doubt_of`; diagnosis/sticking_valve.py), and by
all samples (`valve_explains_more`, which by_all_samples.py asks as well). Before anything is learned, findings.py has
asked.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.oscillation_online import stretch
from retuner.adaptive.diagnosis.second_opinion import SWINGING, TOWARDS_SAFETY, Excitation, runs_away, unconfirmed
from retuner.adaptive.diagnosis.swing_checks import at_own_crossover, foretold, not_seen
from retuner.adaptive.diagnosis.unstable_process import unstable_process, worse_on
from retuner.adaptive.explanations.book import Book
from retuner.adaptive.explanations.tone import tone_of
from retuner.adaptive.explanations.valve_odds import WEIGHT, log_odds_of_valve
from retuner.adaptive.explanations.wandering_load import Prepared
from retuner.adaptive.guard.ruling import Proof
from retuner.adaptive.identification.estimate import log_controller
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.sampled import SampledLaw
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import ANEW, Agreement, Learned
from retuner.adaptive.signals.sample import LoopMode, LoopSample, Window
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.findings import (
    FEWEST_SAMPLES,
    NOT_THE_LOOP,
    OTHER_CAUSES,
    Findings,
    known_to_swing,
    swings_between_limits,
    wanted_of,
)
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.batch_responses import ClosedLoop
from retuner.adaptive.valve.stand_still import stand_still
from retuner.schedule.late_dataclass import replace


def refutation(found: Findings, cause: Diagnosis, allowed: Sequence[Plausible]) -> Diagnosis | None:
    """Why the loop does not swing as the model says, if so; at the output's limits no linear model can say.

    cause : why the gains would be changed. allowed : the models on which the change is proved.

    Loads of unknown shape beside it let a model explain any swing. A setpoint step from rest that needs none has shown
    the loop as the model says it is, wherever the peaks of it lie.
    """
    record, settings, damping = found.record, found.settings, found.record.response.damping
    by_the_setpoint_alone = found.clear and found.learned is not None and not found.learned.estimate.load_times_s
    if record.pattern is None or found.steps is not None or by_the_setpoint_alone:
        return None
    # three peaks that grow: a model that says unstable is listened to, however fast it says so
    if cause.cause not in SWINGING or not allowed or (damping is not None and damping > settings.swing.grows):
        return None
    if any(sample.limited for sample in record.samples if sample.t_s >= record.response.t_start_s):
        return None
    model = allowed[0].model.seen_by_controller(settings.sample_time_s)
    loop = ClosedLoop(model.linear(), record.in_force, settings.setpoint_weight, settings.filter_s)
    said = foretold(record.response, loop, found.learned.estimate.ramp_s if found.learned is not None else 0.0)
    reason = not_seen(record.response, said, settings.swing)
    return Diagnosis(Cause.UNKNOWN, 0.5, cause.evidence, reason) if reason else None


def confirmation(found: Findings, change: Outcome, proof: Proof, why: str, lost: int) -> Outcome:
    """The change, where the case is clear or the whole diagnosis names the tuning as well; else the outcome without it.

    why : it is worth it. lost : responses in a row at which the loop was unstable on every plausible model. A case
    is never clear where pv stands while the output travels.
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
            # A record of something else is not kept, and counts as one of that
            if doubt.cause in NOT_THE_LOOP:
                change = replace(change, region_model=None, foreign=counted_cause(found, doubt))
                if learned.agreement in ANEW:  # what was known before stays, and what that rested on
                    before = found.record.excitation.with_response(found.record.response)
                    change = replace(change, excitation=replace(before, lost=lost))
            reason = f"by what is known of the region, {cause.reason}; {doubt.reason}"
            return found.unconfirmed(change, replace(doubt, reason=reason))
        if found.record.response.sp_changed and found.excitation is not None and not learned.contested:
            # As good as a clear one: what agrees with it later needs no second confirmation
            clear = found.excitation.clear + 1
            change = replace(change, excitation=replace(found.excitation, clear=clear))
    return replace(change, code=proof.code, reason=found.words(f"{cause.reason}; {why}"))


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


def valve_explains_more(window: Window, book: Book, odds: float) -> bool:
    """Whether a valve that sticks or has play explains all samples by more than these odds, ln, tempered as loads; what
    a tone from outside makes co do beside it is no valve's.
    """
    tone = tone_of(window, book.dt_s)
    return log_odds_of_valve([Prepared.at(window, book.dt_s)], book.direction, tone) > WEIGHT * odds


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
    # The last setpoint step under these gains, to the end of its response or to the load or step that came next
    response, revision = record.response, record.samples[-1].revision
    end_s = response.t_end_s if response.sp_changed else response.t_start_s
    kept = [s for s in record.samples if s.t_s < end_s and s.revision == revision and s.t_s >= record.entered_s]
    at = next((i for i in range(len(kept) - 1, 0, -1) if kept[i].sp != kept[i - 1].sp), 0)
    own = kept[max(at - SAMPLES_BEFORE_STEP, 0) :]
    followed = all(sample.mode == LoopMode.AUTO and not sample.limited for sample in own)
    window = Window.of(own) if at and followed and len(own) >= FEWEST_OF_STEP else None
    if window is None:
        return None
    law = SampledLaw(record.in_force, settings.sample_time_s, settings.setpoint_weight, settings.filter_s)
    shown = unstable_process(window, law)
    if shown is None:
        return None
    after = record.table.with_gains(record.region, proof.gains).at(record.region, *record.at)
    worse = worse_on(shown, law, after, len(window.pv), settings.cause.ms_high)
    if worse is None:
        return None
    before, later = worse  # Ms on it
    then = f"Ms {before:.2f} -> {later:.2f}" if math.isfinite(later) else f"Ms {before:.2f} now"
    what = "make it less robust" if math.isfinite(later) else "not hold it"
    reason = (
        f"the process runs away by itself, by a factor of 2.7 in {shown.grows_s:.3g} s; the gains hold it. "
        f"What the rule gives would {what} ({then}); there is no rule for such a process"
    )
    return Diagnosis(Cause.UNKNOWN, 0.5, {"runs_away_s": shown.grows_s, "ms": before}, reason)
