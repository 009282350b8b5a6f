"""What gains in force hold, and what those before them would: two questions beside the models of a region.

Before a change: do the gains in force hold a process that runs away by itself (diagnosis/unstable_process.py)?
After one to less action: was it a cure, or does the swing come from outside, so that the set before may come back?
"""

import math
from dataclasses import replace

from retuner.adaptive.decision_numbers import NO_NUMBERS, Basis
from retuner.adaptive.diagnosis.cause import Cause, Diagnosis
from retuner.adaptive.diagnosis.oscillation_online import alike_on_both_sides, through_a_change
from retuner.adaptive.diagnosis.unstable_process import UnstableProcess, unstable_process, worse_on
from retuner.adaptive.guard import prove
from retuner.adaptive.guard.request import Support
from retuner.adaptive.guard.step_size import less_of_everything
from retuner.adaptive.loop.sampled import SampledLaw
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.sample import LoopMode, Window
from retuner.adaptive.supervision.known_processes import KnownProcesses, known_of
from retuner.adaptive.supervision.pipeline_types import Findings, ResponseRecord
from retuner.adaptive.supervision.proof_and_choice import unproved_request
from retuner.adaptive.trial.phase import TrialPhase
from retuner.adaptive.trial.rollback import LOST_WORDS, less_stable
from retuner.adaptive.trial.trial import Trial
from retuner.schedule.gains import PidGains
from retuner.schedule.table import Lookup

BEFORE = 5
"""Samples before a setpoint step that are looked at with it."""
FEWEST_SAMPLES = 3
"""Samples of a window."""


def runaway(found: Findings) -> None:
    """Does the process run away by itself, and would the proved change hold it worse?

    The last setpoint step under these gains shows it. What settings follow from has no such pole, and on an integrator
    in its place less gain looks safer.
    """
    record, verdict, settings = found.record, found.verdict, found.settings
    if verdict is None or verdict.gains is None or found.steps is not None or record.pattern is None:
        return
    window = _last_step(record)
    if window is None:
        return
    law = SampledLaw(record.in_force, settings.sample_time_s, settings.setpoint_weight, settings.filter_s)
    shown = unstable_process(window, law)
    if shown is None:
        return
    after = record.table.with_gains(record.region, verdict.gains).at(record.region, *record.at)
    worse = worse_on(shown, law, after, len(window.pv), settings.cause.ms_high)
    if worse is not None:
        found.doubted(_told(shown, *worse))


def _last_step(record: ResponseRecord) -> Window | None:
    """The last setpoint step under these gains, to the end of its response or to the load that came next.

    None where none is kept, or co did not follow its law.
    """
    response, revision = record.response, record.samples[-1].revision
    end_s = response.t_end_s if response.sp_changed else response.t_start_s
    kept = [s for s in record.samples if s.t_s <= end_s and s.revision == revision and s.t_s >= record.entered_s]
    at = next((i for i in range(len(kept) - 1, 0, -1) if kept[i].sp != kept[i - 1].sp), 0)
    own = kept[max(at - BEFORE, 0) :]
    followed = all(sample.mode == LoopMode.AUTO and not sample.limited for sample in own)
    return Window.of(own) if at and followed and len(own) >= FEWEST_SAMPLES else None


def _told(shown: UnstableProcess, before: float, after: float) -> Diagnosis:
    """Why nothing changes. before, after : Ms on it."""
    then = f"Ms {before:.2f} -> {after:.2f}" if math.isfinite(after) else f"Ms {before:.2f} now"
    what = "make it less robust" if math.isfinite(after) else "not hold it"
    reason = (
        f"the process runs away by itself, by a factor of 2.7 in {shown.grows_s:.3g} s; the gains hold it. "
        f"What the rule gives would {what} ({then}); there is no rule for such a process"
    )
    evidence = {"runs_away_s": shown.grows_s, "ms": before}
    return Diagnosis(Cause.UNKNOWN, 0.5, evidence, reason)


def cut_refuted(found: Findings) -> None:
    """Was less action a cure for what came from outside? Then the set that ran before comes back, on trial.

    Less action was written because a model said that the loop swings by itself. A tone that goes on through that change
    as it was before, and that no process explains under both sets, refutes the model: the swing was not the loop's own.
    What a clear setpoint step has shown of the process is not refuted so. The way back is through the one door of all
    (trial/rollback.py): where the models that are still allowed call that set less stable, it stays out.
    """
    record, trial, cause = found.record, found.question.trial, found.diagnosis
    if cause is None or cause.cause is not Cause.EXTERNAL or trial.phase is not TrialPhase.IDLE or record.crossed:
        return
    before = _cut_from(trial, record.in_force, found.settings.trial.harmless_decay)
    if before is None or record.excitation.clear or record.table.lookup is Lookup.INTERPOLATED:
        return
    settings = found.settings
    here = [sample for sample in record.samples if sample.t_s >= record.entered_s]
    period_s = through_a_change(here, record.in_force, settings.diagnosis)
    if period_s is None or found.growth is not None or not alike_on_both_sides(here, period_s, record.response.band):
        return
    now_s = float(record.window.t_s[-1])
    known = known_of(KnownProcesses(record.table, record.region_models, now_s, settings), record.region)
    if known.processes:
        kept_out = less_stable(before, record.in_force, known, settings.trial.harmless_ms)
    else:
        kept_out = LOST_WORDS if trial.sets.lost else ""
    if kept_out:
        found.stop("tone_goes_on", NOT_BACK.format(period=period_s, why=kept_out))
        return
    tuning, tables = Tuning("set that ran before", "parallel", before), (record.table, record.commissioned)
    request = unproved_request(tuning, record.region, tables, settings)
    request = replace(request, evidence=replace(request.evidence, support=Support.RAN))
    verdict = prove(request, settings.guard)
    found.forget, found.region_model, found.excitation = True, None, None
    if verdict.accepted:
        found.proposal, found.verdict, found.basis = tuning, verdict, Basis.RAN
        found.numbers = NO_NUMBERS
    found.stop(verdict.code, REFUTED.format(period=period_s, ruling=verdict.sentence))


NOT_BACK = (
    "the oscillation of {period:.3g} s goes on as before the last change, so it comes from outside. The previous gains "
    "do not come back: {why}. A setpoint step would show the process"
)
"""The reason where a tone goes on, and the way back is closed."""
REFUTED = (
    "the oscillation of {period:.3g} s goes on as before the last change. No process explains it under both gain sets, "
    "so it comes from outside and less action was no cure; {ruling}"
)
"""The reason where a cut is taken back."""


def _cut_from(trial: Trial, in_force: PidGains, harmless_decay: float) -> PidGains | None:
    """The newest set that ran before and acted more, where the last change was less action against a swing."""
    if trial.prediction is None or trial.new != in_force:
        return None
    said = trial.prediction
    swung = max(said.decay_before(setpoint=True), said.decay_before(setpoint=False), said.decay_seen or 0.0)
    if said.models and swung <= harmless_decay:
        return None
    ran = (gains for gains in trial.earlier if gains != in_force and less_of_everything(gains, in_force))
    return next(ran, None)
