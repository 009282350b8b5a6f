"""Where the pipeline asks the diagnosis: what else than the tuning is behind a response, and whether a change is sure.

Before that: does the controller act the wrong way, and is the response one of several that belong together?

A swing without a setpoint step is put to its rivals before anything is learned of it; a record that its model leaves
open, after; and a change that follows from a case that is not clear, before the gains change.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis
from retuner.adaptive.diagnosis.oscillation_online import (
    hidden_cause,
    stretch,
    swings,
    whole_cause,
)
from retuner.adaptive.diagnosis.second_opinion import (
    SWINGING,
    TOWARDS_SAFETY,
    Excitation,
    from_rest_to_rest,
    is_clear,
    runs_away,
    unconfirmed,
)
from retuner.adaptive.diagnosis.swing_checks import (
    FOREIGN_SWINGS,
    at_own_crossover,
    foretold,
    not_seen,
    touches_limits,
)
from retuner.adaptive.diagnosis.wrong_way import acts_wrong_way
from retuner.adaptive.guard import Verdict
from retuner.adaptive.identification.estimate import log_controller
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.sequences import update_by_sequences
from retuner.adaptive.region_model.update import ANEW, Agreement, Learned
from retuner.adaptive.signals.growth import lasting
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.signals.setpoint_steps import setpoint_steps
from retuner.adaptive.signals.step_sequence import WHOLE_STEPS, step_sequence
from retuner.adaptive.supervision.pipeline_types import Findings, ResponseRecord
from retuner.adaptive.supervision.proposal_from_model import RobustProposal, tuning_of
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.batch_responses import ClosedLoop
from retuner.adaptive.valve.stand_still import stand_still
from retuner.schedule.table import Lookup

NOT_THE_LOOP = frozenset({Cause.EXTERNAL, Cause.STICTION, Cause.NOISE, Cause.SATURATION})
"""Causes that leave nothing in a record from which the process could be learned."""


OTHER_CAUSES = NOT_THE_LOOP - {Cause.NOISE}
"""Causes of these that may be behind a swing: what rises out of the noise is none."""
TAKEN_SAMPLES = 5
"""Samples after which the recogniser has taken a setpoint step at the latest."""
SURELY_TO_AND_FRO = 2
"""Whole steps from which large ones are taken for steps to and fro: a person may set back by twice what he had set."""
SMALL_STEP = 0.05
"""Share of pv's span up to which one whole step is enough: as large as bumps are made."""
WHOLE = 2.01
"""A whole step of a bump to and fro over the bump, rounding included."""
PART = "to_and_fro"
"""Code: the response is a part of what is judged as a whole."""


def joined_step_sequence(found: Findings) -> None:
    """Is the response one of several to setpoint steps to and fro, which say together what none says alone?"""
    record, sequence = found.record, step_sequence(found.record.samples)
    if sequence is None or record.entered_s > record.samples[sequence.whole[0]].t_s:  # in another region
        return
    began_s, seen = record.response.t_start_s, len(sequence.whole)
    half = abs(record.samples[sequence.opened].sp - sequence.base)
    if seen < SURELY_TO_AND_FRO and half > SMALL_STEP * found.settings.pv_span:
        return
    if sequence.closed is None or seen < WHOLE_STEPS:
        found.stop(
            PART, "one of several setpoint steps to and fro: they are judged together, when the setpoint is back"
        )
        return
    closed_s = record.samples[sequence.closed].t_s
    if began_s > closed_s + TAKEN_SAMPLES * found.settings.sample_time_s:
        return
    record, settings = found.record, found.settings
    known = record.region_models.get(record.region)
    began_s = record.samples[sequence.opened].t_s
    if known is not None and any(one.t_s > began_s for one in known.sequences):
        found.stop(PART, "the setpoint steps to and fro were judged together before")
        return
    law = settings.setpoint_weight, settings.filter_s
    apart = record.crossed or record.table.lookup is Lookup.INTERPOLATED
    found.steps = None if apart else setpoint_steps(record.samples, sequence, record.in_force, law)
    if found.steps is None:
        found.stop(PART, "the setpoint steps to and fro show nothing: co did not follow its control law all the time")
        return
    found.joined = len(sequence.whole) + 2
    calm = replace(record, response=replace(record.response, peaks=()))  # its peaks are the load's as well
    found.question = replace(found.question, record=calm)


def by_sequences(found: Findings) -> Learned | None:
    """What setpoint steps to and fro teach by what is known of the setpoint alone."""
    assert found.steps is not None
    record, settings = found.record, found.settings
    known = record.region_models.get(record.region)
    sequences = (*(known.sequences if known is not None else ()), found.steps)
    law, sign = (settings.setpoint_weight, settings.filter_s), record.in_force.direction
    return update_by_sequences(known, sequences, sign, settings.tracker, settings.fit, law, record.at)


def beside_sequences(found: Findings, learned: Learned) -> Learned:
    """What is learned, where what is known rests on steps to and fro: no load may add to these, and no small step by
    itself.

    They are made where loads never rest, and one response shows such a load as much as its process.
    """
    before = found.record.region_models.get(found.record.region)
    if before is None or not before.sequences or found.steps is not None:
        return learned
    moved = float(np.ptp(found.record.window.sp))
    if not found.record.response.sp_changed or moved <= WHOLE * SMALL_STEP * found.settings.pv_span:
        return replace(learned, region_model=before, agreement=Agreement.SILENT)
    now = learned.region_model
    return learned if now is None else replace(learned, region_model=replace(now, sequences=before.sequences))


def wrong_way(found: Findings) -> Diagnosis | None:
    """The diagnosis that the controller acts the wrong way, where the response and what came before it show that.

    It is asked before anything else: pv far out of its range, or an output at its limit, is what comes of it.
    """
    record, settings = found.record, found.settings
    response, swing = record.response, settings.swing
    since_s = response.t_start_s - swing.lookback * (response.t_end_s - response.t_start_s)
    seen = stretch(record.samples, since_s, swing.same_gains)
    if len(seen) < FEWEST_SAMPLES:
        return None
    return acts_wrong_way(Window.of(seen), record.in_force.direction, settings.diagnosis.fit)


FEWEST_SAMPLES = 20
"""Samples of which a sign may be told."""


def swing_by_other_cause(found: Findings) -> Diagnosis | None:
    """What else than the tuning is behind a swing without a setpoint step, or goes on behind any response.

    A swing that was known to come, by what clear setpoint steps have shown, is the loop's own whatever a tone explains.
    Where something else was found before, it is asked again, of all that the gains in force have shown lately. Each
    response for which it wins counts for it, each that the loop by itself explains counts against it, and as long as
    the former are more it is alive: nothing is learned. Unknown and noise count for neither. A load response from rest
    to rest counts against it unasked.
    """
    record, settings = found.record, found.settings
    period_s = lasting(record.samples, record.response.band, settings.growth)
    swinging = swings(record.response, settings.swing) or period_s is not None
    if found.growth is not None or found.joined or not (swinging or record.foreign):
        return None
    if known_to_swing(record, settings):
        found.foreign = max(record.foreign - 1, 0)
        return None
    calm = not (swinging or record.response.sp_changed)
    if calm and from_rest_to_rest(record.samples, record.response, settings.swing):
        found.foreign = record.foreign - 1
        told = Diagnosis(Cause.UNKNOWN, 0.5, {}, STILL_ALIVE.format(more=found.foreign))
        return told if found.foreign else None
    asked = record.samples, record.response, record.in_force, settings.swing, settings.diagnosis, period_s
    cause = whole_cause(*asked)
    own = cause.cause in TUNING_CAUSES | {Cause.OK} or _held_up(record, cause, settings)
    found.foreign = record.foreign - 1 if own else record.foreign + (cause.cause in OTHER_CAUSES)
    found.foreign = min(max(found.foreign, 0), settings.swing.most_counted)
    if found.foreign and own:
        return replace(cause, cause=Cause.UNKNOWN, confidence=0.5, reason=STILL_ALIVE.format(more=found.foreign))
    return _with_a_way(record, cause) if found.foreign or (swinging and not own) else None


def one_more_other_cause(found: Findings, cause: Diagnosis) -> None:
    """Counts a response for what else was found behind it, by whichever stage."""
    counted = found.record.foreign if found.foreign is None else found.foreign
    found.foreign = min(counted + (cause.cause in OTHER_CAUSES), found.settings.swing.most_counted)


def _with_a_way(record: ResponseRecord, cause: Diagnosis) -> Diagnosis:
    """What stays open, with what would settle it where its reason does not say: a setpoint step shows the process."""
    told = "setpoint step" in cause.reason or cause.reason.endswith("needed")
    if cause.cause is not Cause.UNKNOWN or record.response.sp_changed or told:
        return cause
    return replace(cause, reason=f"{cause.reason}; a setpoint step would tell more")


def known_to_swing(record: ResponseRecord, settings: RetunerSettings) -> bool:
    """Whether the loop was known to swing so by itself, at this period: by a model that clear setpoint steps taught.

    Such a loop is to be made safer whatever else moves it. What loads alone have taught does not count: a tone fits a
    loop that all but swings.
    """
    known = record.region_models.get(record.region)
    if known is None or not record.excitation.clear or not known.identifiable:
        return False
    process = known.log.model().seen_by_controller(settings.sample_time_s)
    return at_own_crossover(record.response, process, record.in_force, settings.limit_swing)


def known_of_swing(record: ResponseRecord, settings: RetunerSettings) -> RegionModel | None:
    """What was known, of a loop that swings as was known that it would, by itself or between the output's limits; else
    None.

    Such a swing shows one frequency, between limits through a nonlinearity. Taken in record by record, it led away from
    a process that its setpoint steps had shown well.
    """
    before = record.region_models.get(record.region)
    if before is None or not before.identifiable:
        return None
    lasting = swings(record.response, settings.swing) and known_to_swing(record, settings)
    if not (lasting or swings_between_limits(record, settings)):
        return None
    return before if wanted_of(record, before, settings).diagnosis.cause in SWINGING else None


def wanted_of(record: ResponseRecord, model: RegionModel, settings: RetunerSettings) -> RobustProposal:
    """What the rule gives for a model as it may be met now, and whether the tuning in force is a cause by it."""
    return tuning_of(record.known_with(model, settings), record.region, record.in_force)


NOT_CONFIRMED = "by what is known of the region, {wanted}; {doubt}"
"""The reason where a change is due by the model of the region, and the record alone does not name the tuning."""
STILL_ALIVE = (
    "this response by itself is the loop's own, but earlier ones under these gains had another cause; still needed "
    "before the model is updated: {more} like this one"
)
"""The reason where one response alone would be the loop's own."""


def hidden(found: Findings) -> Diagnosis | None:
    """What hides under a response that its own model leaves open; the loads before steps to and fro have told it."""
    record, settings = found.record, found.settings
    if found.steps is not None:
        return None
    if found.growth is not None or found.unexplained <= settings.swing.unexplained:
        return None
    asked = record.samples, record.response, record.in_force, settings.swing, settings.diagnosis
    cause, again = hidden_cause(*asked)
    if cause is None or _held_up(record, cause, settings):
        return None
    if again:
        found.foreign = min(record.foreign + 1, settings.swing.most_counted)
    return _with_a_way(record, cause)


def _held_up(record: ResponseRecord, cause: Diagnosis, settings: RetunerSettings) -> bool:
    """Whether a swing taken for one from outside is held up by the output's limits: then the model decides."""
    return cause.cause in FOREIGN_SWINGS and swings_between_limits(record, settings)


def swings_between_limits(record: ResponseRecord, settings: RetunerSettings) -> bool:
    """Whether the output goes from limit to limit."""
    return touches_limits(record.samples, record.response, settings.limit_swing)


def unambiguous(found: Findings, learned: Learned) -> bool:
    """Whether the response is the loop's own doing beyond doubt.

    One that crossed a border is where it is a setpoint step that the process in motion explains by itself. One that is
    seen through a valve is not.
    """
    record, loads = found.record, len(learned.estimate.load_times_s)
    if learned.valve is not None:
        return False
    if found.steps is not None:
        return learned.agreement is not Agreement.CONTRADICTS
    if record.crossed:
        return record.response.sp_changed and learned.agreement in {Agreement.FIRST, Agreement.AGREES}
    return is_clear(record.samples, record.response, found.unexplained, loads, found.settings.swing)


def not_as_modelled(found: Findings) -> Diagnosis | None:
    """Why the loop does not swing as the model says, if so; at the output's limits no linear model can say.

    Loads of unknown shape beside it let a model explain any swing. A setpoint step from rest that needs none has shown
    the loop as the model says it is, wherever the peaks of it lie.
    """
    record, cause, settings = found.record, found.diagnosis, found.settings
    if record.pattern is None or found.steps is not None or _by_the_setpoint_alone(found):
        return None
    allowed = found.verdict.allowed if found.verdict else ()
    if cause is None or cause.cause not in SWINGING or not allowed or _swings_wider(record, settings):
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


SETPOINTS = 2
"""Setpoint responses among the records that bear each other out."""


def exempt_from_confirmation(found: Findings, verdict: Verdict, learned: Learned, model: RegionModel) -> bool:
    """Whether a change by a response that is not clear needs no confirmation (see diagnosis/second_opinion.py).

    To agree with loads that were never confirmed proves nothing, so it counts what the model rested on before.
    """
    record, settings = found.record, found.settings
    swing, seen = settings.swing, (record.samples, record.response)
    if verdict.ruling in TOWARDS_SAFETY and (found.growth is not None or known_to_swing(record, settings)):
        return True
    if runs_away(*seen, learned.estimate.explained, swing):
        return True
    process = model.log.model().seen_by_controller(settings.sample_time_s)
    return (
        verdict.ruling in TOWARDS_SAFETY
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


def in_danger(found: Findings, doubt: Diagnosis) -> bool:
    """Whether the loop was unstable on every plausible model at two responses in a row: what is proved makes it safer.

    Such a loop does not wait for a confirmation, only for another cause that is named; and not for a tone, or for an
    output at its limits, where it goes from limit to limit: that is how an unstable loop ends.
    """
    if found.excitation_now.lost < SECOND:
        return False
    held_up = doubt.cause in ENDS and swings_between_limits(found.record, found.settings)
    return held_up or doubt.cause not in NOT_THE_LOOP


ENDS = frozenset({Cause.SATURATION, Cause.EXTERNAL})
"""What an unstable loop between its limits reads like."""


SECOND = 2
"""The record at which such a loop is made safer at the latest."""


def above_noise(found: Findings) -> bool:
    """Whether the response rises out of the noise: a danger of which nothing is seen asks for no relief at once.

    The first peak of a setpoint's response is the step itself, and the noise on top of it is no part of that.
    """
    record, response = found.record, found.record.response
    sizes = [abs(peak.e) for peak in response.peaks]
    if response.sp_changed:
        sizes = [abs(record.samples[-1].sp - float(record.window.sp[0])), *sizes[1:]]
    return max(sizes, default=0.0) >= found.settings.admission.excitation_bands * response.band


def basis_of(record: ResponseRecord, agreement: Agreement) -> Excitation:
    """What the model rested on before this response."""
    if agreement == Agreement.CHANGED:
        return record.excitation.of_alternative()
    return Excitation() if agreement in ANEW else record.excitation
