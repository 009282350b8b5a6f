"""The check after the fact: what is known with a trial's record says of both sets, whatever was promised.

    least Ms(tried)  >  max(greatest promised, harmless_ms),  and  > Ms(old) on every model      less robust
    least J          >  iae_slack x max(promised J, 1),  Ms(old) <= harmless_ms on every model,
                        and the old set was not seen to swing                                    slower
    greatest Ms(tried)  <=  harmless_ms,  the process is settled                                 robust

over all models that are still allowed (region_model/update.py: the record with what was known before, or by itself
where they contradict each other). J is the mean over a setpoint and a load step of IAE with the tried set over IAE with
the old one (Grimholt & Skogestad 2012). One response cannot tell this: the IAE of a load is 1/ki per unit whatever the
process, so a sluggish set keeps what a wrong model promised of it, and a set of high Ms may take up a load with hardly
a swing. What was seen of the old set counts more than what any model says of it.
"""

import math
from collections.abc import Sequence

from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.loop.margins import sensitivity_peak
from retuner.adaptive.trial.batch_responses import ClosedLoop
from retuner.adaptive.trial.prediction import Prediction
from retuner.adaptive.trial.response_numbers import iaes, mean_ratio, storable
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace


@dataclass(frozen=True, slots=True)
class PosteriorCheck:
    """ms_tried, ms_most : least and greatest Ms of the tried set over the models. ms_old : greatest of the old one;
    infinite where unstable. robuster : the old set has the smaller Ms on every model. slower : least J, see the head of
    this file; 0 where it is not known. settled : settings could follow from what is known; to speak against a set it is
    enough that all allowed models do so. agreed : several records before this response agree with it.
    """

    ms_tried: float
    ms_most: float
    ms_old: float
    robuster: bool
    slower: float
    settled: bool = True
    agreed: bool = False


def check_posterior(
    allowed: Sequence[Plausible],
    old: PidGains,
    tried: PidGains,
    sample_time_s: float,
    b: float = 1.0,
    tau_f_s: float = 0.0,
) -> PosteriorCheck:
    """What the models that are still allowed say of both sets.

    allowed : at least one model. sample_time_s : of the controller.
    b, tau_f_s : setpoint weight of the controller, and its derivative's filter time in seconds.
    """
    sampled = [found.model.seen_by_controller(sample_time_s).linear() for found in allowed]
    ms_tried, ms_old = ([sensitivity_peak(process, gains, tau_f_s) for process in sampled] for gains in (tried, old))
    slower = min(costs(allowed, old, tried, sample_time_s, b, tau_f_s))
    robuster = all(then < now for then, now in zip(ms_old, ms_tried, strict=True))
    return PosteriorCheck(min(ms_tried), max(ms_tried), max(ms_old), robuster, slower)


def costs(
    allowed: Sequence[Plausible], old: PidGains, new: PidGains, sample_time_s: float, b: float, tau_f_s: float
) -> list[float]:
    """J of the new set over the old one on each model, see the head of this file; 0 where it is not known."""
    processes = [found.model.seen_by_controller(sample_time_s).linear() for found in allowed]
    loops = [ClosedLoop(process, gains, b, tau_f_s) for gains in (new, old) for process in processes]
    iae, n = iaes(loops), len(processes)
    return [mean_ratio(now, then) for now, then in zip(iae[:n], iae[n:], strict=True)]


@dataclass(frozen=True, slots=True)
class PosteriorNumbers(Numbers):
    """What the check weighed; -1 where unstable.

    ms : least Ms of the tried set. ms_limit, ms_before : what it was held against. ms_promised : if it was.
    cost : least J, see the head of this file; with its limit, and as it was promised, if it was. None where less robust
    decides before it, or J is not known.
    """

    ms: float
    ms_limit: float
    ms_before: float
    ms_promised: float | None = None
    cost: float | None = None
    cost_limit: float | None = None
    cost_promised: float | None = None


def against(
    found: PosteriorCheck, prediction: Prediction, settings: TrialSettings, robust: bool = False
) -> tuple[str, PosteriorNumbers]:
    """What it says against the tried set in words, empty for nothing, by the two tests at the head of this file; and
    what was weighed.

    robust : the tried set is, by all samples: then the models, which know no load that wanders, say nothing of that.
    """
    ms = prediction.ms
    promised = [one for one in (ms.best, ms.high) if math.isfinite(one)] if ms else []
    most = max([settings.harmless_ms, *promised])
    best = storable(ms.best) if ms else None
    numbers = PosteriorNumbers(storable(found.ms_tried), most, storable(found.ms_old), best)
    if not robust and found.robuster and not found.ms_tried <= most:
        words = "the loop is unstable" if math.isinf(found.ms_tried) else f"Ms is at least {found.ms_tried:.2f}"
        return f"worse than predicted: on every plausible model {words}, limit {most:.2f}", numbers
    # J of the new set over the old one as promised, on the best model; 0 where it is not known
    said = mean_ratio(
        (prediction.setpoint.iae.best, prediction.load_step.iae.best),
        (prediction.setpoint_before.iae.best, prediction.load_before.iae.best),
    )
    limit = settings.iae_slack * max(said, 1.0)
    if found.slower:
        numbers = replace(numbers, cost=found.slower, cost_limit=limit, cost_promised=said or None)
    swung = prediction.decay_seen is not None and prediction.decay_seen > settings.harmless_decay
    told = ""
    if not (swung or found.ms_old > settings.harmless_ms or found.slower <= limit):
        told = (
            f"worse than predicted: IAE at least {found.slower:.2f} times that with the previous gains on every "
            f"plausible model (limit {limit:.2f}); the previous gains have Ms at most {found.ms_old:.2f}"
        )
    return told, numbers


def in_favour(found: PosteriorCheck, settings: TrialSettings) -> str:
    """What it says for the tried set, if anything."""
    if not found.settled or found.ms_most > settings.harmless_ms:
        return ""
    return f"robust according to the models: Ms at most {found.ms_most:.2f} on every plausible one"
