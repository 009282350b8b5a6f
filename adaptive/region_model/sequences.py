"""What setpoint steps to and fro say of a region: all sequences that were made, fitted as one each time.

What is known is fitted anew from all that are kept (identification/by_setpoint.py), and no record counts twice. Where
the newest leaves much more with all of them than by itself, something else was behind it, or the process has changed:
what was known stays. When the next one says so as well, those two are all that is known.
"""

from dataclasses import replace

from retuner.adaptive.identification.by_setpoint import integral_spread, of_the_newest, process_behind
from retuner.adaptive.identification.estimate import ModelEstimate, factors_text, gain_spread
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel, StructureModel, remembered
from retuner.adaptive.region_model.update import Agreement, Learned, TrackerSettings, scattered
from retuner.adaptive.signals.setpoint_steps import SetpointSteps

WELL_KNOWN = 0.15
"""Standard deviation of ln |C| and of ln ki from which nothing more is asked: settings of that size off are in spec."""
MOST_SEQUENCES = 6  # sequences that are kept: a process is hardly the same for longer
ANOTHER_PROCESS = 16.0
"""What all may leave of the newest beyond what it leaves by itself, sum of squares in standard deviations:
four parameters at four of them."""
ODD_ONES = 2  # sequences one after the other with which what was known does not agree: then they are what is known


def update_by_sequences(
    region_model: RegionModel | None,
    sequences: tuple[SetpointSteps, ...],
    sign: int,
    settings: TrackerSettings,
    fit: FitSettings,
    law: tuple[float, float],
    at: tuple[float, float] = (0.0, 0.0),
) -> Learned | None:
    """What is known with one more sequence; None where no loop explains it.

    region_model : what was known. sequences : all of them, the newest last. sign : of the process gain.
    law : setpoint weight, and filter time of the derivative in seconds. at : the scheduling values.
    """
    kept = sequences[-MOST_SEQUENCES:]
    estimate = process_behind(kept, sign, fit, *law)
    settled = region_model is not None and region_model.identifiable and len(kept) > 1
    alone = process_behind(kept[-1:], sign, fit, *law) if settled else None
    if alone is not None and (
        estimate is None or (of_the_newest(kept, estimate, *law) - of_the_newest(kept, alone, *law)) > ANOTHER_PROCESS
    ):
        assert region_model is not None
        if region_model.alternative is None:
            odd = _known(None, kept[-1:], alone, settings, at).known
            return Learned(replace(region_model, sequences=kept, alternative=odd), alone, Agreement.CONTRADICTS, 0.0)
        kept = kept[-ODD_ONES:]
        estimate = process_behind(kept, sign, fit, *law)
    if estimate is None:
        return None
    if region_model is not None and region_model.identifiable and not (region_model.sequences or estimate.identifiable):
        return Learned(replace(region_model, sequences=kept), estimate, Agreement.SILENT, 0.0)
    agreement = Agreement.AGREES if len(kept) > 1 else Agreement.FIRST
    return Learned(_known(region_model, kept, estimate, settings, at), estimate, agreement, 0.0)


def unsure(model: RegionModel, sample_time_s: float) -> str:
    """How far settings by steps to and fro are still open, in words; empty where one more would tell little."""
    spread = max(gain_spread(model.plausible, sample_time_s), integral_spread(model.plausible, sample_time_s))
    if spread <= WELL_KNOWN:
        return ""
    known, enough = factors_text(spread, WELL_KNOWN)
    return f"known within a factor of {known} by setpoint steps to and fro, more of them would reach {enough}"


def _known(
    before: RegionModel | None,
    kept: tuple[SetpointSteps, ...],
    estimate: ModelEstimate,
    settings: TrackerSettings,
    at: tuple[float, float],
) -> RegionModel:
    t_s = kept[-1].t_s
    point = RecordPoint(t_s, *at, estimate.log, 0.0)
    points = remembered(before.points if before is not None and len(kept) > 1 else (), point)
    known = tuple(StructureModel(scattered(a.log, settings), a.evidence) for a in estimate.alternatives)
    told = (estimate.plausible, estimate.identifiable, estimate.reason)
    return RegionModel(known, len(kept), t_s, None, points, *told, sequences=kept)
