"""What is asked of every change, each with value, limit and answer.

What exceeds its limit already may stay there or come nearer; the words of such a check say that it passed on these
terms, and what is in force.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.guard.guard_settings import GuardSettings
from retuner.adaptive.guard.request import ChangeRequest
from retuner.adaptive.guard.ruling import BoundaryNumbers, Check, LimitNumbers, NotRobustNumbers, text
from retuner.adaptive.guard.step_size import MORE_WHEN_LARGER, Parameter, logs, step_limit
from retuner.schedule.gains import PidGains

ROUNDING = 1e-9  # A factor that meets its limit may exceed it by rounding


def evidence_checks(request: ChangeRequest, settings: GuardSettings, *, less: bool = False) -> list[Check]:
    """Count, age, innovation, and whether they settle the process; nothing for a proposal by the pattern alone.

    less : the change is less of everything for a loop over its limit, which needs no evidence.
    """
    if not request.models:
        return []
    e, s = request.evidence, settings
    source = "records in the model" + (" of the neighbouring region" if e.borrowed else "")
    found = (
        Check("records", source, float(e.records), float(s.records_min), e.records >= s.records_min),
        Check("age", "age of the last record, s", e.age_s, s.age_max_s, e.age_s <= s.age_max_s),
        Check("innovation", "misfit of the last record to the model", e.innovation, e.gate, e.innovation <= e.gate),
        Check("settled", "model accurate enough for tuning", float(e.settled), 1.0, e.settled),
    )
    return [_on_terms(check, less, "or less gain and integral action only") for check in found]


def _on_terms(check: Check, met: bool, terms: str) -> Check:
    if check.passed or not met:
        return check
    return replace(check, passed=True, words=f"{check.words} ({terms})")


def no_worse(check: Check, in_force: float, terms: str = "no further than") -> Check:
    """The check of a largest value, which passes where the value in force is as large."""
    met = check.value <= in_force * (1 + ROUNDING)
    return _on_terms(check, met, f"{terms} the active value, {text(check.name, in_force)}")


def limit_checks(
    request: ChangeRequest,
    gains: PidGains,
    settings: GuardSettings,
    *,
    over_limit: bool = False,
    urgent: bool = False,
    factor: float | None = None,
) -> list[Check]:
    """Size of the step, ratio to the commissioned set, absolute limits, sampling time.

    over_limit : the loop in force is over its Ms limit: the commissioned set does not hold it up from below.
    urgent : no limit per change towards less action, nor on tau_I. factor : one limit per change for all, in place of
        the settings'.
    """
    found = []
    before, now, after = logs(request.commissioned), logs(request.in_force), logs(gains)
    alone = urgent or not (request.in_force.kp and gains.kp)
    for parameter in (one for one in Parameter if one in now and one in after):
        way = after[parameter] - now[parameter]
        more = (way > 0) == MORE_WHEN_LARGER[parameter]
        limit = step_limit(parameter, more=more, settings=settings, alone=alone) if factor is None else factor
        limit = math.inf if urgent and (not more or parameter is Parameter.TAU_I) else limit
        words = f"factor of {parameter} in one change, towards {'more' if more else 'less'} control action"
        found.append(_at_most(f"step_{parameter.name.lower()}", words, math.exp(abs(way)), limit))
    floor = min(settings.tau_i_samples * request.sample_time_s, math.exp(now.get(Parameter.TAU_I, math.inf)))
    absolute = {
        Parameter.KC: (settings.kc_min, settings.kc_max),
        Parameter.TAU_I: (max(settings.tau_i_min_s, floor), settings.tau_i_max_s),
        Parameter.TAU_D: (0.0, settings.tau_d_max_s),
    }
    for parameter, (least, most) in absolute.items():
        if parameter in before and parameter in after:
            way, start = after[parameter] - before[parameter], math.exp(before[parameter])
            less = (way > 0) != MORE_WHEN_LARGER[parameter]
            value, limit = math.exp(abs(way)), math.inf if over_limit and less else settings.total_ratio_max
            forced = least / start if way > 0 else start / most
            gone = now.get(parameter, before[parameter]) - before[parameter]
            words = f"{parameter} as a factor of its baseline"
            check = _at_most(f"total_{parameter.name.lower()}", words, value, max(limit, forced))
            found.append(no_worse(check, math.exp(math.copysign(1.0, way) * gone)))
    return [*found, *_absolute(request, gains, settings)]


def _at_most(name: str, words: str, value: float, limit: float) -> Check:
    return Check(name, words, value, limit, value <= limit * (1 + ROUNDING))


def _absolute(request: ChangeRequest, new: PidGains, s: GuardSettings) -> Iterator[Check]:
    """Limits that somebody set, and the sampling time."""
    old, dt_s = request.in_force, request.sample_time_s
    kc, tau_i = (abs(new.kp), abs(old.kp)), (_ratio(new.kp, new.ki), _ratio(old.kp, old.ki))
    tau_d, shortest = (_ratio(new.kd, new.kp), _ratio(old.kd, old.kp)), max(s.tau_i_min_s, s.tau_i_samples * dt_s)
    asked = (
        ("kc", "kc, at least kc_min", "kc, at most kc_max", kc, s.kc_min or None, s.kc_max),
        ("tau_i", "tau_I, s, lower limit", "tau_I, s, upper limit", tau_i, shortest, s.tau_i_max_s),
        ("tau_d", "tau_D, s, lower limit", "tau_D, s, upper limit", tau_d, s.tau_d_samples * dt_s, s.tau_d_max_s),
    )
    for name, lower, upper, (value, in_force), least, most in asked:
        if math.isnan(value):
            continue
        if least is not None:
            check = Check(f"{name}_min", lower, value, least, value * (1 + ROUNDING) >= least)
            met = value * (1 + ROUNDING) >= in_force
            yield _on_terms(check, met, f"no further than the active value, {text(check.name, in_force)}")
        if most < math.inf:
            yield no_worse(_at_most(f"{name}_max", upper, value, most), in_force)


def _ratio(a: float, b: float) -> float:
    """a / b; NaN where the controller lacks one of the two."""
    return a / b if a and b else math.nan


def robustness_checks(ms: tuple[float, float], in_force: tuple[float, float], settings: GuardSettings) -> list[Check]:
    """Ms on the process and on the worst model, each of the new gains and of those in force."""
    asked = (
        ("ms_nominal", "nominal Ms", settings.ms_nominal),
        ("ms_worst", "worst-case Ms over the plausible models", settings.ms_worst),
    )
    return [
        no_worse(Check(name, words, now, limit, now <= limit), before, "no worse than")
        for (name, words, limit), now, before in zip(asked, ms, in_force, strict=True)
    ]


def failed_checks(numbers: Numbers) -> Iterator[Check]:
    """What was asked of the gentlest candidate and failed."""
    match numbers:
        case NotRobustNumbers(nominal, worst, limit, worst_limit):
            asked = "ms_nominal", "nominal Ms, at the smallest step"
            yield Check(*asked, nominal, limit, nominal <= limit)
            asked = "ms_worst", "worst-case Ms, at the smallest step"
            yield Check(*asked, worst, worst_limit, worst <= worst_limit)
        case BoundaryNumbers(ms, limit):
            yield Check("ms_border", "Ms at the boundary to a neighbouring region", ms, limit, False)
        case LimitNumbers(wanted, limit):
            yield Check("limit", "requested value and its limit", wanted, limit, False)
