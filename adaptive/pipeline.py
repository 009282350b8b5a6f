"""What a completed response leads to, a line a stage; each stage may end it with its reason.

    response -> admission -> learning -> cause -> proposal -> proof -> outcome

Pure functions over one `Case`: everything that the outcome depends on is in it. The Retuner keeps what was learned.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from retuner.adaptive.belief import Belief
from retuner.adaptive.decision import Basis
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.tuning_cause import tuning_cause
from retuner.adaptive.estimate import LogModel
from retuner.adaptive.guard import Verdict, prove
from retuner.adaptive.process import ProcessModel
from retuner.adaptive.response import Response
from retuner.adaptive.retuner_settings import RetunerSettings
from retuner.adaptive.rules.simc import simc_at_most_ms
from retuner.adaptive.rules.tuning import Tuning
from retuner.adaptive.sample import LoopSample, Window
from retuner.adaptive.tracker import Learned, learn, predicted
from retuner.schedule.gains import PidGains
from retuner.schedule.table import GainTable


@dataclass(frozen=True, slots=True)
class Case:
    """One response and what it is judged on.

    region : index. window : the response with some time before it. samples : all that are kept, the newest last.
    table : gains in force in every region; commissioned : as they were at first. beliefs : what is known, by region.
    """

    region: int
    response: Response
    window: Window
    samples: Sequence[LoopSample]
    table: GainTable
    commissioned: GainTable
    beliefs: Mapping[int, Belief]

    @property
    def in_force(self) -> PidGains:
        """The region's gains."""
        return self.table.gains_of(self.region)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the stages found; those that were not reached are None. code : name of the reason, for machines."""

    code: str
    reason: str
    learned: Learned | None = None
    diagnosis: Diagnosis | None = None
    proposal: Tuning | None = None
    basis: Basis | None = None
    verdict: Verdict | None = None
    numbers: dict[str, float] = field(default_factory=dict)


def decide(case: Case, settings: RetunerSettings) -> Outcome:
    """The pipeline."""
    refusal = _inadmissible(case, settings)
    if refusal is not None:
        return Outcome(f"not_admitted_{refusal.cause}", refusal.reason, diagnosis=refusal)
    try:
        learned = learn(
            case.beliefs.get(case.region), case.window, case.in_force.direction, settings.tracker, settings.fit
        )
    except np.linalg.LinAlgError as error:  # a record that breaks the arithmetic must not break the supervision
        return Outcome("fit_failed", f"the fit failed: {error}")
    if learned.belief is None:
        return Outcome("not_identifiable", learned.estimate.reason, learned)
    log = predicted(learned.belief, float(case.window.t_s[-1]), settings.tracker)
    tuning, diagnosis = _diagnose(log, case.in_force, settings)
    if not diagnosis.retune:
        return Outcome(str(diagnosis.cause), diagnosis.reason, learned, diagnosis)
    verdict = prove(tuning, log, settings.sample_time_s / 2, case.in_force, settings.guard)
    reason = diagnosis.reason if verdict.accepted else str(verdict.ruling)
    return Outcome(verdict.ruling.name.lower(), reason, learned, diagnosis, tuning, Basis.MODEL, verdict)


def _inadmissible(case: Case, settings: RetunerSettings) -> Diagnosis | None:
    """Why a record may not teach anything, if so."""
    window, response = case.window, case.response
    recent = islice(reversed(case.samples), len(window.t_s))
    share = sum(1 for sample in recent if sample.limited) / len(window.t_s)
    evidence = {"limited_share": share, "peaks": float(len(response.peaks))}
    if response.t_start_s < case.samples[0].t_s:
        reason = f"the response is longer than the {settings.history} samples kept: its beginning is missing"
        return Diagnosis(Cause.UNKNOWN, 1.0, evidence, reason)
    if share > settings.cause.saturated_share:
        reason = f"the controller output stood at a limit for {share:.0%} of the response"
        return Diagnosis(Cause.SATURATION, 1.0, evidence, reason)
    for name, values in (("co", window.co), ("pv", window.pv)):
        if values.max() == values.min():
            return Diagnosis(Cause.UNKNOWN, 1.0, evidence, f"{name} does not move: nothing to learn from")
    return None


def _diagnose(log: LogModel, in_force: PidGains, settings: RetunerSettings) -> tuple[Tuning, Diagnosis]:
    """What the rule would give, and whether the tuning is the cause."""
    model = _sampled(log.model(), settings)
    guard = settings.guard
    tuning, _ = simc_at_most_ms(model, min(guard.ms_target, guard.ms_nominal), guard.tau_c_max_ratio)
    unsure = log.gain_uncertainty(settings.sample_time_s / 2)
    return tuning, tuning_cause(model, in_force, tuning.gains, unsure, settings.cause)


def _sampled(model: ProcessModel, settings: RetunerSettings) -> ProcessModel:
    """The model with half a sampling interval of dead time added: what a sampled controller sees."""
    return replace(model, theta_s=model.theta_s + settings.sample_time_s / 2)
