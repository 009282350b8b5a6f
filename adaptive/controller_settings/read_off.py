"""The PI or PID settings in force, recovered from a closed-loop record that does not come with them.

The law is linear in its gains, so each structure (regression.py) is a least-squares fit of the movements of co:
with and without integral and derivative, derivative on pv or on the error, its filter, a filter on pv, computed from
this or the last sample; the search here chooses. Left out are samples with co at a limit, long stretches of constant co
(manual) and moves that no law made (bumpless transfers, a person's hand).

What a record cannot show, and is not told: whether the controller is built in series, ideal or parallel form (the same
controller exists in all three, unless tau_I < 4 tau_D, which series lacks); and whether it integrates the last sample,
this one or their mean, which moves kp by ki dt in all: the mean is told, the rest is part of the standard deviation.
"""

import math
from contextlib import suppress
from functools import lru_cache

import numpy as np

from retuner.adaptive.controller_settings.regression import BoolArray, Regression, Structure, by_increments, by_levels
from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.indexes.condition import Condition, record_condition, still_stretches
from retuner.adaptive.indexes.output_limits import TOLERANCE, at_limits
from retuner.adaptive.indexes.recording_quality import quantum, recording_quality
from retuner.adaptive.signals.sample import Window, quantile
from retuner.schedule.gains import Form, PidGains, in_form
from retuner.schedule.late_dataclass import dataclass, replace
from retuner.schedule.plain_values import plain_values

# ---- Which structure of a PID law made a record: lag, equation, derivative and filters, and whether P and I are there.
#
# Structures are compared by n ln(rms^2) + unknowns ln(n) (Schwarz 1978), n the number of independent samples in
# what the plain PI law leaves, and never below the rounding of co. A filter time is the one unknown in which the
# law is not linear: a coarse grid, then Gauss-Newton steps from its best (regression.columns with `at`).

SIGNIFICANT = 3.0  # standard deviations from which a gain is there
WORTH = 10.0  # gain in the criterion that a richer structure must bring
FILTERS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # filter times that are tried, in samples
GAUSS_NEWTON = 8  # Gauss-Newton steps of the filter time from the best of these
NEAR_LIMIT = 0.9  # quantile of |increment of co| within which of a limit, once hit, co is not believed to be the law's
WHOLE = (1.0, 100.0)  # upper ends of the range of co as it is usually written
DIFFERENCED = -0.25
"""Correlation of what increments leave from which it is rounding, half way to the -1/2 of nothing but rounding."""
LEVELS_BETTER = 0.8  # ratio of the standard deviations of kp from which levels are taken instead of increments
NO_INTEGRAL = 1.0  # an integral time surely longer than this many record lengths is none
NO_PROPORTIONAL = 0.5  # A kp surely smaller than what the integral does in this share of a sample is none
NOTHING = 1e-6  # share of the other term below which P or I is a rounding of doubles
REMAINDER = 0.8
"""Share of the remainder that may be left by a derivative or filter that is told: the smallest are shifts in time."""
LEAST_DERIVATIVE = 0.5
"""Derivative times under this share of a sample are none: pv and co are not read at quite the same instant."""
COMPARED = 0.9  # share of samples that two structures must have in common to be compared
LEAST_SHARE = 1e-9  # rms of the remainder as a share of co's movement below which a fit is exact


def usable_increments(window: Window, co_min: float | None, co_max: float | None) -> BoolArray:
    """Increments that the law made: both samples inside the limits, not in a long stretch of constant co."""
    co = window.co
    limits = at_limits(co, co_min, co_max)
    reach = TOLERANCE * float(np.ptp(co))
    least, most = float(np.min(co)), float(np.max(co))  # ends of the range show it where they are touched but once
    low = co_min if co_min is not None else least if limits.low or least == 0.0 else -math.inf
    high = co_max if co_max is not None else most if limits.high or most in WHOLE else math.inf
    reach = max(reach, quantile(np.abs(np.diff(co)), NEAR_LIMIT)) if limits.hit else reach
    inside = (co > low + reach) & (co < high - reach)  # nearer to a limit, anti-windup has its hand in it
    for start, end in still_stretches(co):
        inside[start:end] = False
    before = np.concatenate([[True], inside[:-2]])  # what anti-windup did shows one sample later
    return np.asarray(inside[1:] & inside[:-1] & before, dtype=np.bool_)


@lru_cache(maxsize=16)  # a record is asked for its settings, and then for rougher ones
def best_structure(content: tuple[tuple[bytes, ...], float], made: bytes, largest_lag: int) -> Regression:
    """The best structure: lag and equation first, then filter and derivative, then what of P and I is needed.

    content : of the window. made : which increments the law made, as bytes.
    """
    window, usable = Window.holding(content), np.frombuffer(made, dtype=np.bool_)
    lags = [by_increments(window, Structure(lag=lag), usable, sure=False) for lag in range(largest_lag + 1)]
    chosen = by_increments(window, min(lags, key=lambda f: _size(f, usable)).structure, usable)
    levels = by_levels(window, chosen.structure, usable)
    if chosen.rho < DIFFERENCED or levels.doubt("kp") < LEVELS_BETTER * chosen.doubt("kp"):
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
    return found.rms if found.levels else quantile(np.abs(found.remainder[usable]), 0.95)


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


def signs_agree(values: dict[str, float]) -> bool:
    """Whether all gains act one way."""
    gains = [values[name] for name in ("kp", "ki", "kd") if values.get(name)]
    return bool(gains) and (min(gains) > 0 or max(gains) < 0)


# ---- The PI or PID settings in force


@dataclass(frozen=True, slots=True)
class LawSettings:
    """Settings of the recovery. Raises ValueError: one is outside its range."""

    fewest_samples: int = setting(50, "Usable samples needed", "20..1000 samples")
    # a quarter of a second, and settings do not last for ever
    most_samples: int = setting(
        4000, "Samples of a longer record that are taken, where the error moves most", "1000..100_000 samples"
    )
    explained_limit: float = setting(0.8, "Smallest share of co's movement that the law must explain", "0.5..0.99")
    std_limit: float = setting(0.15, "Largest standard deviation of kp (of ki without P) as a share of it", "0.01..0.5")
    disagreement: float = setting(1.25, "Largest ratio of a gain in the two halves of the record", "1.05..2")
    slow_disagreement: float = setting(
        1.15, "The same of kp in fast and slow movements, where only another law makes one", "1.05..2"
    )
    compression_limit: float = setting(
        3.0, "Largest compression of pv or co by a recorder (Thornhill et al. 2004)", "1.5..10"
    )
    largest_lag: int = setting(1, "Samples from pv to co that are tried", "0..3 samples")

    def __post_init__(self) -> None:
        require_in_range(self, "settings read off")


SLOW, FEWEST_SLOW = 5, 60  # samples averaged to see slow movements, and how many such means are needed
ALL_EXPLAINED = 0.9999  # share of co's movement from which slow movements can say nothing new
DIRECTION_EXPLAINED = 0.3  # share of co's movement from which the direction of the controller is told, if nothing else
BEST_STD = 1e-3  # no record shows a gain better than to this share of it: clocks and converters are not better


@dataclass(frozen=True, slots=True)
class SettingsInForce:
    """Settings recovered from a record, or why there are none.

    gains : in parallel form, co units of the record; None when the record does not show them.
    std : standard deviations of kp, ki, kd. b : setpoint weight of P, None when no setpoint change shows it.
    structure : what else was found (derivative on pv or error, filters, lag).
    explained : share of the movement of co that the law explains. samples : increments used.
    reason : one sentence. direction : sign of the controller's gain, told also where its size is not; None where not
        even that shows. rough : gains that are too uncertain to be told, but not to weigh causes by; None where there
        are none, or `gains` are known.
    """

    gains: PidGains | None
    std: dict[str, float]
    b: float | None
    structure: Structure | None
    explained: float
    samples: int
    reason: str
    direction: int | None = None
    rough: PidGains | None = None

    def forms(self) -> dict[str, dict[str, float | None]]:
        """The settings in each form in which this controller exists: kc, tau_i, tau_d by form."""
        found: dict[str, dict[str, float | None]] = {}
        if self.gains is not None and self.gains.kp:
            for form in Form:
                with suppress(ValueError):  # no series form with tau_I < 4 tau_D
                    found[str(form)] = in_form(self.gains, form)
        return found

    def to_dict(self) -> dict[str, object]:
        """Keys parallel {kp, ki, kd}, std, forms, direction, b, derivative_on, tau_f, pv_filter, lag, explained,
        samples, reason; times in seconds, lag in samples.
        """
        s = self.structure
        return {
            **plain_values(self, "parallel=gains std"),
            "forms": self.forms(),
            **plain_values(self, "direction b"),
            "derivative_on": s.derivative or None if s else None,
            "tau_f": s.tau_f_s if s else None,
            "pv_filter": s.pv_filter_s if s else None,
            "lag": s.lag if s else None,
            **plain_values(self, "explained samples reason"),
        }


def settings_in_force(
    window: Window, co_min: float | None = None, co_max: float | None = None, settings: LawSettings | None = None
) -> SettingsInForce:
    """Recover the settings of the controller that made a record.

    window : closed-loop record. co_min, co_max : limits of co where known; else recognised when co stands at them.
    settings : see LawSettings.
    """
    settings = settings or LawSettings()
    n, most = len(window.t_s), settings.most_samples
    if n > most:  # the stretch in which the control error varies most
        e = window.sp - window.pv
        begins = [*range(0, n - most, most // 4), n - most]
        begin = max(begins, key=lambda i: float(np.std(e[i : i + most])))
        window = window.part(slice(begin, begin + most))
    limits = at_limits(window.co, co_min, co_max)
    state = record_condition(window, limits.low + limits.high)
    if state.condition in {Condition.DEAD_PV, Condition.DEAD_CO, Condition.MANUAL}:
        return _refused(state.sentence)
    usable = usable_increments(window, co_min, co_max)
    count = int(np.sum(usable))
    if count < settings.fewest_samples:
        return _refused(f"only {count} samples have co moving inside its limits; {settings.fewest_samples} are needed")
    coarse = quantum(window.pv) > 0  # while such a pv stands, integral action draws straight lines
    for name, signal in (("pv", window.pv), ("co", window.co[1:][usable])):
        quality = None if coarse and name == "co" else recording_quality(signal)
        if quality is not None and quality.compression > settings.compression_limit:
            times = f"{quality.compression:.0f} times"
            return _refused(f"{name} was compressed {times} by its recorder: its movements are lost")
    best = best_structure(window.content, usable.tobytes(), settings.largest_lag)
    # Settings, or the sentence that says why not
    percent = f"{max(best.explained, 0.0):.1%}"
    if best.explained < settings.explained_limit:
        limit = f"{settings.explained_limit:.0%}"
        why = "the controller has other inputs, or pv was filtered or compressed before it was recorded"
        return _refused(f"sp and pv explain only {percent} of co's movement ({limit} needed): {why}", best)
    if not signs_agree(best.values):
        return _refused("the terms that explain co act in opposite directions: this is no PID law", best)
    values, std = _gains(best, window)
    for name, widest in ((best.main, settings.std_limit), ("ki", 2 * settings.std_limit)):
        wide = best.doubt(name) if values[name] else 0.0
        if wide > widest:
            return _refused(f"{name} is only known to +-{wide:.0%}: too little excitation", best)
    reason = _disagreement(best, window, settings)
    if reason:
        return _refused(reason, best)
    seen = best.std.get("b_kp", math.inf) < settings.std_limit * abs(values["kp"])
    weight = best.values["b_kp"] / best.values["kp"] if seen else None
    count = int(np.sum(best.kept))
    told = f"the law explains {percent} of the movement of co in {count} samples"
    gains = PidGains(**values)
    return SettingsInForce(gains, std, weight, best.structure, best.explained, count, told, gains.direction)


def _refused(reason: str, found: Regression | None = None) -> SettingsInForce:
    if found is None:
        return SettingsInForce(None, {}, None, None, 0.0, 0, reason)
    kept = int(np.sum(found.kept))
    sure = found.spread(found.main) < 1 / SIGNIFICANT and found.explained > DIRECTION_EXPLAINED
    agree = signs_agree(found.values)
    direction = int(math.copysign(1, found.values[found.main])) if sure and agree else None
    rough = PidGains(**{name: found.values.get(name, 0.0) for name in ("kp", "ki", "kd")}) if direction else None
    return SettingsInForce(None, {}, None, found.structure, max(found.explained, 0.0), kept, reason, direction, rough)


def _gains(found: Regression, window: Window) -> tuple[dict[str, float], dict[str, float]]:
    """Gains with their standard deviations: of the fit, of what it leaves, and of what the record cannot show.

    What it leaves counts as sqrt(1 - explained) of each gain: records of filtered, compressed or otherwise sampled
    signals have errors of about that size, which scatter alone does not show.
    """
    values = {name: found.values.get(name, 0.0) for name in ("kp", "ki", "kd")}
    doubt = math.hypot(math.sqrt(max(1 - found.explained, 0.0)), BEST_STD)
    std = {name: math.hypot(found.std.get(name, 0.0), doubt * abs(v)) for name, v in values.items()}
    within = values["ki"] * window.sample_time_s
    if values["kp"] * (values["kp"] - within / 2) > 0:
        values["kp"] -= within / 2
        std["kp"] = math.hypot(std["kp"], within / math.sqrt(12.0))
    return values, std


def _disagreement(found: Regression, window: Window, settings: LawSettings) -> str:
    """Whether parts of the record show different settings: the sentence, or nothing."""
    middle = int(np.flatnonzero(found.kept)[int(np.sum(found.kept)) // 2])
    place = np.arange(len(found.kept))
    first, second = (
        fit_on(window, found.structure, found.kept & part, levels=found.levels)
        for part in (place < middle, place >= middle)
    )
    for name in ("kp", "ki"):
        spread = math.hypot(*(f.std.get(name, 0.0) for f in (first, second)))
        if apart([f.values.get(name, 0.0) for f in (first, second)], spread, settings.disagreement):
            a, b = first.values[name], second.values[name]
            return (
                f"{name} is {a:.3g} in the first half of the record and {b:.3g} in the second; "
                "the settings were changed, they depend on another variable, or the integral was held for a while"
            )
    slow = _slow(found, window)
    if slow is None:
        return ""
    # kp of a controller that integrates the mean of two samples
    both = ((found, window.sample_time_s), (slow, SLOW * window.sample_time_s))
    pair = [f.values["kp"] - f.values.get("ki", 0.0) * dt / 2 for f, dt in both]
    if apart(pair, math.hypot(found.std["kp"], slow.std["kp"]), settings.slow_disagreement):
        return (
            f"kp is {pair[0]:.3g} in fast movements and {pair[1]:.3g} in slow ones; the record is too coarse for "
            "this controller's derivative, or the controller used another pv"
        )
    return ""


def apart(values: list[float], std: float, ratio: float) -> bool:
    """Whether two values differ by more than chance and by more than matters."""
    least = (ratio - 1) * max(map(abs, values))
    return abs(values[0] - values[1]) > max(SIGNIFICANT * std, least)


def _slow(found: Regression, window: Window) -> Regression | None:
    """The structure fitted on means of a few samples; None where the record is too short, or all is explained."""
    n = len(window.t_s) // SLOW
    if n < FEWEST_SLOW or not found.structure.proportional or found.explained > ALL_EXPLAINED:
        return None
    signals = (window.t_s, window.sp, window.pv, window.co)
    means = Window(*(x[: n * SLOW].reshape(n, SLOW).mean(axis=1) for x in signals))
    whole = np.all(np.append(found.kept, True)[: n * SLOW].reshape(n, SLOW)[:, :-1], axis=1)
    return by_levels(means, found.structure, np.asarray(whole[1:] & whole[:-1], dtype=np.bool_))
