"""One completed response with everything that it is judged on, and the question that it raises: when there is none, and
when its outcome is not entered any more.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.explanations.book import Book
from retuner.adaptive.region_model.boundary_crossing import ways_of
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.signals.step_sequence import step_sequence
from retuner.adaptive.supervision.admission import Admission, Ground, admit, inside_region, setpoint_led
from retuner.adaptive.supervision.decision import Decision, Mode, Outcome
from retuner.adaptive.supervision.known_processes import KnownProcesses
from retuner.adaptive.supervision.response_finder import FinderState, Left
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.adaptive.trial.phase import UNDECIDED, TrialEvent, TrialPhase
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace
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
    foreign : responses under the gains in force that another cause explains, less those that the loop itself explains.
    excitation : what the region's model rests on.
    at : the scheduling values at its end. entered_s : since when the loop was in the region at its end.
    passed_over : responses to a led setpoint since that was last said. book : what all samples have shown of the
    region, None before they were looked at. known : see known_with.
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
    known: list[KnownProcesses] = field(default_factory=list, init=False, repr=False, compare=False)

    @property
    def own(self) -> Sequence[LoopSample]:
        """The samples of the response itself."""
        start_s, end_s = self.response.t_start_s, self.response.t_end_s
        return [sample for sample in self.samples if start_s <= sample.t_s <= end_s]

    @cached_property
    def crossed(self) -> bool:
        """Whether the response came from another region: by its gains, or, along the setpoint, by its pv."""
        start_s, own = self.response.t_start_s, self.own
        came_with_it = self.samples[0].t_s < self.entered_s == start_s  # its own setpoint step took the loop here
        if self.entered_s > start_s or (came_with_it and own[0].revision != own[-1].revision):
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

    def admission(self, settings: RetunerSettings) -> Admission:
        """Whether the response may teach; the gains of an interpolated table move with it, and the fit allows that."""
        rules = settings.admission
        if self.table.lookup is Lookup.INTERPOLATED or self.crossed:
            rules = replace(rules, changes_most=len(self.samples))
        inside = None if self.crossed else inside_region(self.table.regions, self.region)
        ki = self.in_force.ki
        return admit(self.window, self.samples, self.response, rules, inside, settings.pv_range, ki)

    def known_with(self, model: RegionModel, settings: RetunerSettings) -> KnownProcesses:
        """What is known at the response, its region's model as it is with it: cause, proof and worth ask the same."""
        known = next((one for one in self.known if one.region_models[self.region] is model), None)
        if known is None:
            models = {**self.region_models, self.region: model}
            known = KnownProcesses(self.table, models, float(self.window.t_s[-1]), settings)
            self.known.append(known)
        return known


class Look(NamedTuple):
    """All samples of a region that are to be entered into its book. book : as it is, None to begin one.

    grows : the window comes again with more samples. limited : share of them with the output at a limit. due : else
    it is looked at only before a change. earlier : whole windows before it that are not in the book yet. swings :
    which of these windows swing between the output's limits, the last one's at the end; none for none.
    """

    book: Book | None
    window: Window
    grows: bool
    limited: float
    due: bool = True
    earlier: tuple[Window, ...] = ()
    swings: tuple[bool, ...] = ()


@dataclass(frozen=True, slots=True)
class Question:
    """What a completed response asks; plain values, so that the answer may be worked out anywhere (decide.py).

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
    after: "Callable[[Question, Outcome], Outcome] | None" = None
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

    def waited(self, sample_number: int) -> str:
        """How long its answer is waited for at a sample of that number, in words."""
        waited_s = (sample_number - self.question.sample_number) * self.question.settings.sample_time_s
        return f"{waited_s:,.0f} s" if waited_s >= 100.0 else f"{waited_s:.3g} s"


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


LOST = Outcome(
    "variable_unknown",
    "the scheduling variable was lost, so the region of the response is unknown: not used to update the model",
)
"""What follows from a response that was cut off, because it is not known where the loop is."""


def left(seen: Left, settings: RetunerSettings) -> Outcome | None:
    """What is said of a response that was cut off, or of gaps between which none is ever complete; None for nothing."""
    if seen.under_way:
        return LOST
    if not seen.broken or settings.mode_of(seen.region) is Mode.OFF:
        return None
    return Outcome(
        "broken_off",
        f"{seen.broken} gaps of more than {settings.gap_samples} sample times in a row came before a response was "
        f"complete: nothing can be evaluated; find out where samples are lost",
    )


NOT_EVALUATED = "not_evaluated"  # Code: a defect, or a record that nobody thought of, ended the evaluation


def not_evaluated(where: str, error: BaseException) -> Outcome:
    """What follows from a response whose evaluation failed: it changes neither model nor gains, and it is said.

    where : the step.
    """
    what = " ".join(f"{type(error).__name__}: {error}".split())[:MOST_TOLD]
    return Outcome(
        NOT_EVALUATED,
        f"not evaluated: {where!r} failed ({what}); this response changes neither the model nor the gains",
    )


MOST_TOLD = 200  # characters that are told of an error

OTHER_LOOP = "other_loop"
"""Code: another loop on the same plant moved, a known disturbance that is no verdict on this one."""


class Step(NamedTuple):
    """What one sample led to: a decision that needs no fit, a question, both (a trial ended with it) or neither."""

    decision: Decision | None = None
    question: Question | None = None


NOTHING = Step()  # what most samples lead to


# A setpoint that another loop leads. The slave of a cascade completes a response every few samples, and none of them
# may teach. One proof said two thousand times a day hides every other row of a ledger. So such a response raises no
# question until `led_again_s` has passed; it is counted. What else is wrong with a response (telemetry, the sensor, a
# controller that acts the wrong way) is said as ever.


TOLD_STEPS = 2  # whole steps to and fro after which the next ones are no news


def passed_over(led: SetpointLed, record: ResponseRecord, settings: RetunerSettings) -> bool:
    """Whether a response says nothing but what was said lately: that the setpoint is led, or goes to and fro.

    One that ends with the output at a limit is asked: that is how a controller ends that acts the wrong way.
    """
    newest, rules = record.samples[-1], settings.admission
    lately = newest.t_s - led.said_s < rules.led_again_s and not newest.limited
    if lately and setpoint_led(record.window, record.response, rules):
        return record.admission(settings).ground is Ground.SETPOINT_LED
    found = step_sequence(record.samples)
    return found is not None and found.closed is None and len(found.whole) > TOLD_STEPS


def said(led: SetpointLed, record: ResponseRecord, code: str) -> SetpointLed:
    """What is kept after a decision of that code on a response."""
    return SetpointLed(record.samples[-1].t_s) if code == Ground.SETPOINT_LED.name.lower() else led
