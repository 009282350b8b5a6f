"""What averaged setpoint steps to and fro say of a region: all sequences that were made, fitted as one each time.

Each sequence leaves its mean and its scatter (signals/to_and_fro.py), and nothing of its load. So what is known is
fitted anew from all that are kept (identification/averaged.py), and no record counts twice. Where all of them together
leave much more than their scatter says, the process has changed: then the newest stands alone.
"""

from retuner.adaptive.identification.averaged import process_behind
from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.identification.identify import FitSettings
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel, StructureModel, remembered
from retuner.adaptive.region_model.update import Agreement, Learned, TrackerSettings, scattered
from retuner.adaptive.signals.to_and_fro import Averaged

MOST_SEQUENCES = 24
"""So many are kept: a process is hardly the same for longer."""
ONE_PROCESS = 1.5
"""What all sequences together may leave, in standard deviations of what their scatter foretells."""


def update_by_averages(
    region_model: RegionModel | None,
    averages: tuple[Averaged, ...],
    sign: int,
    settings: TrackerSettings,
    fit: FitSettings,
    law: tuple[float, float],
    at: tuple[float, float] = (0.0, 0.0),
) -> Learned | None:
    """What is known with one more sequence; None where no loop explains it.

    Parameters
    ----------
    region_model : what was known. averages : of all sequences, the newest last. sign : of the process gain.
    law : setpoint weight, and filter time of the derivative in seconds. at : the scheduling values.
    """
    kept = averages[-MOST_SEQUENCES:]
    estimate = process_behind(kept, sign, fit, *law)
    if len(kept) > 1 and (estimate is None or estimate.residual_std > ONE_PROCESS * estimate.noise_std):
        kept = kept[-1:]
        estimate = process_behind(kept, sign, fit, *law)
    if estimate is None:
        return None
    agreement = Agreement.AGREES if len(kept) > 1 else Agreement.FIRST
    return Learned(_known(region_model, kept, estimate, settings, at), estimate, agreement, 0.0)


def _known(
    before: RegionModel | None,
    kept: tuple[Averaged, ...],
    estimate: ModelEstimate,
    settings: TrackerSettings,
    at: tuple[float, float],
) -> RegionModel:
    """All that is known now."""
    t_s = kept[-1].t_s
    point = RecordPoint(t_s, *at, estimate.log, 0.0)
    points = remembered(before.points if before is not None and len(kept) > 1 else (), point)
    known = tuple(StructureModel(scattered(a.log, settings), a.evidence) for a in estimate.alternatives)
    told = (estimate.plausible, estimate.identifiable, estimate.reason)
    return RegionModel(known, len(kept), t_s, None, points, *told, averages=kept)
