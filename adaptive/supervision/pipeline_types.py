"""One completed response with everything that it is judged on, the question that it raises, what the stages find about
it, and the answer that is built from that.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from retuner.adaptive.decision_numbers import NO_NUMBERS, Basis, Numbers
from retuner.adaptive.diagnosis.cause import Diagnosis
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.explanations.book import Book
from retuner.adaptive.explanations.settings_by_book import BookNumbers
from retuner.adaptive.guard import Verdict
from retuner.adaptive.region_model.boundary_crossing import ways_of
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import Learned, TrackerSettings, predicted
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.growth import Growth
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.signals.setpoint_steps import SetpointSteps
from retuner.adaptive.signals.step_sequence import step_sequence
from retuner.adaptive.supervision.admission import Admission, Ground, admit, inside_region, setpoint_led
from retuner.adaptive.supervision.decision import WRITES, Action, Decision, Mode
from retuner.adaptive.supervision.known_processes import KnownProcesses
from retuner.adaptive.supervision.proposal_from_model import RobustProposal
from retuner.adaptive.supervision.response_finder import FinderState, Left
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.phase import UNDECIDED, TrialEvent, TrialPhase
from retuner.adaptive.trial.posterior_check import PosteriorCheck
from retuner.adaptive.trial.prediction import Prediction
from retuner.adaptive.trial.rollback import StillAllowed
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, fields, replace
from retuner.schedule.table import GainTable, Lookup

PROCESS_CHANGES_OVER = 0.1
"""Share of an axis along which a process may be expected to change by twice what records of one place differ by:
before any record a factor of 4 over the whole is one standard deviation (schedule_design/record_stretches.py)."""


@dataclass(frozen=True)
class ResponseRecord:
    """One response and what it is judged on.

    region : index. window : the response with some time before it. samples : all that are kept, the newest last.
    table : gains in force in every region; commissioned : as they were at first. region_models : what is known, by
    region.
    foreign : for how many more responses under the gains in force something else than the tuning won here than lost.
    excitation : what the region's model rests on.
    at : the scheduling values at its end. entered_s : since when the loop was in the region at its end.
    passed_over : responses to a led setpoint since that was last said. book : what all samples have shown of the
    region, None before they were looked at.
    """

    region: int
    response: Response
    window: Window
    samples: Sequence[LoopSample]
    table: GainTable
    commissioned: GainTable
    region_models: Mapping[int, RegionModel]
    foreign: int = 0
    excitation: Excitation = field(default_factory=Excitation)
    at: tuple[float, float] = (0.0, 0.0)
    entered_s: float = -math.inf
    passed_over: int = 0
    book: Book | None = None

    @property
    def own(self) -> Sequence[LoopSample]:
        """The samples of the response itself."""
        start_s, end_s = self.response.t_start_s, self.response.t_end_s
        return [sample for sample in self.samples if start_s <= sample.t_s <= end_s]

    @cached_property
    def crossed(self) -> bool:
        """Whether the response came from another region: by its gains, or, along the setpoint, by its pv."""
        if self.entered_s > self.response.t_start_s:
            return True
        regions = self.table.regions
        if not self.response.sp_changed or all(axis.variable != "sp" for axis in regions.axes):
            return False
        spans = [regions.span(self.region, axis) for axis in range(len(regions.axes))]
        return any(
            axis.variable == "sp" and not low <= (min(way) + max(way)) / 2 <= high
            for axis, way, (low, high) in zip(regions.axes, ways_of(regions, self.own), spans, strict=True)
        )

    @cached_property
    def moved(self) -> bool:
        """Whether the process was at places so far apart, within a table of several regions, that one linear model of
        the response would be a fiction.
        """
        return self.share > PROCESS_CHANGES_OVER

    @cached_property
    def share(self) -> float:
        """How far the process went, as a share of the axis on which it went farthest; 0 in a table of one region."""
        regions = self.table.regions
        if len(regions) == 1:
            return 0.0
        ways = zip(regions.axes, ways_of(regions, self.own), strict=True)
        return max(float(np.ptp(way)) / (axis.high - axis.low) for axis, way in ways)

    @property
    def pattern(self) -> Response | None:
        """The response as one that the gains in force have made, None where those of two sets have."""
        return None if self.crossed or self.response.taken_over else self.response

    @property
    def in_force(self) -> PidGains:
        """The gains that ran: the region's own, or in an interpolated table the mean at these scheduling values."""
        return self.table.at(self.region, *self.at)

    def known_with(self, model: RegionModel, settings: RetunerSettings) -> KnownProcesses:
        """What is known at the response, its region's model as it is with it."""
        models = {**self.region_models, self.region: model}
        return KnownProcesses(self.table, models, float(self.window.t_s[-1]), settings)


@dataclass(frozen=True, slots=True)
class StageResult:
    """What the stages found; those that were not reached are None.

    code : name of the reason, for machines. region_model : what is known of the region from now on, None for as before.
    forget : what was known of the region is refuted. foreign : as in the record, with this response.
    excitation : what the region model rests on.
    prediction : what the proved gains promise, worked out where they may be written at all. posterior : what the record
    says of both sets of a trial that it ran under. beside : what is known from now on of the other regions on its way.
    elsewhere : what is due in a region where the loop is not, by its index. beside_walk : what the loop did lately
    leaves of its process beside a load that wanders as before the change of a trial; None where none did.
    book : what all samples have shown of the region by now, None for as before; all_samples : of the gains in force.
    """

    code: str
    reason: str
    learned: Learned | None = None
    region_model: RegionModel | None = None
    diagnosis: Diagnosis | None = None
    proposal: Tuning | None = None
    basis: Basis | None = None
    verdict: Verdict | None = None
    foreign: int | None = None
    excitation: Excitation | None = None
    numbers: Numbers = NO_NUMBERS
    forget: bool = False
    prediction: Prediction | None = None
    posterior: PosteriorCheck | None = None
    beside: Mapping[int, RegionModel] = field(default_factory=dict)
    elsewhere: Mapping[int, "StageResult"] = field(default_factory=dict)
    beside_walk: StillAllowed | None = None
    book: Book | None = None
    all_samples: BookNumbers | None = None


class Look(NamedTuple):
    """All samples of a region that are to be entered into its book. book : as it is, None to begin one.

    grows : the window comes again with more samples. limited : share of them with the output at a limit. due : else
    it is looked at only before a change.
    """

    book: Book | None
    window: Window
    grows: bool
    limited: float
    due: bool = True


@dataclass(frozen=True, slots=True)
class Question:
    """What a completed response asks; plain values, so that the answer may be worked out anywhere (`pipeline.decide`).

    sample_number : of the sample that raised it, counted by the retuner from 1. trial : where the region stood then.
    free : the other regions that no trial, hold or mode keeps from a change. away : those whose trial waits until the
    loop comes. look : the samples that are due to be looked at, None for none. alone : no response has completed, so
    nothing but that is asked. after : what loops on the same plant make of this and its answer; None for none. spoilt :
    which known disturbance is in the response of a trial, so that it says nothing; all samples may.
    """

    record: ResponseRecord
    settings: RetunerSettings
    sample_number: int
    trial: Trial
    free: tuple[int, ...] = ()
    away: tuple[int, ...] = ()
    look: Look | None = None
    alone: bool = False
    after: "Callable[[Question, StageResult], StageResult] | None" = None
    spoilt: str = ""

    @property
    def t_s(self) -> float:
        """Time of the sample that raised it."""
        return self.record.samples[-1].t_s


Ended = Mapping[int, TrialEvent]
"""Regions whose trial a sample ended, or where it was decided that it goes on, with the cause."""
NOBODY: Ended = {}


class SetpointLed(NamedTuple):
    """When it was last said that the setpoint is led, and how many responses were passed over since."""

    said_s: float = -math.inf
    passed_over: int = 0


class RetunerState(NamedTuple):
    """Where a retuner stands; with its table and region models, all that later decisions depend on.

    looked_s : when all samples were looked at last.
    """

    finder: FinderState
    decisions: int
    samples: int
    led: SetpointLed = SetpointLed()
    looked_s: float = -math.inf


class OpenQuestion(NamedTuple):
    """An open question: the table when it was raised, and what the same sample ended and made forgotten."""

    question: Question
    table: GainTable
    ended: Ended
    region_model: RegionModel | None
    excitation: Excitation | None


class Overtaken(StrEnum):
    """Why an answer that comes later than its question is not entered any more."""

    TRIAL_ENDED = "the trial of this response has ended meanwhile"
    REGION_LEFT = "the loop has left the region meanwhile"
    BROKEN_OFF = "the record was interrupted: samples are missing, in manual, or without a scheduling variable"
    GAINS_CHANGED = "other gains became active meanwhile"


def overtaken_by(
    opened: OpenQuestion, now_in: int | None, samples: Sequence[LoopSample], table: GainTable, phase: TrialPhase
) -> Overtaken | None:
    """Why an answer is not entered any more, if so. now_in, phase : region of the loop, and phase of the question's.

    samples, table : as they are now.
    """
    question, region = opened.question, opened.question.record.region
    if question.trial.phase in UNDECIDED and phase not in UNDECIDED:
        return Overtaken.TRIAL_ENDED
    if now_in != region:
        return Overtaken.REGION_LEFT
    if samples[0].t_s > question.t_s:
        return Overtaken.BROKEN_OFF
    moved = table.lookup is Lookup.HARD and samples[-1].revision != question.record.samples[-1].revision
    if table is not opened.table or (moved and not opened.ended):
        return Overtaken.GAINS_CHANGED
    return None


LOST = StageResult(
    "variable_unknown",
    "the scheduling variable was lost, so the region of the response is unknown: not used to update the model",
)
"""What follows from a response that was cut off, because it is not known where the loop is."""


def left(seen: Left, settings: RetunerSettings) -> StageResult | None:
    """What is said of a response that was cut off, or of gaps between which none is ever complete; None for nothing."""
    if seen.under_way:
        return LOST
    if not seen.broken or settings.mode_of(seen.region) is Mode.OFF:
        return None
    return StageResult(
        "broken_off",
        f"{seen.broken} gaps of more than {settings.gap_samples} sample times in a row came before a response was "
        f"complete: nothing can be evaluated; find out where samples are lost",
    )


NOT_EVALUATED = "not_evaluated"
"""Code: a defect, or a record that nobody thought of, ended the evaluation."""


def not_evaluated(where: str, error: BaseException) -> StageResult:
    """What follows from a response whose evaluation failed: it changes neither model nor gains, and it is said.

    where : the stage.
    """
    what = " ".join(f"{type(error).__name__}: {error}".split())[:MOST_TOLD]
    return StageResult(
        NOT_EVALUATED,
        f"not evaluated: stage {where!r} failed ({what}); this response changes neither the model nor the gains",
    )


MOST_TOLD = 200
"""Characters that are told of an error."""

OTHER_LOOP = "other_loop"
"""Code: another loop on the same plant moved, a known disturbance that is no verdict on this one."""


class Step(NamedTuple):
    """What one sample led to: a decision that needs no fit, a question, both (a trial ended with it) or neither."""

    decision: Decision | None = None
    question: Question | None = None


NOTHING = Step()
"""What most samples lead to."""


class End(NamedTuple):
    """How the stages ended: name of the reason for machines, and its sentence."""

    code: str
    reason: str


@dataclass(slots=True)
class Findings:
    """One question and what is found about it, stage by stage.

    growth : of a swing that only the loop itself can make. learned : what the record taught.
    unexplained : share of the record's pv that its model leaves open.
    in_use : what is known of the region and decides now; None where nothing is. tuning : what follows from it.
    joined : setpoint steps to and fro of which the record was made, 0 for one response as it came. steps : these.
    excitation_before : what in_use rested on before this response; excitation_now : with it. clear : whether the
    response needs no second opinion. expected : why the change is worth it. The others are those of StageResult, None
    for as before.
    """

    question: Question
    end: End | None = None
    joined: int = 0
    steps: SetpointSteps | None = None
    growth: Growth | None = None
    learned: Learned | None = None
    unexplained: float = 0.0
    in_use: RegionModel | None = None
    tuning: RobustProposal | None = None
    excitation_before: Excitation = field(default_factory=Excitation)
    excitation_now: Excitation = field(default_factory=Excitation)
    clear: bool = False
    region_model: RegionModel | None = None
    diagnosis: Diagnosis | None = None
    proposal: Tuning | None = None
    basis: Basis | None = None
    verdict: Verdict | None = None
    foreign: int | None = None
    excitation: Excitation | None = None
    numbers: Numbers = NO_NUMBERS
    forget: bool = False
    prediction: Prediction | None = None
    expected: str = ""
    posterior: PosteriorCheck | None = None
    beside_walk: StillAllowed | None = None
    beside: Mapping[int, RegionModel] = field(default_factory=dict)
    elsewhere: Mapping[int, StageResult] = field(default_factory=dict)
    book: Book | None = None
    all_samples: BookNumbers | None = None

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

    def stop(self, code: str, reason: str) -> None:
        """The stage decides: no later one runs, but those that always do."""
        together = f"{self.joined} setpoint steps to and fro, joined: " if self.joined else ""
        valve = self.learned.valve if self.learned is not None else None
        self.end = End(code, together + reason + (f"; {valve.sentence}" if valve is not None else ""))

    def explained_otherwise(self, cause: Diagnosis) -> None:
        """Something else than the tuning is behind the response: nothing follows."""
        self.diagnosis = cause
        self.stop(str(cause.cause), cause.reason)

    def doubted(self, doubt: Diagnosis) -> None:
        """The change is not made: what it rests on is doubted."""
        self.diagnosis, self.basis, self.verdict = doubt, None, None
        self.stop("unconfirmed", doubt.reason)

    def result(self) -> StageResult:
        """All findings as one result.

        Raises
        ------
        ValueError
            No stage has decided.
        """
        if self.end is None:
            raise ValueError("no stage has decided")
        told = {one.name: getattr(self, one.name) for one in fields(StageResult) if one.name not in End._fields}
        return StageResult(*self.end, **told)


def with_outcome(
    made: Decision, outcome: StageResult, tracker: TrackerSettings, now_s: float, *, accepted: bool
) -> Decision:
    """The record of a decision with what the stages found; accepted : gains may be written, as far as proof and trial
    are concerned.
    """
    verdict, learned = outcome.verdict, outcome.learned
    region_model = learned.region_model if learned else None
    wanted = Action.COMMIT if made.mode in WRITES else Action.ADVISE
    return replace(
        made,
        action=wanted if accepted else Action.NONE,
        gains_after=verdict.gains if verdict and accepted else None,
        numbers=outcome.numbers,
        estimate=learned.estimate if learned else None,
        agreement=learned.agreement if learned else None,
        records=region_model.records if region_model else 0,
        known=predicted(region_model, now_s, tracker) if region_model else None,
        diagnosis=outcome.diagnosis,
        basis=outcome.basis,
        proposal=outcome.proposal,
        verdict=verdict,
        all_samples=outcome.all_samples,
    )


def held(outcome: StageResult, trial: Trial, now_s: float) -> StageResult:
    """The outcome with the reason why nothing may be changed now, when something was accepted."""
    if outcome.verdict is None or not outcome.verdict.accepted:
        return outcome
    words = str(trial.phase)
    if trial.phase == TrialPhase.COOLING:
        words += f" for another {max(trial.until_s - now_s, 0.0):,.0f} s after {trial.cause}"
    elif trial.phase == TrialPhase.LOCKED:
        words += f" after {trial.undos} rollbacks; an operator must unlock the region"
    elif trial.phase == TrialPhase.IDLE:
        words = "a change in another region is being written"
    return replace(outcome, code=f"held_{trial.phase.name.lower()}", reason=f"no change now: {words}")


# A setpoint that another loop leads. The slave of a cascade completes a response every few samples, and none of them
# may teach. One verdict said two thousand times a day hides every other row of a ledger. So such a response raises no
# question until `led_again_s` has passed; it is counted. What else is wrong with a response (telemetry, the sensor, a
# controller that acts the wrong way) is said as ever.


TOLD_STEPS = 2
"""Whole steps to and fro after which the next ones are no news."""


def admitted(record: ResponseRecord, settings: RetunerSettings) -> Admission:
    """Whether a response may teach; the gains of an interpolated table move with it, and the fit allows that."""
    rules = settings.admission
    if record.table.lookup is Lookup.INTERPOLATED or record.crossed:
        rules = replace(rules, changes_most=len(record.samples))
    inside = None if record.crossed else inside_region(record.table.regions, record.region)
    ki = record.in_force.ki
    return admit(record.window, record.samples, record.response, rules, inside, settings.pv_range, ki)


def passed_over(led: SetpointLed, record: ResponseRecord, settings: RetunerSettings) -> bool:
    """Whether a response says nothing but what was said lately: that the setpoint is led, or goes to and fro.

    One that ends with the output at a limit is asked: that is how a controller ends that acts the wrong way.
    """
    newest, rules = record.samples[-1], settings.admission
    lately = newest.t_s - led.said_s < rules.led_again_s and not newest.limited
    if lately and setpoint_led(record.window, record.response, rules):
        return admitted(record, settings).ground is Ground.SETPOINT_LED
    found = step_sequence(record.samples)
    return found is not None and found.closed is None and len(found.whole) > TOLD_STEPS


def said(led: SetpointLed, record: ResponseRecord, code: str) -> SetpointLed:
    """What is kept after a decision of that code on a response."""
    return SetpointLed(record.samples[-1].t_s) if code == Ground.SETPOINT_LED.name.lower() else led
