"""What other settings would have made of a loop's records, under the loads that they hold: error, and work of co.

    saved = 1 - |error| with the settings / |error| on record,      loop/replayed.py

Expected over the processes that the records allow, each with its odds. Where no settings are given they are the best of
each process, the rule's or those in force: no test and no tuning gains more, so where that is little nothing is due.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.choice.choice_settings import ChoiceSettings
from retuner.adaptive.fit.structure import model_at
from retuner.adaptive.identification.estimate import STRUCTURE_STD, ModelEstimate
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc_on
from retuner.adaptive.loop.replayed import even, mean_error, replayed, way
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.signals.sample import Window
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import asdict, dataclass

ASKED, MOST_SAMPLES = 7, 4_000  # Processes that stand for all odds, and newest samples of a record that are replayed
OFF = 2.0  # how far a parameter's logarithm may be off, in standard deviations of what structures leave out
PERCENT = (0.0, 100.0)  # limits of co where a record stays within them and none are known
DOUBLED = -1.0  # an error that more than doubles counts as doubled where it is expected
Weighed = tuple[ProcessModel, float]  # a process with its odds


@dataclass(frozen=True, slots=True)
class Foreseen:
    """Error and work of co as they were, and with other settings.

    span_s : time that they are of. error : integral of |sp - pv|, pv units times s. travel : sum of |changes of co|.
    Each: then, and now on record; then by the likeliest process. saved : share of the error that would go, expected;
    negative where it would grow. least, most : the same by any of the processes. calmer : share of the travel.
    given : whether it is of settings that were asked about, and not of the best for each process.
    """

    span_s: float
    error: tuple[float, float]
    travel: tuple[float, float]
    saved: float
    least: float
    most: float
    calmer: float
    given: bool = True

    @property
    def due(self) -> bool:
        """Whether it is worth a change."""
        return self.saved >= ChoiceSettings().price

    @property
    def left(self) -> tuple[float, float, float]:
        """The share of the error that stays: expected, lowest, highest."""
        return 1.0 - self.saved, 1.0 - self.most, 1.0 - self.least

    def to_dict(self) -> dict[str, object]:
        """Its numbers by name; without those that are not finite."""
        return {name: value for name, value in asdict(self).items() if value != -math.inf}


def weighed_models(estimate: ModelEstimate | None) -> list[Weighed]:
    """The best process, what a structure of few numbers leaves out (slope and dead time first, each off by OFF), and
    some of those that a record allows, with their likelihood.
    """
    if estimate is None:
        return []
    log, some = estimate.log, estimate.plausible[:: max(len(estimate.plausible) // 2, 1)]
    allowed = ((one.model, math.exp(-one.excess / 2.0)) for one in some)
    corners = [way * axis for axis in OFF * STRUCTURE_STD * np.eye(len(log.x)) for way in (1, -1)]
    rounded = ((model_at(log.type, log.x + corner, log.sign), math.exp(-(OFF**2) / 2.0)) for corner in corners)
    return [(log.model(), 1.0), *rounded, *allowed]


Limits = tuple[float | None, float | None]


def likely_limits(known: Limits, low: float, high: float) -> Limits:
    """Limits of co: those that are known; in percent where none is and a record stays within. low, high : of its co."""
    return PERCENT if known == (None, None) and PERCENT[0] <= low <= high <= PERCENT[1] else known


def foreseen(
    records: Sequence[Window],
    processes: Sequence[Weighed],
    gains: PidGains | None,
    active: PidGains | None = None,
    co_limits: Limits = (None, None),
) -> Foreseen | None:
    """What settings would have made of the records.

    records : of one loop in automatic. processes : the likeliest first. gains : None asks for the best of each process.
    active : in force. co_limits : where they are known.

    None where the records have no error, no process is known, or the likeliest is not held by the settings.
    """
    whole = [even(record, MOST_SAMPLES) for record in records]
    spans_s = np.array([len(one.t_s) * one.sample_time_s for one in whole])
    was, went = float(spans_s @ [mean_error(one.sp, one.pv) for one in whole]), sum(way(one.co) for one in whole)
    if not processes or not was > 0.0:
        return None
    low, high = min(float(np.min(one.co)) for one in whole), max(float(np.max(one.co)) for one in whole)
    limits = likely_limits(co_limits, low, high)
    error, travel = [], []
    for model, _ in processes:
        rule = gains or robust_simc_on(model, (), whole[0].sample_time_s, RobustSettings(), active).tuning.gains
        then = [replayed(one, model.linear(), rule, limits, active) for one in whole]
        error.append(float(spans_s @ [one.error for one in then]))
        travel.append(sum(one.travel for one in then))
    if gains is not None and not math.isfinite(error[0]):
        return None
    each = np.maximum(1.0 - np.array(error) / was, -math.inf if gains is not None else 0.0)
    saved = float(np.average(np.maximum(each, DOUBLED), weights=[odds for _, odds in processes]))
    calmer = 1.0 - travel[0] / went if went > 0.0 else 0.0
    ends = float(np.min(each)), float(np.max(each))
    return Foreseen(float(spans_s.sum()), (error[0], was), (travel[0], went), saved, *ends, calmer, gains is not None)
