"""What the stages of the pipeline have found so far about one response; the result is built from it once."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

from retuner.adaptive.diagnosis.cause import Diagnosis
from retuner.adaptive.diagnosis.oscillation_online import Standing
from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.guard import Verdict
from retuner.adaptive.region_model.region_model import RegionModel
from retuner.adaptive.region_model.update import Learned
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.supervision.decision import Basis
from retuner.adaptive.supervision.pipeline_types import Question, ResponseRecord, StageResult
from retuner.adaptive.supervision.proposal_from_model import RobustProposal
from retuner.adaptive.supervision.settings import RetunerSettings
from retuner.adaptive.trial.expectation import Promise
from retuner.adaptive.trial.posterior_check import PosteriorCheck
from retuner.schedule.table import Lookup


class End(NamedTuple):
    """How the stages ended: name of the reason for machines, and its sentence."""

    code: str
    reason: str


@dataclass(slots=True)
class Findings:
    """One question and what is found about it, stage by stage.

    learned : what the record taught. unexplained : share of the record's pv that its model leaves open.
    in_use : what is known of the region and decides now; None where nothing is. tuning : what follows from it.
    rested_on : what in_use rested on before this response; excitation_now : with it. clear : whether the response needs
    no second opinion. The others are those of StageResult, None for as before.
    """

    question: Question
    end: End | None = None
    learned: Learned | None = None
    unexplained: float = 0.0
    in_use: RegionModel | None = None
    tuning: RobustProposal | None = None
    rested_on: Excitation = field(default_factory=Excitation)
    excitation_now: Excitation = field(default_factory=Excitation)
    clear: bool = False
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

    @property
    def record(self) -> ResponseRecord:
        """The response and what it is judged on."""
        return self.question.record

    @property
    def settings(self) -> RetunerSettings:
        """Those in force for this table: the gains of an interpolated one move without anybody changing them."""
        settings = self.question.settings
        if self.record.table.lookup is Lookup.INTERPOLATED:
            return replace(settings, swing=replace(settings.swing, same_gains=False))
        return settings

    def stop(self, code: str, reason: str) -> None:
        """The stage decides: no later one runs, but those that always do."""
        self.end = End(code, reason)

    def explained_otherwise(self, cause: Diagnosis, standing: Standing | None) -> None:
        """Something else than the tuning is behind the response: that is remembered, and nothing follows."""
        self.diagnosis, self.standing = cause, standing
        self.stop(str(cause.cause), cause.reason)

    def doubted(self, doubt: Diagnosis) -> None:
        """The change is not made: what it rests on is doubted."""
        self.diagnosis, self.basis, self.verdict = doubt, None, None
        self.stop("unconfirmed", doubt.reason)

    def result(self) -> StageResult:
        """All of it.

        Raises
        ------
        ValueError
            No stage has decided.
        """
        if self.end is None:
            raise ValueError("no stage has decided")
        return StageResult(
            code=self.end.code,
            reason=self.end.reason,
            learned=self.learned,
            region_model=self.region_model,
            diagnosis=self.diagnosis,
            proposal=self.proposal,
            basis=self.basis,
            verdict=self.verdict,
            standing=self.standing,
            excitation=self.excitation,
            numbers=self.numbers,
            forget=self.forget,
            promise=self.promise,
            posterior=self.posterior,
        )
