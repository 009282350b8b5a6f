"""The judge: one response against the promise of the gains that it ran under.

A response is WORSE when one of two numbers lies beyond all that was promised, by more than noise and the models'
inexactness can do, and is no improvement on the gains before either:

    decay - level s(decay)  >  max(greatest promised + decay_slack, harmless_decay)   and  > before
    (IAE - its noise)/unit  >  greatest promised x iae_slack                          and  > before

"before" is what the old gains did in the response that led to the change, or on the best model; s comes from the noise
of the peaks (response_numbers.py). If the old response to a load swung more than any model allows, loads made it swing,
and the new one must grow to be worse. A model that calls the old gains unstable says nothing of their IAE, unless
they were seen to be.

Whatever the upset was, a response is WORSE as well if the old gains were surely better on the models that are still
allowed (posterior_check.py). It is not WORSE by its two numbers if a process that explains this and several earlier
records makes the new gains robust: more than one upset made the peaks. It is never WORSE if they are robust by all
samples and have no less integral action than the old ones.

A response is INCONCLUSIVE, which rolls back nothing, in these cases, unless the tried set is known to be robust:

    all peaks within seen_bands of noise, or within seen_wanders of what the error did while nothing happened;
    begun under other gains; no rest before the setpoint's step; cut short by the next one (but what is worse by then
    will not get better: IAE only grows)
    a setpoint that went on moving; another cause than the tuning was found behind it (oscillation from outside, valve)
    IAE only: a load that came and went (its integral is small against its IAE); output at a limit for a while

The travel of the output is told, and not judged: in a recorded output it is mostly noise times kp.
"""

import math
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.signals.response import Ending, Response
from retuner.adaptive.signals.sample import FloatArray, Window, median, trapezoid
from retuner.adaptive.trial.posterior_check import PosteriorCheck, PosteriorNumbers, against, in_favour
from retuner.adaptive.trial.prediction import Expected, Prediction
from retuner.adaptive.trial.response_numbers import storable, swing, three
from retuner.adaptive.trial.trial_settings import TrialSettings
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values

NOT_ITSELF = "the response itself is not judged"
MEAN_OF_NOISE = 0.8  # Mean of |n| over the standard deviation of normal noise n
NOISE_RISES = 4.0  # standard deviations in a noise band by default: a band that the user set counts as so many as well
WORSE_WORDS = "worse than predicted: "
STAYS = 1.0  # decay up to which a second load makes a second peak
LIMITED = 0.05  # Share of limited samples from which the IAE is not the tuning's alone


class TrialFinding(StrEnum):
    """Outcome of a judgement."""

    BETTER = "better than predicted"
    AS_PROMISED = "as predicted"
    WORSE = "worse than predicted"
    INCONCLUSIVE = "inconclusive"


@dataclass(frozen=True, slots=True)
class SwingNumbers(Numbers):
    """How the response swings (response_numbers.py), and what its decay is held against.

    decay_promised, decay_before : as promised, and with the gains before. decay_sure : None with less than two peaks.
    """

    overshoot: float
    damping: float
    decay: float
    decay_limit: float
    decay_promised: float
    decay_before: float
    decay_sure: float | None = None


@dataclass(frozen=True, slots=True)
class UpsetNumbers(Numbers):
    """IAE and travel of the output per unit of the upset, and what they are held against; -1 for infinite."""

    iae: float
    iae_promised: float
    iae_before: float
    iae_limit: float
    travel: float
    travel_promised: float


@dataclass(frozen=True, slots=True)
class TrialNumbers(Numbers):
    """What was weighed. peaks : how many were seen. The others are None where the judge did not come to them."""

    peaks: float
    posterior: PosteriorNumbers | None = None
    swing: SwingNumbers | None = None
    upset: UpsetNumbers | None = None


@dataclass(frozen=True, slots=True)
class Judgement:
    """finding : outcome. reason : the sentence.

    numbers : what was weighed: TrialNumbers, or what the response was refused by before the judge saw it.
    """

    finding: TrialFinding
    reason: str
    numbers: Numbers

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        return {"finding": self.finding.name.lower(), **plain_values(self, "reason numbers")}


@dataclass(frozen=True, slots=True)
class JudgedResponse:
    """What the judge looks at.

    response, window : the response and its samples, with some of the time before it.
    limited_share : share of the samples with the output at a limit. outside : the sentence of another cause than the
    tuning that was found behind the response, empty when none was. crossed : part of it ran in another region, under
    other gains, so that its own numbers speak for neither. posterior : what the models that are still allowed
    say of both sets, None where there are none. next_due : a change is proved that must not wait: by this response the
    tried set swings, and this one is safer; or it follows from all samples, those of the trial among them. robust :
    the tried set is, by all samples, those of its trial among them: then a load that wanders explains what swings.
    """

    response: Response
    window: Window
    limited_share: float = 0.0
    outside: str = ""
    posterior: PosteriorCheck | None = None
    crossed: bool = False
    next_due: bool = False
    robust: bool = False


def judge(
    seen: JudgedResponse, prediction: Prediction, gains: PidGains, settings: TrialSettings, *, more: bool = False
) -> Judgement:
    """Judge a response that ran under `gains`. more : these have no less integral action than those before."""
    peaks = float(len(seen.response.peaks))
    nothing = _says_nothing(seen, prediction, settings)
    if nothing:
        return Judgement(TrialFinding.INCONCLUSIVE, nothing, TrialNumbers(peaks))
    excused = seen.robust and more  # 1/ki is the integrated error of a load: it is no slower
    objection = against(seen.posterior, prediction, settings, seen.robust) if seen.posterior and not excused else None
    worse, posterior = objection or ("", None)
    setpoint = seen.response.sp_changed
    unlike = _unlike_a_step(seen, settings) if setpoint else ""
    unlike = f"{NOT_ITSELF}: it began under other gains" if seen.response.taken_over else unlike
    unlike = f"{NOT_ITSELF}: it crossed a boundary" if seen.crossed else unlike
    if unlike and worse:
        return Judgement(TrialFinding.WORSE, worse, TrialNumbers(peaks, posterior))
    if unlike:
        return _by_posterior(unlike, seen.posterior, settings, TrialNumbers(peaks, posterior))
    said, sigma = prediction, sigma_of(seen.response.band, prediction)
    now, then = (said.setpoint, said.setpoint_before) if setpoint else (said.load_step, said.load_before)
    was = said.decay_before(setpoint)
    if not setpoint and was > max(then.decay.high + settings.decay_slack, settings.harmless_decay):
        was = max(was, STAYS)  # no model makes it so large: loads did, and may again
    swings, decay = _swings(seen.response, now, was, sigma, settings)
    ran_away = said.decay_seen is not None and said.decay_seen > max(now.decay.high, settings.harmless_decay)
    before = then.iae.best if math.isfinite(then.iae.best) or ran_away else 0.0
    costs, upset = _costs(seen, gains, now, before, sigma, settings)
    numbers = TrialNumbers(peaks, posterior, decay, upset)
    told = "; ".join(filter(None, (swings, costs)))
    if told and not worse:
        # Loads may explain what the response by itself says against the set: all samples hold against that, or records
        words = told.replace(WORSE_WORDS, "")
        if excused or (seen.robust and not costs):
            words = f"a wandering load explains this response equally well: {words}"
            return _by_posterior(words, seen.posterior, settings, numbers)
        if seen.posterior and seen.posterior.agreed and in_favour(seen.posterior, settings):
            return _by_posterior(f"loads explain this response: {words}", seen.posterior, settings, numbers)
    if told or worse:
        return Judgement(TrialFinding.WORSE, "; ".join(filter(None, (told, worse))), numbers)
    # Better, as promised, or cut short before that can be said
    told = f"half-cycle decay ratio {decay.decay:.2f} (limit {decay.decay_limit:.2f}{_beyond(decay)})"
    if upset is not None and upset.iae_limit >= 0:
        told += f", IAE {upset.iae:.3g} {_PER[seen.response.sp_changed]} (predicted {upset.iae_promised:.3g})"
    if seen.response.ending == Ending.SETPOINT:
        return _by_posterior(f"{seen.response.ending}; until then {told}", seen.posterior, settings, numbers)
    cheaper = upset is not None and upset.iae < now.iae.low
    if cheaper and decay.decay <= max(now.decay.best, now.decay.low):
        return Judgement(TrialFinding.BETTER, f"better than predicted: {told}", numbers)
    wide = decay.decay_sure is not None and decay.decay_sure > decay.decay_limit
    beyond = wide or (upset is not None and 0.0 <= upset.iae_limit < upset.iae)
    head = "not as predicted, but no worse than with the previous gains" if beyond else "as predicted"
    return Judgement(TrialFinding.AS_PROMISED, f"{head}: {told}", numbers)


def _by_posterior(why: str, seen: PosteriorCheck | None, settings: TrialSettings, numbers: TrialNumbers) -> Judgement:
    """The judgement of a response that cannot speak for the promise: what is known of the tried set may be enough."""
    good = in_favour(seen, settings) if seen else ""
    if not good:
        return Judgement(TrialFinding.INCONCLUSIVE, why, numbers)
    return Judgement(TrialFinding.AS_PROMISED, f"{good}; {why}", numbers)


def sigma_of(band: float, prediction: Prediction) -> float:
    """Standard deviation of what moves pv beside the upset: noise, or a load that never rests. band : noise band."""
    return max(band / NOISE_RISES, prediction.wander)


def _says_nothing(seen: JudgedResponse, prediction: Prediction, settings: TrialSettings) -> str:
    response = seen.response
    if seen.outside:
        return f"not judged: {seen.outside}"
    if response.taken_over:  # as small as it has become, the models judge it
        return ""
    least, largest = settings.seen_bands * response.band, max((abs(peak.e) for peak in response.peaks), default=0.0)
    if largest < least:
        return f"not judged: the peaks are below {settings.seen_bands:g} noise bands ({least:.3g} in units of pv)"
    wanders, least = settings.seen_wanders, settings.seen_wanders * prediction.wander
    what = f"{wanders:g} standard deviations of the error before the change ({least:.3g} in units of pv)"
    return f"not judged: the peaks are below {what}" if largest < least else ""


def _unlike_a_step(seen: JudgedResponse, settings: TrialSettings) -> str:
    """Why a setpoint's response is not one of a step from rest, if so.

    What is left of an older upset shifts the peaks and the IAE by its share of the step, so that share counts as well
    as the noise: without it no loop with little noise and slow integral action is ever at rest.
    """
    window, response = seen.window, seen.response
    before = window.t_s < response.t_start_s
    later = window.sp[_during(seen)]
    if later.size and float(np.ptp(later)) > response.band:
        return "not judged: the setpoint kept moving during the response"
    error = (window.sp - window.pv)[before]
    if not error.size:
        return ""
    step = abs(median(later) - float(window.sp[before][-1])) if later.size else 0.0
    if abs(float(np.mean(error[-max(len(error) // 4, 1) :]))) > max(response.band, settings.rest_share * step):
        return "not judged: the loop was not at rest when the setpoint changed"
    return ""


def _swings(
    response: Response, now: Expected, before: float, sigma: float, settings: TrialSettings
) -> tuple[str, SwingNumbers]:
    """What the decay says against the set, empty for nothing."""
    peaks = [peak.e for peak in response.peaks]
    limit = max(now.decay.high + settings.decay_slack, settings.harmless_decay)
    sure = None
    if len(peaks) > 1:  # the decay less what noise on the peaks gives it
        first, second, third = three(peaks, response.band)
        damping, last = (third - second) / (first - second), abs(third / second)
        sure = min(
            damping - settings.level * sigma * math.hypot(1.0, 1.0, damping) / abs(first - second),
            last - settings.level * sigma * math.hypot(1.0, last) / abs(second),
        )
    numbers = SwingNumbers(*swing(peaks, response.band), limit, now.decay.best, before, sure)
    if sure is None or sure <= limit or sure <= before:
        return "", numbers
    return (
        f"{WORSE_WORDS}half-cycle decay ratio {numbers.decay:.2f} (at least {sure:.2f} allowing for noise; limit "
        f"{limit:.2f}), predicted at most {now.decay.high:.2f}; previous gains {before:.2f}"
    ), numbers


def _costs(
    seen: JudgedResponse, gains: PidGains, now: Expected, before: float, sigma: float, settings: TrialSettings
) -> tuple[str, UpsetNumbers | None]:
    """What the IAE says against the set, empty for nothing; no numbers where it cannot be measured."""
    response, window = seen.response, seen.window
    during = _during(seen)
    e, t = (window.sp - window.pv)[during], window.t_s[during]
    if len(t) < 3 or seen.limited_share > LIMITED:
        return "", None
    noise = MEAN_OF_NOISE * sigma * float(t[-1] - t[0])
    iae = max(float(trapezoid(np.abs(e), t)) - noise, 0.0)
    unit = _unit(seen, gains, e, t, iae / settings.iae_slack)
    if unit <= 0:
        return "", None
    measured, limit = iae / unit, now.iae.high * settings.iae_slack
    travel = float(np.sum(np.abs(np.diff(window.co[during])))) / unit
    held_against = (storable(now.iae.best), storable(before), storable(limit))
    numbers = UpsetNumbers(measured, *held_against, travel, storable(now.travel.best))
    if measured <= limit or measured <= before:
        return "", numbers
    return (
        f"{WORSE_WORDS}IAE {measured:.3g} {_PER[response.sp_changed]} (limit {limit:.3g}), predicted at most "
        f"{now.iae.high:.3g}; previous gains {before:.3g}"
    ), numbers


def _during(seen: JudgedResponse) -> NDArray[np.bool_]:
    """The samples of the response; the one with the setpoint change that cut it short belongs to the next."""
    t_s, response = seen.window.t_s, seen.response
    cut = response.ending == Ending.SETPOINT
    return (t_s >= response.t_start_s) & (t_s < response.t_end_s if cut else t_s <= response.t_end_s)


def _unit(seen: JudgedResponse, gains: PidGains, e: FloatArray, t: FloatArray, least: float) -> float:
    """Size of the upset: of the setpoint's step, or of the load that the integral took over; 0 when it is not known.

    least : integrated error of a load that stayed. A load that went again leaves an IAE that is large against it; below
    1/iae_slack of the IAE, that alone could pass for worse than promised.
    """
    if seen.response.sp_changed:
        before = seen.window.sp[seen.window.t_s < seen.response.t_start_s]
        after = median(seen.window.sp[_during(seen)])
        return abs(after - float(before[-1])) if before.size else 0.0
    taken_over = abs(float(trapezoid(e, t)))
    return abs(gains.ki) * taken_over if taken_over >= least else 0.0


def _beyond(swing: SwingNumbers) -> str:
    """Why a decay beyond its limit does not count against the set; empty where it is not."""
    if swing.decay_sure is None or swing.decay <= swing.decay_limit:
        return ""
    if swing.decay_sure <= swing.decay_limit:
        return f"; at least {max(swing.decay_sure, 0.0):.2f} allowing for noise"
    return f"; previous gains {swing.decay_before:.2f}"


_PER = {True: "s per unit setpoint step", False: "pv s per unit load step"}
"""What an IAE is measured in, by whether the setpoint was stepped."""
