"""Pretune: the first model and the first settings of a region, from a step of co that a person commanded.

    record of the step -> model -> is the tuning in force the cause of anything? -> proposal -> proof -> decision

The record is learned as the region's first one, and what follows goes the way of every proposal: the robust rule, the
guard with its limits per change, the mode of the region, and the trial. Foxboro EXACT's pretune did the same by hand:
bump, response, settings (TI 039-200, 1995).
"""

from dataclasses import replace

import numpy as np

from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.guard import prove
from retuner.adaptive.region_model.update import update_region_model
from retuner.adaptive.signals.sample import Window
from retuner.adaptive.supervision.decision import Action, Basis, Decision, Mode
from retuner.adaptive.supervision.guard_request import change_request, promise_of, tuning_of
from retuner.adaptive.supervision.pipeline import NOT_KNOWN
from retuner.adaptive.supervision.pipeline_types import StageResult
from retuner.adaptive.supervision.retuner import Retuner

WORDS = "pretune, from a commanded step of co"
"""How its reasons begin."""


def pretune(retuner: Retuner, region: int, window: Window) -> Decision:
    """Learn from the record of a commanded step, and decide; the retuner has seen a sample at least.

    Parameters
    ----------
    region : index of the region in which the step was made. window : its record, from rest; co as applied.

    Raises
    ------
    ValueError
        There is no such region.
    """
    outcome = _outcome(retuner, region, window)
    verdict, mode = outcome.verdict, retuner.settings.mode_of(region)
    if verdict is None or verdict.gains is None or mode == Mode.OFF:
        return retuner.ordered(region, outcome)
    promised = promise_of(verdict, retuner.table, region, retuner.scheduled, None, retuner.settings)
    if mode == Mode.ADVISE:
        advised = retuner.ordered(region, outcome)
        return replace(advised, action=Action.ADVISE, gains_after=verdict.gains, promise=promised)
    return retuner.ordered(region, outcome, verdict.gains, promised)


def _outcome(retuner: Retuner, region: int, window: Window) -> StageResult:
    """What the record leads to; the model stays with the retuner."""
    settings, in_force = retuner.settings, retuner.table.gains_of(region)
    t_s = float(window.t_s[-1])
    try:
        learned = update_region_model(
            retuner.region_models.get(region), window, in_force, settings.tracker, settings.fit, retuner.scheduled
        )
    except np.linalg.LinAlgError as error:  # as in the pipeline: one record must not break the supervision
        return StageResult("fit_failed", f"{WORDS}: the fit failed: {error}")
    if learned.region_model is None:
        return StageResult(NOT_KNOWN, f"{WORDS}: {learned.estimate.reason}", learned)
    retuner.region_models[region] = learned.region_model
    retuner.excitation[region] = Excitation(setpoints=1, clear=1)  # from rest: the loop's own doing
    wanted = tuning_of(retuner.table, region, retuner.region_models, in_force, t_s, settings)
    if not wanted.ready:
        return StageResult(NOT_KNOWN, f"{WORDS}: {learned.region_model.reason}", learned, diagnosis=wanted.diagnosis)
    if not wanted.diagnosis.retune:
        cause = wanted.diagnosis
        return StageResult(str(cause.cause), f"{WORDS}: {cause.reason}", learned, diagnosis=cause)
    tables = (retuner.table, retuner.commissioned)
    request = change_request(wanted.tuning, region, tables, retuner.region_models, learned, t_s, settings)
    verdict = prove(request, settings.guard)
    return StageResult(
        verdict.code,
        f"{WORDS}: {wanted.diagnosis.reason if verdict.accepted else verdict.sentence}",
        learned,
        diagnosis=wanted.diagnosis,
        proposal=wanted.tuning,
        basis=Basis.PRETUNE,
        verdict=verdict,
    )
