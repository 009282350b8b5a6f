"""One completed response with everything that it is judged on, the question that it raises, and the answer to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from retuner.adaptive.diagnosis.cause import Diagnosis
from retuner.adaptive.diagnosis.oscillation_online import Standing
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.guard import Verdict
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import Learned
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.response import Response
from retuner.adaptive.signals.sample import LoopSample, Window
from retuner.adaptive.supervision.decision import Basis
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.adaptive.trial.expectation import Promise
from retuner.adaptive.trial.posterior_check import PosteriorCheck
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable


@dataclass(frozen=True, slots=True)
class ResponseRecord:
    """One response and what it is judged on.

    region : index. window : the response with some time before it. samples : all that are kept, the newest last.
    table : gains in force in every region; commissioned : as they were at first. region_models : what is known, by
    region.
    standing : an oscillation of this region that was explained before. excitation : what its model rests on.
    at : the scheduling values at its end.
    """

    region: int
    response: Response
    window: Window
    samples: Sequence[LoopSample]
    table: GainTable
    commissioned: GainTable
    region_models: Mapping[int, RegionModel]
    standing: Standing | None = None
    excitation: Excitation = field(default_factory=Excitation)
    at: tuple[float, float] = (0.0, 0.0)

    @property
    def in_force(self) -> PidGains:
        """The gains that ran: the region's own, or in an interpolated table the mean at these scheduling values."""
        return self.table.at(self.region, *self.at)


@dataclass(frozen=True, slots=True)
class StageResult:
    """What the stages found; those that were not reached are None.

    code : name of the reason, for machines. region_model : what is known of the region from now on, None for as before.
    forget : what was known of the region is refuted. standing : an oscillation that is explained, to be remembered.
    excitation : what the region model rests on.
    promise : what the proved gains promise, worked out where they may be written at all. posterior : what the record
    says of both sets of a trial that it ran under.
    """

    code: str
    reason: str
    learned: Learned | None = None
    region_model: RegionModel | None = None
    diagnosis: Diagnosis | None = None
    proposal: Tuning | None = None
    basis: Basis | None = None
    verdict: Verdict | None = None
    standing: Standing | None = None
    excitation: Excitation | None = None
    numbers: dict[str, float] = field(default_factory=dict)
    forget: bool = False
    promise: Promise | None = None
    posterior: PosteriorCheck | None = None


@dataclass(frozen=True, slots=True)
class Question:
    """What a completed response asks; plain values, so that the answer may be worked out anywhere (`pipeline.decide`).

    sample_number : of the sample that raised it, counted by the retuner from 1. trial : where the region stood then.
    """

    record: ResponseRecord
    settings: RetunerSettings
    sample_number: int
    trial: Trial

    @property
    def t_s(self) -> float:
        """Time of the sample that raised it."""
        return self.record.samples[-1].t_s


class Overtaken(StrEnum):
    """Why an answer that comes later than its question is not entered any more."""

    TRIAL_ENDED = "the trial under which the response ran has ended since"
    REGION_LEFT = "the loop has left the region since"
    BROKEN_OFF = "the record was broken off since: samples are missing, in manual, or without a scheduling variable"
    GAINS_CHANGED = "other gains have come into force since"


LEFT = {
    False: StageResult("left_region", "the response left its region; it teaches nothing of either"),
    True: StageResult(
        "variable_unknown",
        "the scheduling variable is not known any more: nobody can say to which region "
        "the response belongs; it teaches nothing",
    ),
}
"""What follows from a response that was cut off, by whether a scheduling variable was unknown."""

PASSED_OVER = StageResult(
    "passed_over", "the response came while the one before it was still being decided; it teaches nothing"
)
"""What follows from a response that completes while a question is open."""
