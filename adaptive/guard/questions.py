"""What is asked of every change besides its robustness, each with value, limit and answer."""

import math

from retuner.adaptive.guard.parameters import MORE_WHEN_LARGER, Parameter, logs, step_limit
from retuner.adaptive.guard.request import ChangeRequest
from retuner.adaptive.guard.ruling import Check, Ruling
from retuner.adaptive.guard.settings import GuardSettings
from retuner.schedule.gains import PidGains

ROUNDING = 1e-9
"""A factor that meets its limit may exceed it by rounding."""


def evidence_checks(request: ChangeRequest, settings: GuardSettings) -> list[Check]:
    """Count, age and innovation; nothing for a proposal by the pattern alone, which rests on its response."""
    if not request.models:
        return []
    e, s = request.evidence, settings
    source = "records behind the model" + (" of the neighbouring region" if e.borrowed else "")
    return [
        Check("records", source, float(e.records), float(s.records_min), e.records >= s.records_min),
        Check("age", "age of the last record, s", e.age_s, s.age_max_s, e.age_s <= s.age_max_s),
        Check("innovation", "innovation of the last record", e.innovation, e.gate, e.innovation <= e.gate),
    ]


def evidence_doubt(request: ChangeRequest, settings: GuardSettings) -> tuple[Ruling, dict[str, float]] | None:
    """The first of them that failed, as a ruling."""
    rulings = {"records": (Ruling.TOO_FEW_RECORDS, "records"), "age": (Ruling.TOO_OLD, "age_s"),
               "innovation": (Ruling.CONTRADICTED, "innovation")}  # fmt: skip
    for check in evidence_checks(request, settings):
        if not check.passed:
            ruling, name = rulings[check.name]
            return ruling, {name: check.value, "limit": check.limit}
    return None


def limit_checks(
    request: ChangeRequest, gains: PidGains, settings: GuardSettings, *, over_limit: bool = False,
    urgent: bool = False, factor: float | None = None,
) -> list[Check]:  # fmt: skip
    """Size of the step, ratio to the commissioned set, absolute limits, sampling time.

    over_limit : the loop in force is over its Ms limit: the commissioned set does not hold it up from below.
    urgent : no limit per change towards less action, nor on tau_I. factor : one limit per change for all, in place of
        the settings'.
    """
    return [
        *_steps(request.in_force, gains, settings, urgent, factor),
        *_totals(request.commissioned, gains, settings, over_limit),
        *_absolute(request, gains, settings),
    ]


def _steps(old: PidGains, new: PidGains, s: GuardSettings, urgent: bool, factor: float | None) -> list[Check]:
    """One change."""
    found = []
    before, after = logs(old), logs(new)
    for parameter in Parameter:
        if parameter not in before or parameter not in after:
            continue
        way = after[parameter] - before[parameter]
        more = (way > 0) == MORE_WHEN_LARGER[parameter]
        limit = step_limit(parameter, more=more, settings=s) if factor is None else factor
        limit = math.inf if urgent and (not more or parameter is Parameter.TAU_I) else limit
        value = math.exp(abs(way))
        words = f"factor of {parameter} in one change, towards {'more' if more else 'less'} action"
        found.append(Check(f"step_{parameter.name.lower()}", words, value, limit, value <= limit * (1 + ROUNDING)))
    return found


def _totals(start: PidGains, new: PidGains, s: GuardSettings, over_limit: bool) -> list[Check]:
    """Against the commissioned set."""
    found = []
    before, after = logs(start), logs(new)
    for parameter in (Parameter.KC, Parameter.TAU_I, Parameter.TAU_D):
        if parameter in before and parameter in after:
            way = after[parameter] - before[parameter]
            less = (way > 0) != MORE_WHEN_LARGER[parameter]
            value, limit = math.exp(abs(way)), math.inf if over_limit and less else s.total_ratio_max
            words = f"factor of {parameter} against the commissioned set"
            passed = value <= limit * (1 + ROUNDING)
            found.append(Check(f"total_{parameter.name.lower()}", words, value, limit, passed))
    return found


def _absolute(request: ChangeRequest, new: PidGains, s: GuardSettings) -> list[Check]:
    """Limits that somebody set, and the sampling time."""
    kc, slack = abs(new.kp), 1 + ROUNDING
    found = []
    if s.kc_min > 0:
        found.append(Check("kc_min", "kc, not less than kc_min", kc, s.kc_min, kc * slack >= s.kc_min))
    if s.kc_max < math.inf:
        found.append(Check("kc_max", "kc, not more than kc_max", kc, s.kc_max, kc <= s.kc_max * slack))
    if new.kp and new.ki:
        tau_i, old = new.kp / new.ki, request.in_force
        before = old.kp / old.ki if old.kp and old.ki else math.inf
        least = max(s.tau_i_min_s, min(s.tau_i_samples * request.sample_time_s, before))
        found.append(Check("tau_i_min", "tau_I, s, not shorter than its limit", tau_i, least, tau_i * slack >= least))
        if s.tau_i_max_s < math.inf:
            found.append(Check("tau_i_max", "tau_I, s, not longer than its limit", tau_i, s.tau_i_max_s,
                               tau_i <= s.tau_i_max_s * slack))  # fmt: skip
    if new.kp and new.kd:
        tau_d, least = new.kd / new.kp, s.tau_d_samples * request.sample_time_s
        found.append(Check("tau_d_min", "tau_D, s, not shorter than its limit", tau_d, least, tau_d * slack >= least))
        if s.tau_d_max_s < math.inf:
            found.append(Check("tau_d_max", "tau_D, s, not longer than its limit", tau_d, s.tau_d_max_s,
                               tau_d <= s.tau_d_max_s * slack))  # fmt: skip
    return found
