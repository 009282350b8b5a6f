"""Which structure of a PID law made a record: lag, equation, derivative and filters, and whether P and I are there.

Structures are compared by n ln(rms^2) + unknowns ln(n) (Schwarz 1978), n the number of independent samples in what the
plain PI law leaves, and never below the rounding of co. A filter time is the one unknown in which the law is not
linear: a coarse grid, then Gauss-Newton steps from its best (law_regression.columns with `at`).
"""

import math
from dataclasses import replace

import numpy as np

from retuner.adaptive.controller_settings.regression import BoolArray, Regression, Structure, by_increments, by_levels
from retuner.adaptive.indexes.condition import still_stretches
from retuner.adaptive.indexes.limits import TOLERANCE, at_limits
from retuner.adaptive.indexes.recording_quality import quantum
from retuner.adaptive.signals.sample import Window

SIGNIFICANT = 3.0
"""Standard deviations from which a gain is there."""
WORTH = 10.0
"""Gain in the criterion that a richer structure must bring."""
FILTERS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Filter times that are tried, in samples."""
GAUSS_NEWTON = 8
"""Gauss-Newton steps of the filter time from the best of these."""
NEAR_LIMIT = 0.9
"""Quantile of |increment of co| within which of a limit, once hit, co is not believed to be the law's."""
DIFFERENCED = -0.25
"""Correlation of what increments leave from which it is rounding, half way to the -1/2 of nothing but rounding."""
LEVELS_BETTER = 0.8
"""Ratio of the standard deviations of kp from which levels are taken instead of increments."""
NO_INTEGRAL = 1.0
"""An integral time surely longer than this many record lengths is none."""
NO_PROPORTIONAL = 0.5
"""A kp surely smaller than what the integral does in this share of a sample is none."""
NOTHING = 1e-6
"""Share of the other term below which P or I is a rounding of doubles."""
REMAINDER = 0.8
"""Share of the remainder that may be left by a derivative or filter that is told: the smallest are shifts in time."""
LEAST_DERIVATIVE = 0.5
"""Derivative times under this share of a sample are none: pv and co are not read at quite the same instant."""
COMPARED = 0.9
"""Share of samples that two structures must have in common to be compared."""
LEAST_SHARE = 1e-9
"""Rms of the remainder as a share of co's movement below which a fit is exact."""


def usable_increments(window: Window, co_min: float | None, co_max: float | None) -> BoolArray:
    """Increments that the law made: both samples inside the limits, not in a long stretch of constant co."""
    co = window.co
    limits = at_limits(co, co_min, co_max)
    reach = TOLERANCE * float(np.ptp(co))
    low = co_min if co_min is not None else float(np.min(co)) if limits.low else -math.inf
    high = co_max if co_max is not None else float(np.max(co)) if limits.high else math.inf
    reach = max(reach, float(np.quantile(np.abs(np.diff(co)), NEAR_LIMIT))) if limits.hit else reach
    inside = (co > low + reach) & (co < high - reach)  # nearer to a limit, anti-windup has its hand in it
    for start, end in still_stretches(co):
        inside[start:end] = False
    before = np.concatenate([[True], inside[:-2]])  # what anti-windup did shows one sample later
    return np.asarray(inside[1:] & inside[:-1] & before, dtype=np.bool_)


def best_structure(window: Window, usable: BoolArray, largest_lag: int) -> Regression:
    """The best structure: lag and equation first, then filter and derivative, then what of P and I is needed."""
    lags = [by_increments(window, Structure(lag=lag), usable, sure=False) for lag in range(largest_lag + 1)]
    chosen = by_increments(window, min(lags, key=lambda f: _size(f, usable)).structure, usable)
    levels = by_levels(window, chosen.structure, usable)
    if chosen.rho < DIFFERENCED or _doubt(levels) < LEVELS_BETTER * _doubt(chosen):
        chosen = levels
    plain = chosen.structure
    for start in (replace(plain, derivative="pv"), replace(plain, derivative="error"), replace(plain, pv_filter_s=1.0)):
        if start.derivative != "error" or np.ptp(window.sp) > 0:
            rich = _filter_found(window, usable, start, levels=chosen.levels)
            # Whether all gains act one way, and a derivative is more than a shift in time between pv and co.
            # Behind a filter that is slower than itself it is none: a slow one makes a proportional term of it.
            slowest = max(LEAST_DERIVATIVE * window.sample_time_s, rich.structure.tau_f_s)
            least = slowest * abs(rich.values.get("kp", 0.0))
            if (signs_agree(rich.values) and abs(rich.values.get("kd", math.inf)) > least) and _better(
                rich, chosen, window
            ):
                chosen = rich
    # Without P or I where the record shows that there is none: not significant, and small even at three sigma
    kp, ki = (abs(chosen.values[name]) for name in ("kp", "ki"))
    kp_most, ki_most = kp + SIGNIFICANT * chosen.std["kp"], ki + SIGNIFICANT * chosen.std["ki"]
    dt, span = window.sample_time_s, float(window.t_s[-1] - window.t_s[0])
    simple = chosen.structure
    if kp > NO_INTEGRAL * span * ki_most and (ki_most > 2 * ki or ki * span < NOTHING * kp):
        simple = replace(simple, integral=False)
    elif NO_PROPORTIONAL * ki * dt > kp_most and (kp_most > 2 * kp or kp < NOTHING * ki * dt):
        simple = replace(simple, proportional=False)
    return chosen if simple is chosen.structure else fit_on(window, simple, chosen.kept, levels=chosen.levels)


def fit_on(
    window: Window,
    structure: Structure,
    kept: BoolArray,
    at: dict[str, float] | None = None,
    *,
    levels: bool,
    sure: bool = True,
) -> Regression:
    """One fit on given samples; sure : with standard deviations."""
    if levels:
        return by_levels(window, structure, kept, at, sure=sure)
    return by_increments(window, structure, kept, at, trim=False, sure=sure)


def _criterion(found: Regression, plain: Regression, window: Window) -> float:
    """Information criterion, smaller is better, in independent samples of what the plain structure leaves.

    Below what co's rounding leaves, or nothing at all, no fit is better than another.
    """
    floor = _floor(window, levels=found.levels)
    independent = int(np.sum(found.kept)) * (1 - plain.rho) / (1 + plain.rho) if plain.rho > 0 else np.sum(found.kept)
    return float(independent) * math.log(found.rms**2 + floor**2) + found.structure.unknowns * math.log(independent)


def _floor(window: Window, *, levels: bool) -> float:
    """Rms that the rounding of co leaves of any law, co units."""
    rounding = quantum(window.co) / math.sqrt(12.0 if levels else 6.0)
    return max(rounding, LEAST_SHARE * float(np.std(np.diff(window.co))))


def _better(rich: Regression, simple: Regression, window: Window) -> bool:
    """Whether a richer structure explains the same samples so much better."""
    both = rich.kept & simple.kept
    if int(np.sum(both)) < COMPARED * int(np.sum(simple.kept)):
        return False
    a, b = (fit_on(window, f.structure, both, levels=simple.levels, sure=False) for f in (rich, simple))
    floor = _floor(window, levels=simple.levels)
    less = a.rms**2 - floor**2 < REMAINDER**2 * (b.rms**2 - floor**2)
    return less and _criterion(a, b, window) < _criterion(b, b, window) - WORTH


def _size(found: Regression, usable: BoolArray) -> float:
    """Size of what is left: of increments without their largest twentieth, so that other samples kept do not matter."""
    return found.rms if found.levels else float(np.quantile(np.abs(found.remainder[usable]), 0.95))


def _filter_found(window: Window, usable: BoolArray, start: Structure, *, levels: bool) -> Regression:
    """The best filter time of a structure: a coarse grid, then Gauss-Newton from its best.

    The standard deviations are those with the filter time unknown as well.
    """
    dt = window.sample_time_s

    def fit(tau_s: float) -> Regression:
        structure = start.filtering(tau_s)
        return (by_levels if levels else by_increments)(window, structure, usable, sure=False)

    grid = FILTERS if start.derivative else FILTERS[1:]
    best = min((fit(tau * dt) for tau in grid), key=lambda f: _size(f, usable))
    for _ in range(GAUSS_NEWTON):
        wide = fit_on(window, best.structure, best.kept, best.values, levels=levels)
        tau_s, step_s = best.structure.filter_s, wide.values["tau"]
        fresh = fit(min(max(tau_s + step_s, tau_s / 2), 2 * tau_s + dt))
        if not _size(fresh, usable) < _size(best, usable):
            break
        best = fresh
    return replace(best, std={name: wide.std[name] for name in best.std})


def _doubt(found: Regression) -> float:
    """Standard deviation of kp as a share of it, what is not explained included."""
    return math.hypot(found.spread("kp"), found.unexplained)


def signs_agree(values: dict[str, float]) -> bool:
    """Whether all gains act one way."""
    gains = [values[name] for name in ("kp", "ki", "kd") if values.get(name)]
    return bool(gains) and (min(gains) > 0 or max(gains) < 0)
