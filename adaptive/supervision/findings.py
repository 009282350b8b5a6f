"""What the record of a response says, what its region knows with it (learning.py), and what settings follow.

A step takes the findings so far and returns them with its own; each may end the question. Other causes than the tuning
come first: a wrong action, a swing from outside. `propose` gives the settings, robust_simc.py's on the models that the
records still allow, on line as off line. A region whose process is not known well enough gets none, with one exception:
a loop that is over its Ms limit on every model that is still allowed gets less of everything at once. The models that
fit as well as the best say whether it needs less (a dead time may be too short to be seen: dead_time_bound.py).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from retuner.adaptive.choice.expected_cost import Choosable, LoopSettings, outlooks
from retuner.adaptive.decision_numbers import NO_NUMBERS, Numbers
from retuner.adaptive.diagnosis.cause import TUNING_CAUSES, Cause, Diagnosis, over_words, tuning_cause, with_second_lag
from retuner.adaptive.diagnosis.oscillation_online import hidden_cause as diagnosis_of_rest
from retuner.adaptive.diagnosis.oscillation_online import stretch, swings, whole_cause
from retuner.adaptive.diagnosis.second_opinion import SWINGING, Excitation, from_rest_to_rest, is_clear
from retuner.adaptive.diagnosis.swing_checks import FOREIGN_SWINGS, at_own_crossover, touches_limits
from retuner.adaptive.diagnosis.wrong_way import acts_wrong_way
from retuner.adaptive.guard.both_sides_of_boundary import eased, worst_between
from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import RobustSettings, asks_for_integral, believed, robust_simc_on
from retuner.adaptive.identification.structure_choice import too_few
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import ANEW, Agreement, Learned
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.rules.simc import without_second_lag
from retuner.adaptive.signals.growth import Growth, grows, lasting
from retuner.adaptive.signals.sample import LoopMode, Window
from retuner.adaptive.signals.setpoint_steps import SetpointSteps, setpoint_steps
from retuner.adaptive.signals.step_sequence import WHOLE_STEPS, step_sequence
from retuner.adaptive.supervision.admission import Ground
from retuner.adaptive.supervision.decision import Outcome
from retuner.adaptive.supervision.known_processes import KnownProcesses
from retuner.adaptive.supervision.learning import SMALL_STEP, beside_sequences, learned_by_itself, learned_by_sequences
from retuner.adaptive.supervision.question import Question, ResponseRecord
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field
from retuner.schedule.table import Lookup

NOT_KNOWN = "not_identifiable"  # Code: what is known of the process does not carry settings yet
WRONG_WAY = "wrong_way"  # Code: the controller acts the wrong way, which no gains of its sign can cure
PART = "to_and_fro"  # Code: the response is a part of what is judged as a whole
NOT_THE_LOOP = frozenset({Cause.EXTERNAL, Cause.STICTION, Cause.NOISE, Cause.SATURATION})
"""Causes that leave nothing in a record from which the process could be learned."""
OTHER_CAUSES = NOT_THE_LOOP - {Cause.NOISE}
"""Causes of these that may be behind a swing: what rises out of the noise is none."""
TAKEN_SAMPLES = 5  # samples after which the recogniser has taken a setpoint step at the latest
SURELY_TO_AND_FRO = 2
"""Whole steps from which large ones are taken for steps to and fro: a person may set back by twice what he had set."""
FEWEST_SAMPLES = 20  # samples of which a sign may be told


@dataclass(frozen=True, slots=True)
class RobustProposal:
    """tuning : what the rule gives. diagnosis : of the gains in force. ready : whether enough is known to go on."""

    tuning: Tuning
    diagnosis: Diagnosis
    ready: bool


@dataclass(frozen=True, slots=True)
class Findings:
    """What a question's record says, and what its region knows with it.

    ended : the outcome, where a step has ended the question.
    joined : setpoint steps to and fro of which the record was made, 0 for one response as it came. steps : these.
    growth : of a swing that only the loop itself can make. learned : what the record taught.
    unexplained : share of the record's pv that its model leaves open.
    in_use : what is known of the region and decides now; None where nothing is. wanted : what the rule gives for it.
    excitation_before : what in_use rested on before this response; excitation_now : with it. clear : whether the
    response needs no second opinion. foreign, region_model, excitation, beside : as in Outcome, None for as before.
    """

    question: Question
    ended: Outcome | None = None
    joined: int = 0
    steps: SetpointSteps | None = None
    growth: Growth | None = None
    learned: Learned | None = None
    unexplained: float = 0.0
    in_use: RegionModel | None = None
    wanted: RobustProposal | None = None
    excitation_before: Excitation = field(default_factory=Excitation)
    excitation_now: Excitation = field(default_factory=Excitation)
    clear: bool = False
    foreign: int | None = None
    region_model: RegionModel | None = None
    excitation: Excitation | None = None
    beside: Mapping[int, RegionModel] = field(default_factory=dict)

    @property
    def record(self) -> ResponseRecord:
        """The response and what it is judged on."""
        return self.question.record

    @property
    def settings(self) -> RetunerSettings:
        """Settings in force for this table: the gains of an interpolated one move without anybody changing them."""
        settings = self.question.settings
        if self.record.table.lookup is Lookup.INTERPOLATED:
            return replace(settings, swing=replace(settings.swing, same_gains=False))
        return settings

    def words(self, reason: str) -> str:
        """A reason with what the record was made of, and the valve through which it was seen."""
        together = f"{self.joined} setpoint steps to and fro, joined: " if self.joined else ""
        valve = self.learned.valve if self.learned is not None else None
        return together + reason + (f"; {valve.sentence}" if valve is not None else "")

    def outcome(
        self, code: str, reason: str, diagnosis: Diagnosis | None = None, numbers: Numbers = NO_NUMBERS
    ) -> Outcome:
        """An outcome without a change, with what is kept of the record."""
        return Outcome(
            code, self.words(reason), self.learned, self.region_model, diagnosis,
            foreign=self.foreign, excitation=self.excitation, numbers=numbers, beside=self.beside,
        )  # fmt: skip

    def unconfirmed(self, outcome: Outcome, doubt: Diagnosis) -> Outcome:
        """The outcome without its change: what that rests on is doubted."""
        return replace(
            outcome, code="unconfirmed", reason=self.words(doubt.reason), diagnosis=doubt,
            basis=None, proof=None, prediction=None,
        )  # fmt: skip

    def end(
        self, code: str, reason: str, diagnosis: Diagnosis | None = None, numbers: Numbers = NO_NUMBERS
    ) -> "Findings":
        """The findings where a step ends the question; arguments as those of outcome."""
        return replace(self, ended=self.outcome(code, reason, diagnosis, numbers))

    def other_cause(self, cause: Diagnosis | None) -> "Findings":
        """The findings where something else than the tuning is behind the response, so that nothing follows."""
        return self if cause is None else self.end(str(cause.cause), cause.reason, cause)


def findings_of(question: Question) -> Findings:
    """What the record of a question says, and what its region knows with it; `ended` where a step has decided."""
    found = Findings(question)
    for step in STEPS:
        found = step(found)
        if found.ended is not None:
            break
    return found


def joining(found: Findings) -> Findings:
    """Is the response one of several to setpoint steps to and fro, which say together what none says alone?"""
    record, settings = found.record, found.settings
    sequence = step_sequence(record.samples)
    if sequence is None or record.entered_s > record.samples[sequence.whole[0]].t_s:  # in another region
        return found
    began_s, seen = record.response.t_start_s, len(sequence.whole)
    half = abs(record.samples[sequence.opened].sp - sequence.base)
    if seen < SURELY_TO_AND_FRO and half > SMALL_STEP * settings.pv_span:
        return found
    if sequence.closed is None or seen < WHOLE_STEPS:
        return found.end(
            PART, "one of several setpoint steps to and fro: they are judged together, when the setpoint is back"
        )
    closed_s = record.samples[sequence.closed].t_s
    if began_s > closed_s + TAKEN_SAMPLES * settings.sample_time_s:
        return found
    known = record.region_models.get(record.region)
    began_s = record.samples[sequence.opened].t_s
    if known is not None and any(one.t_s > began_s for one in known.sequences):
        return found.end(PART, "the setpoint steps to and fro were judged together before")
    law = settings.setpoint_weight, settings.filter_s
    apart = record.crossed or record.table.lookup is Lookup.INTERPOLATED
    steps = None if apart else setpoint_steps(record.samples, sequence, record.in_force, law)
    if steps is None:
        return found.end(
            PART, "the setpoint steps to and fro show nothing: co did not follow its control law all the time"
        )
    calm = replace(record, response=replace(record.response, peaks=()))  # its peaks are the load's as well
    question = replace(found.question, record=calm)
    return replace(found, question=question, joined=len(sequence.whole) + 2, steps=steps)


def action(found: Findings) -> Findings:
    """Does what the controller does against an error make it grow?

    It is asked before anything else: pv far out of its range, or an output at its limit, is what comes of it.
    """
    record, settings = found.record, found.settings
    if record.samples[-1].mode != LoopMode.AUTO:
        return found
    response, swing = record.response, settings.swing
    since_s = response.t_start_s - swing.lookback * (response.t_end_s - response.t_start_s)
    seen = stretch(record.samples, since_s, swing.same_gains)
    if len(seen) < FEWEST_SAMPLES:
        return found
    before = stretch(record.samples, -math.inf)[: -len(seen)]
    farthest = max((abs(one.sp - one.pv) for one in before if not one.limited), default=0.0)
    wrong = acts_wrong_way(Window.of(seen), record.in_force.direction, settings.diagnosis.fit, farthest)
    return found if wrong is None else found.end(WRONG_WAY, wrong.reason, wrong)


def admission(found: Findings) -> Findings:
    """May this response teach its region?"""
    record = found.record
    if found.steps is not None:  # co followed its law from sample to sample: nothing is missing or at a limit
        return found
    refused = record.admission(found.settings)
    if refused.admitted:
        return found
    numbers, reason = refused.numbers, refused.sentence
    if refused.ground is Ground.SETPOINT_LED and record.passed_over:
        numbers = replace(numbers, passed_over=float(record.passed_over))
        reason = f"{reason}; {record.passed_over} such responses were skipped since the last report"
    return found.end(refused.ground.name.lower(), reason, refused.diagnosis(), numbers)


def swing(found: Findings) -> Findings:
    """Has a swing without a setpoint step, or what had another cause before, a cause other than the tuning?

    A swing that was known to come, by what clear setpoint steps have shown, is the loop's own whatever a tone explains.
    A cause that was found before is asked about again, with all that the gains in force have shown lately. A response
    that it explains best counts for it, one that the loop explains by itself counts against it. While more count for
    it, nothing is learned. Unknown and noise count for neither; a load response from rest to rest counts against it.
    """
    record, settings = found.record, found.settings
    if record.crossed:
        return found
    found = replace(found, growth=grows(record.samples, record.response.band, settings.growth))
    period_s = lasting(record.samples, record.response.band, settings.growth)
    swinging = swings(record.response, settings.swing) or period_s is not None
    if found.growth is not None or found.joined or not (swinging or record.foreign):
        return found
    if known_to_swing(record, settings):
        return replace(found, foreign=max(record.foreign - 1, 0))
    calm = not (swinging or record.response.sp_changed)
    if calm and from_rest_to_rest(record.samples, record.response, settings.swing):
        more = record.foreign - 1
        told = Diagnosis(Cause.UNKNOWN, 0.5, {}, STILL_ALIVE.format(more=more))
        return replace(found, foreign=more).other_cause(told if more else None)
    asked = record.samples, record.response, record.in_force, settings.swing, settings.diagnosis, period_s
    cause = whole_cause(*asked)
    own = cause.cause in TUNING_CAUSES | {Cause.OK} or _held_up(record, cause, settings)
    counted = record.foreign - 1 if own else record.foreign + (cause.cause in OTHER_CAUSES)
    counted = min(max(counted, 0), settings.swing.most_counted)
    found = replace(found, foreign=counted)
    if counted and own:
        alive = replace(cause, cause=Cause.UNKNOWN, confidence=0.5, reason=STILL_ALIVE.format(more=counted))
        return found.other_cause(alive)
    return found.other_cause(_with_a_way(record, cause) if counted or (swinging and not own) else None)


STILL_ALIVE = (
    "this response by itself is the loop's own, but earlier ones under these gains had another cause; still needed "
    "before the model is updated: {more} like this one"
)
"""The reason where one response alone would be the loop's own."""


def _with_a_way(record: ResponseRecord, cause: Diagnosis) -> Diagnosis:
    """What stays open, with what would settle it where its reason does not say: a setpoint step shows the process."""
    told = "setpoint step" in cause.reason or cause.reason.endswith("needed")
    if cause.cause is not Cause.UNKNOWN or record.response.sp_changed or told:
        return cause
    return replace(cause, reason=f"{cause.reason}; a setpoint step would tell more")


def _held_up(record: ResponseRecord, cause: Diagnosis, settings: RetunerSettings) -> bool:
    """Whether a swing taken for one from outside is held up by the output's limits: then the model decides."""
    return cause.cause in FOREIGN_SWINGS and swings_between_limits(record, settings)


def swings_between_limits(record: ResponseRecord, settings: RetunerSettings) -> bool:
    """Whether the output goes from limit to limit."""
    return touches_limits(record.samples, record.response, settings.limit_swing)


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


def identification(found: Findings) -> Findings:
    """What does the record say of the process, with what is known of the region, or of its neighbours?"""
    record, settings, beside = found.record, found.settings, found.beside
    if found.steps is not None:
        learned = learned_by_sequences(record, settings, found.steps)
    elif short := too_few(record.window):
        return found.end(NOT_KNOWN, short)
    else:
        learned, beside = learned_by_itself(record, settings, beside)
        learned = beside_sequences(record, settings, learned)
    found = replace(found, beside=beside)
    if learned is None:
        return found.end(NOT_KNOWN, "no model explains how pv follows the setpoint")
    unexplained = learned.estimate.unexplained(float(np.ptp(found.record.window.pv)))
    if learned.valve is not None:  # what the loop by itself leaves open
        unexplained = max(unexplained, learned.valve.left)
    return replace(found, learned=learned, unexplained=unexplained)


def hidden_cause(found: Findings) -> Findings:
    """Does something else hide under the response, which its model leaves open?

    The loads before steps to and fro have told it.
    """
    record, settings = found.record, found.settings
    if record.crossed or found.steps is not None:
        return found
    if found.growth is not None or found.unexplained <= settings.swing.unexplained:
        return found
    asked = record.samples, record.response, record.in_force, settings.swing, settings.diagnosis
    cause, again = diagnosis_of_rest(*asked)
    if cause is None or _held_up(record, cause, settings):
        return found
    if again:
        found = replace(found, foreign=min(record.foreign + 1, settings.swing.most_counted))
    return found.other_cause(_with_a_way(record, cause))


def region_model(found: Findings) -> Findings:
    """What is known of the region now, what does that rest on, and what settings follow?"""
    record, settings, learned = found.record, found.settings, found.learned
    assert learned is not None  # after the identification
    if learned.region_model is None:
        return replace(found, excitation_now=record.excitation.with_response(record.response))
    swinging = None if record.crossed or found.steps is not None else _known_of_swing(record, settings)
    in_use = swinging or learned.region_model
    before = record.excitation  # what the model rested on before this response
    if not swinging and learned.agreement in ANEW:
        before = before.of_alternative() if learned.agreement == Agreement.CHANGED else Excitation()
    clear, now = unambiguous(found, learned), before
    if not swinging and learned.agreement != Agreement.SILENT:  # what cannot tell is nothing that a model rests on
        rested = from_rest_to_rest(record.samples, record.response, settings.swing)
        now = now.with_response(record.response, clear=clear, rested=rested)
    if learned.agreement == Agreement.CONTRADICTS:
        now = replace(now, alternative=int(clear))
    now = replace(now, lost=0)  # until the proof says otherwise
    return replace(
        found, in_use=in_use, region_model=in_use, wanted=wanted_of(record, in_use, settings), clear=clear,
        excitation_before=before, excitation_now=now, excitation=now,
    )  # fmt: skip


def _known_of_swing(record: ResponseRecord, settings: RetunerSettings) -> RegionModel | None:
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


def unambiguous(found: Findings, learned: Learned) -> bool:
    """Whether the response is the loop's own doing beyond doubt.

    One that crossed a boundary is where it is a setpoint step that the process in motion explains by itself. One that
    is seen through a valve is not.
    """
    record, loads = found.record, len(learned.estimate.load_times_s)
    if learned.valve is not None:
        return False
    if found.steps is not None:
        return learned.agreement is not Agreement.CONTRADICTS
    if record.crossed:
        return record.response.sp_changed and learned.agreement in {Agreement.FIRST, Agreement.AGREES}
    return is_clear(record.samples, record.response, found.unexplained, loads, found.settings.swing)


LAG_DOMINANT = 8.0
"""tau1 over theta from which SIMC's integral time no longer is tau1 (Skogestad 2003, at tau_c = theta)."""
OVER_NOMINAL = 1.03
"""Ms over the proposal's nominal limit from which a gain in force is too large: what a drifting process does to Ms is
known a few percent late, so waiting for the design limit itself is waiting until it has been passed."""


def propose(region_model: RegionModel, log: LogModel, in_force: PidGains, settings: RetunerSettings) -> RobustProposal:
    """Settings for a region, with half a sampling interval of dead time more: what a sampled controller sees.

    region_model : what is known. log : the same as it may be met now (`predicted`). in_force : gains running now.
    """
    dt_s, best, cause = settings.sample_time_s, log.model(), settings.cause
    # Largest Ms on the best model: of a lag-dominant process the guard's own limit, of the others less
    plain = without_second_lag(best)
    lag_dominant = not plain.tau1_s or plain.tau1_s > LAG_DOMINANT * plain.theta_s
    ms = settings.guard.ms_nominal if lag_dominant else min(settings.robust.ms_nominal, settings.guard.ms_nominal)
    robust = replace(settings.robust, ms_nominal=ms)
    tuning = _for_controller(region_model, best, in_force, robust, settings)
    given, lagged = (in_force, tuning.gains, log.gain_uncertainty(dt_s)), with_second_lag(region_model.plausible, dt_s)
    as_well = [best, *(p.model for p in region_model.plausible[1:] if not p.excess)]

    def told(ms_high: float) -> Diagnosis:
        limits = replace(cause, ms_high=ms_high)
        each = [tuning_cause(model.seen_by_controller(dt_s), *given, limits, lagged) for model in as_well]
        return next((one for one in each if one.cause not in SWINGING), each[0])

    diagnosis = told(cause.ms_high)
    if diagnosis.cause == Cause.OK:
        closer = told(min(cause.ms_high, OVER_NOMINAL * robust.ms_nominal))
        diagnosis = closer if closer.cause == Cause.AGGRESSIVE else diagnosis
    ready = region_model.identifiable
    if not ready:
        danger = over_limit(region_model.plausible, in_force, settings, robust.believed, cause.ms_high)
        ready = danger and diagnosis.cause in SWINGING
        tuning = replace(tuning, gains=no_more_action(tuning.gains, in_force, diagnosis.cause))
    return RobustProposal(tuning, diagnosis, ready)


SHORTER = (1.0, 0.8, 0.65, 0.5)  # shares of SIMC's integral time that are tried


def _for_controller(
    known: RegionModel, best: ProcessModel, in_force: PidGains, robust: RobustSettings, settings: RetunerSettings
) -> Tuning:
    """The rule's settings for a controller whose setpoint weight is less than 1, or whose derivative is filtered.

    SIMC's integral time is that of a weight of 1. With less, pv comes to a new setpoint by integral action (Astrom &
    Hagglund 2006, section 3.4). A filter raises Ms over what SIMC's derivative has without it: a larger tau_c alone
    would pay for that with a longer integral time. A shorter one is taken where the IAE after a setpoint and a load
    step, over that of SIMC's, is less in the mean, and Ms within the same limits.
    """
    dt_s, b = settings.sample_time_s, settings.setpoint_weight
    filtered = in_force.kd != 0.0 and settings.filter_s > 0.0
    shares = SHORTER if (b < 1.0 or filtered) and not asks_for_integral(best) else SHORTER[:1]
    if filtered:
        robust = replace(robust, tau_f_s=settings.filter_s, ms_nominal=settings.guard.ms_nominal)
    tried = [replace(robust, tau_i_share=share) for share in shares]
    first, *more = (robust_simc_on(best, known.plausible, dt_s, one, in_force) for one in tried)
    held = [one for one in more if one.ms_nominal <= robust.ms_nominal and one.ms_worst <= robust.ms_worst]
    if not held:
        return first.tuning
    sets, loop = [one.tuning for one in (first, *held)], LoopSettings(dt_s, b, settings.filter_s)
    judged = outlooks([Plausible(best, 0.0)], [Choosable(one.gains) for one in sets], None, loop, settings.choice)
    return min(zip(sets, judged, strict=True), key=lambda pair: pair[1].j)[0]


def no_more_action(wanted: PidGains, in_force: PidGains, cause: Cause) -> PidGains:
    """The wanted gains with no gain larger, and no integral time shorter, than in force.

    Where the integral is too strong for the gain, it follows a gain that was cut: the wanted integral time stays.
    """
    kp, ki, kd = (min(getattr(wanted, name), getattr(in_force, name), key=abs) for name in ("kp", "ki", "kd"))
    longest = [kp * gains.ki / gains.kp for gains in (in_force, wanted) if gains.kp]
    if cause != Cause.SLOW_INTEGRATING:
        longest = longest[:1]
    return PidGains(kp, min(ki, *longest, key=abs), kd) if longest else PidGains(kp, ki, kd)


def over_limit(
    allowed: Sequence[Plausible], gains: PidGains, settings: RetunerSettings, excess: float, limit: float
) -> bool:
    """Whether gains are over an Ms limit on every model that is believed to within an excess; of infinity: unstable."""
    found = [p.model.seen_by_controller(settings.sample_time_s).linear() for p in believed(allowed, excess)]
    return bool(found) and all(sensitivity_peak(process, gains, settings.filter_s) >= limit for process in found)


def too_bold(allowed: Sequence[Plausible], in_force: PidGains, after: PidGains, settings: RetunerSettings) -> str:
    """Words for a step to more action that exceeds its Ms limit on a model that the records allow; else empty.

    What does not carry settings may still say how far not to go.
    """
    if less_of_everything(in_force, after):
        return ""
    models = [p.model.seen_by_controller(settings.sample_time_s) for p in believed(allowed, settings.robust.believed)]
    ms = max((sensitivity_peak(model.linear(), after) for model in models), default=0.0)
    return f"on a plausible model Ms would be {ms:.2f}" if ms > settings.cause.ms_high else ""


BEYOND = 1.05
"""Times the limit of a cause above which a set is one at a boundary: the neighbour's model moves with its records."""
BETWEEN = "ms_between"  # evidence that a set is over its limit on the way to a neighbour: the Ms there


def tuning_of(known: KnownProcesses, region: int, in_force: PidGains) -> RobustProposal:
    """What the rule gives for a region, eased to what its part of the ways to the neighbours bears, and whether its
    tuning is a cause (guard/both_sides_of_boundary.py).

    In an interpolated table what ran, in_force, is a mean of several sets: asked is what the region's own does.
    """
    settings, hard = known.settings, known.table.lookup is Lookup.HARD
    dt_s, guard, model = settings.sample_time_s, settings.guard, known.where_gains_run[region]
    log, own = known.likeliest(region), in_force if hard else known.table.gains_of(region)
    found, process = propose(model, log, own, settings), log.model()
    boundaries = known.boundaries(region)
    limit, high = guard.ms_nominal, settings.cause.ms_high * (BEYOND if hard else 1.0)
    easier = eased(found.tuning.gains, boundaries, process, limit, dt_s, settings.filter_s)
    if easier == found.tuning.gains:
        return found
    given = (process.seen_by_controller(dt_s), own, easier, log.gain_uncertainty(dt_s), settings.cause)
    told = tuning_cause(*given, with_second_lag(model.plausible, dt_s))
    found = replace(found, tuning=replace(found.tuning, gains=easier), diagnosis=told)
    worst = worst_between(boundaries, process, own, dt_s, settings.filter_s)
    if worst is None or worst.ms <= high or abs(easier.ki) >= abs(own.ki):
        return found
    seen = "the loop is unstable" if math.isinf(worst.ms) else over_words(worst.ms, high)
    words = f"{seen} on the way to region {worst.to}"
    evidence = {**found.diagnosis.evidence, BETWEEN: worst.ms}
    return replace(found, diagnosis=Diagnosis(Cause.AGGRESSIVE, found.diagnosis.confidence, evidence, words))


STEPS = (joining, action, admission, swing, identification, hidden_cause, region_model)
"""In their order: what else may be behind the response comes before what it teaches."""
