"""From a record to a process model with its covariance: maximum likelihood, or "not identifiable".

The fit engine (fit/) refines every structure with as many load steps as pay and whitens what is left; here the winner
is turned into parameters with standard deviations, the record is compressed for the Kalman filter, and it is judged
whether settings may follow:

    R x = z + unit noise     the record linearised at the optimum, load times taken out, by QR
    P^-1 = R'R + prior       sigma is the remainder's own; where the remainder is not white even through its filter, the
                             record counts as the fewer independent samples that it holds

A model that does not explain a record must not become sure of it. The prior inside the nonlinear fit is the iterated
extended Kalman update (Bell & Cathey 1993); see region_model/update.py.
"""

import math
from collections.abc import Mapping
from functools import cached_property, lru_cache

import numpy as np

from retuner.adaptive.fit.record import Record, apart, setpoint_changes
from retuner.adaptive.fit.refine import Fit, Prior
from retuner.adaptive.fit.structure import SIZE, THIRD, model_at
from retuner.adaptive.identification.candidate import MODEL_ERROR, Candidate, loads_at, with_priors
from retuner.adaptive.identification.estimate import (
    Alternative,
    LogModel,
    ModelEstimate,
    RivalModel,
    factor_text,
    factors_text,
    gain_spread,
    proper_covariance,
)
from retuner.adaptive.identification.plausible import Plausible, plausible, within_reach
from retuner.adaptive.identification.structure_choice import StructureSettings, candidates
from retuner.adaptive.identification.usual_dead_time import usual
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.rules.simc import without_second_lag
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass, field, replace


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Settings of identification.

    choice : how structures and load steps are looked for; see ChoiceSettings.
    most_samples : longer records are condensed to this many; 200 to 10000, default 1500 (a fit then takes well under a
        second, and the rest of the information is noise averaged away).
    gain_std_limit : largest standard deviation of ln |C|, the controller that follows, with which settings may be
        given; 0.05 to 1, default 0.25 (SIMC at tau_c = theta has a gain margin of 3, so two such deviations leave a
        factor of 2).
    lag_std_limit : the same of ln(tau) where tau decides (theta < tau < 8 theta); default 0.7.
    explained_limit : smallest share of pv's variance that must be explained; default 0.5.
    remainder_limit : what the model may leave, in standard deviations of the noise; 3 to 10, default 5.
    remainder_share : unless it is less than this share of pv's range; 0.005 to 0.03, default 0.01 (what a second-order
        model leaves of a real response is half of that).
    beside : what the model may leave beyond the noise, as a share of what it explains; 0.1 to 0.5, default 0.2 (drawn
        records of which settings came out right: up to 0.10; a noisy pressure loop's fiction: 0.5).
    valve_lead : by how much (criterion) a valve that sticks or has play must explain a setpoint step better than none,
        beyond its price; 0 to 50, default 15 (without a valve, beside noise or a load step, no record came near that;
        ramps and walks did).
    theta_share : longest effective dead time as a share of the record; 0.1 to 0.5, default 0.25: no event is seen for
        long enough after a longer one.
    hopeless : a rival model that leaves so many times as much is none; 1.3 to 3, default 1.5 (the fictions of three
        real loops: up to 1.20; true loads soon after a setpoint change: 1.12 to 1.78).
    apart_limit : largest distance of a rival model without load steps at setpoint changes (fit/record.py);
        0.2 to 1, default 0.5.
    """

    choice: StructureSettings = field(default_factory=StructureSettings)
    most_samples: int = 1500
    gain_std_limit: float = 0.25
    lag_std_limit: float = 0.7
    explained_limit: float = 0.5
    hopeless: float = 1.5
    apart_limit: float = 0.5
    remainder_limit: float = 5.0
    remainder_share: float = 0.01
    beside: float = 0.2
    theta_share: float = 0.25
    valve_lead: float = 15.0


OPEN_LOOP = FitSettings(StructureSettings(seeded_loads=0, most_loads=0, start_spread=0.0))
"""Settings for an experiment in manual that begins at rest."""
FROM_MOTION = FitSettings(StructureSettings(seeded_loads=0, most_loads=0))
"""Settings for one that begins in motion, or with its step in the first row."""
START_COST = 2.0  # unknowns of a start that was not rest: a step and an impulse before the record
START_FOR_NOTHING = 10.0
"""More of the criterion where no process is identifiable with it and one is from rest (Kass & Raftery 1995)."""

LARGEST_RHO = 0.98  # autocorrelations above this are not told apart; a hundred samples then count as one
WHITE_LOADS = 6  # load steps with which a remainder may be explained that is to be white, as in diagnosis
TWO_WAYS = (
    "two models explain the record, one with load steps and white noise, one with a drift; "
    "their gains differ by a factor of {}"
)
"""Why a coloured remainder is not believed."""
FEWEST_SAMPLES_IN_THETA = 1.0  # an effective dead time of fewer sampling intervals is a guess
ROWS_IN_DEAD_TIME = 2.0
"""Rows of a condensed record in the dead time at the least: it comes out a little shorter or longer from fit to fit."""
MOST_ROWS = 12000
"""Rows to which a record is condensed at the least where its dead time would be shorter than a row otherwise."""
MOST_FASTER = 0.02  # share of a sampling interval that nobody is asked to sample faster than
WANTED_SAMPLES_IN_THETA = 4
"""Sampling intervals in the effective dead time with which a record is easy to identify from."""
WIDEST_STD = 3.0
"""A time constant that a record says nothing of is still known to a factor of e^3: shorter than the record, longer than
nothing."""
WIDEST_GAIN_STD = 20.0  # widest standard deviation of the slope gain


def identify_window(
    window: Window,
    sign: int | None = None,
    priors: Mapping[ProcessType, LogModel] | None = None,
    settings: FitSettings | None = None,
) -> ModelEstimate:
    """Find the process behind a record.

    window : the record: open-loop step, closed-loop setpoint or load responses, several of them.
    sign : sign of the process gain where it is known (a closed loop shows it); else both are tried.
    priors : what is known already, by structure.
    settings : see FitSettings.

    Raises ValueError: co or pv do not change at all in the record, or it has too few samples: there is nothing to
    identify from.
    """
    settings = settings or FitSettings()
    signs = (sign,) if sign else tuple({log.sign for log in (priors or {}).values()}) or (1, -1)
    fits = Fits(window, signs, settings)
    if not priors:
        return fits.estimate()
    found = fits.free
    known = {t: Prior.of(log.x, log.p) for t, log in priors.items() if log.sign == found[0].fit.misfit.sign}
    return estimate_of(with_priors(found, known), float(window.t_s[0]), known, settings)


def identify_manual(window: Window, sign: int | None = None) -> ModelEstimate:
    """Find the process behind an experiment in manual; whether it began at rest is told by the record.

    window, sign : see identify_window.

    Raises ValueError: co or pv do not change at all in the record.
    """
    rest = identify_window(window, sign, settings=OPEN_LOOP)
    moving = identify_window(window, sign, settings=FROM_MOTION)
    for_nothing = rest.identifiable and not moving.identifiable
    price = START_COST * math.log(len(window.t_s)) + START_FOR_NOTHING * for_nothing
    return moving if moving.best.criterion + price < rest.best.criterion else rest


def fitted(
    window: Window, signs: tuple[int, ...], settings: FitSettings, barred_s: tuple[float, ...] = (),
    samples: int | None = None,
) -> list[Candidate]:  # fmt: skip
    """The fits of a record by itself, best first, on so many samples; None for as many as show its dead time.

    barred_s : see candidates. Raises ValueError: co or pv do not change at all in the record.
    """
    for name, values in (("co", window.co), ("pv", window.pv)):
        if np.ptp(values) == 0:
            raise ValueError(f"{name} stays at {values[0]:g} in the whole record: nothing to identify from")
    return list(_fitted(window.content, signs, settings, barred_s, samples))


@lru_cache(maxsize=16)  # a record is asked for twice, to identify and to diagnose it; its parts alone and joined
def _fitted(
    content: tuple[tuple[bytes, ...], float], signs: tuple[int, ...], settings: FitSettings,
    barred_s: tuple[float, ...], samples: int | None,
) -> list[Candidate]:  # fmt: skip
    window = Window.holding(content)
    found = candidates(window, signs, settings.choice, samples or settings.most_samples, barred_s)
    best, n = found[0].fit, len(window.t_s)
    dead_s = without_second_lag(model_at(best.misfit.type, best.x, 1)).theta_s
    rows = max(int(dead_s / (ROWS_IN_DEAD_TIME * window.sample_time_s)), 1, -(-n // MOST_ROWS))
    short = dead_s < ROWS_IN_DEAD_TIME * best.misfit.record.sample_time_s
    if samples or not short or rows >= -(-n // settings.most_samples):
        return found
    return candidates(window, signs, settings.choice, -(-n // rows))  # with them a row is at most half the dead time


class Fits:
    """The fits of a record as identification makes them, each made once, when it is asked for.

    window : the record. signs : of the process gain to try. settings : see FitSettings.
    """

    def __init__(self, window: Window, signs: tuple[int, ...], settings: FitSettings) -> None:
        self._window, self._signs, self._settings = window, signs, settings
        self._changes_s = setpoint_changes(window)

    @cached_property
    def free(self) -> list[Candidate]:
        """Fits with load steps wherever they pay, best first.

        What was found without load steps at setpoint changes is among it: a search with more freedom may miss it, but
        where it is the better explanation it is the one.
        """
        found = self._anywhere
        return found if self.barred[0].criterion >= found[0].criterion else self.barred

    @cached_property
    def barred(self) -> list[Candidate]:
        """Fits with no load step at a setpoint change, best first."""
        if not self._coincident(self._anywhere[0]):
            return self._anywhere
        return fitted(self._window, self._signs, self._settings, self._changes_s, self._samples)

    @property
    def _samples(self) -> int:
        """Samples of each fit: as many as that of the first, so that they may be compared."""
        return max(self._settings.most_samples, len(self._anywhere[0].fit.misfit.record.pv))

    @cached_property
    def _anywhere(self) -> list[Candidate]:
        """What the search finds that may place load steps anywhere, best first."""
        return fitted(self._window, self._signs, self._settings)

    def rival(self, best: Candidate) -> RivalModel | None:
        """The model without load steps at setpoint changes.

        None where the best explanation has none there, and where nothing else explains the record: then they are loads.
        """
        at = self._coincident(best)
        if not at or self.barred[0].colour.std > self._settings.hopeless * self.free[0].colour.std:
            return None
        free, barred = (c.model for c in (best, self.barred[0]))
        distance = apart(free, barred, self._window.sample_time_s)
        return RivalModel(barred, distance, float(self._window.t_s[0]) + at[0])

    def estimate(self, *, whatever_loads: bool = False) -> ModelEstimate:
        """What the record says by itself.

        whatever_loads : the rival without load steps at setpoint changes is not asked.
        """
        rival = None if whatever_loads else self.rival(self.free[0])
        found = estimate_of(self.free, float(self._window.t_s[0]), {}, self._settings, rival)
        if not found.identifiable or not found.coloured or not self._settings.choice.most_loads:
            return found
        # A model that takes what is left for white noise beside more load steps
        best = self.free[0]
        choice = replace(self._settings.choice, most_order=0, most_loads=WHITE_LOADS)
        other = candidates(self._window, (best.fit.misfit.sign,), choice, self._samples)[0]
        own, white = (c.model for c in (best, other))
        between = apart(own, white, self._window.sample_time_s)
        if between <= self._settings.apart_limit:
            return found
        return replace(found, identifiable=False, reason=TWO_WAYS.format(factor_text(between)))

    def _coincident(self, found: Candidate) -> list[float]:
        """The setpoint changes at which an explanation has a load step."""
        return [change for change in self._changes_s if loads_at(found.fit, (change,))]


def estimate_of(
    found: list[Candidate],
    origin_s: float,
    priors: Mapping[ProcessType, Prior],
    settings: FitSettings,
    rival: RivalModel | None = None,
) -> ModelEstimate:
    """The candidates, best first, as an estimate.

    origin_s : the record's zero in the user's time. rival : see Fits.
    """
    best = found[0]
    record = best.fit.misfit.record
    firsts = {c.fit.misfit.type: c for c in reversed(found) if c.fit.misfit.sign == best.fit.misfit.sign}
    ordered = sorted(firsts.values(), key=lambda c: (c is not best, c.criterion))  # the winner leads among equals
    alternatives = tuple(_alternative(c, priors.get(c.fit.misfit.type)) for c in ordered)
    fit = best.fit
    left = record.pv - fit.explained
    log = alternatives[0].log
    around = plausible(found, log.p, priors)
    explained = 1 - float(np.var(left) / np.var(record.pv))
    identifiable, reason = _judge(log, around, explained, record, priors.get(log.type), settings)
    doubt = unexplained(float(np.std(left)), float(np.std(fit.explained)), record, settings)
    if identifiable and doubt:
        identifiable, reason = False, doubt
    if rival is not None and rival.apart > settings.apart_limit:  # what it says of itself does not count then
        identifiable, reason = False, rival.sentence
    loads = tuple(origin_s + t for t in fit.load_times_s)
    return ModelEstimate(
        identifiable,
        reason,
        loads,
        float(np.std(left)),
        record.noise_std,
        alternatives,
        len(best.colour.ar),
        around,
        explained,
        rival,
        fit.ramp_s,
    )


def _alternative(candidate: Candidate, prior: Prior | None) -> Alternative:
    """Covariance, and compression for the Kalman filter."""
    fit = candidate.fit
    record, d = fit.misfit.record, SIZE[fit.misfit.type]
    inflation = inflation_of(fit)
    jacobian = fit.misfit.jacobian(fit.at) / inflation
    r = fit.at.r / inflation
    # information R (d, d) and score z (d,) with R x = z + unit noise: the linearised record, load times taken out
    process, loads = jacobian[:, :d], jacobian[:, d:]
    if loads.shape[1]:
        q, _ = np.linalg.qr(loads)
        process, r = process - q @ (q.T @ process), r - q @ (q.T @ r)
    q, triangle = np.linalg.qr(process)
    information = np.asarray(triangle, dtype=np.float64)
    score = np.asarray(triangle @ fit.p[:d] - q.T @ r, dtype=np.float64)
    precision = information.T @ information
    known = usual(fit.misfit.type, fit.x) if prior is None else prior
    precision = precision if known is None else precision + known.root.T @ known.root
    precision = precision + broad(d) if prior is None else precision
    covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    if fit.misfit.type in THIRD:
        covariance = within_reach(fit, covariance, prior, inflation)
    covariance = proper_covariance(covariance)
    log = LogModel(fit.x.copy(), covariance, fit.misfit.sign, fit.misfit.type)
    n = len(record.pv)
    evidence = candidate.criterion - d * math.log(n)
    return Alternative(log, evidence, information, score, n)


def inflation_of(fit: Fit) -> float:
    """Factor on sigma with which a fit's residuals count: above the noise, correlated, finer than the resolution."""
    record = fit.misfit.record
    floor = record.resolution / fit.misfit.sigma
    left = float(np.std(record.pv - fit.at.explained))
    whitened_away = left / (FITTED * max(record.noise_std, MODEL_ERROR * record.pv_range))
    # What is left above sigma, and the information that correlated residuals do not hold
    r = fit.at.r[: len(record.pv)]
    dof = max(len(r) - len(fit.p) - 2, 1)
    rho = min(max(float(r[1:] @ r[:-1]) / max(float(r @ r), 1e-300), 0.0), LARGEST_RHO)
    return max(math.sqrt(float(r @ r) / dof * ((1 + rho) / (1 - rho))) * math.sqrt(max(whitened_away, 1.0)), floor)


FITTED = 2.0
"""A remainder of so many times the noise is what a good fit leaves at the most; a filter takes more of it away, and the
estimate would pass for as sure as if it had been explained."""


def broad(d: int) -> FloatArray:
    """Precision of what is known of any process before any record."""
    return np.diag([WIDEST_GAIN_STD**-2, *[WIDEST_STD**-2] * (d - 1)])


def unexplained(left_std: float, explained_std: float, record: Record, settings: FitSettings) -> str:
    """Why a model that explains most of pv does not explain the record; empty where it does.

    left_std, explained_std : of what it leaves and of what it explains, pv units.
    """
    times, share = left_std / record.noise_std, left_std / record.pv_range
    beyond = math.sqrt(max(left_std**2 - record.noise_std**2, 0.0)) / max(explained_std, np.finfo(np.float64).tiny)
    told = f"{times:.0f} times the noise, {share:.1%} of pv's range"
    if times <= settings.remainder_limit or share <= settings.remainder_share:
        if beyond <= settings.beside:
            return ""
        told = f"{beyond:.0%} of what it explains, beyond the noise"
    return f"the model leaves {told}: an effect on pv is missing in it (structure, nonlinearity or load shape)"


def _settled(before: Prior | None, log: LogModel, sample_time_s: float, settings: FitSettings) -> bool:
    """Whether what was known before a record carries settings by itself: a short record takes nothing from that."""
    if before is None:
        return False
    covariance = proper_covariance(np.asarray(np.linalg.inv(before.root.T @ before.root), dtype=np.float64))
    known = LogModel(before.mean, covariance, log.sign, log.type)
    return known.gain_uncertainty(sample_time_s) <= settings.gain_std_limit


def _judge(
    log: LogModel,
    around: tuple[Plausible, ...],
    explained: float,
    record: Record,
    before: Prior | None,
    settings: FitSettings,
) -> tuple[bool, str]:
    """Whether settings may follow from this estimate, and the sentence that says why.

    before : what was known. A dead time that is not short beside the record must have been known before.
    """
    if explained < settings.explained_limit:
        return False, f"the model explains {explained:.0%} of pv's variance (at least {settings.explained_limit:.0%})"
    reach_s = math.inf if _settled(before, log, record.sample_time_s, settings) else record.span_s
    open_ = left_open(log, around, record.sample_time_s, reach_s, settings)
    dead_s = without_second_lag(log.model()).theta_s
    if record.logged_s <= dead_s < record.sample_time_s:  # not for want of logging
        open_ = (
            f"dead time about {dead_s:.3g} s, too short for this record condensed to rows of "
            f"{record.sample_time_s:.3g} s (logged every {record.logged_s:.3g} s): identify a shorter part"
        )
    return not open_, open_ or f"{NAMES[log.type]} explains {explained:.1%} of pv's variance"


def left_open(
    log: LogModel, around: tuple[Plausible, ...], sample_time_s: float, span_s: float, settings: FitSettings
) -> str:
    """What is not known well enough for settings, in words; empty where enough is.

    around : the models still allowed. sample_time_s, span_s : of the record; a span without end asks nothing of it.
    """
    plain = without_second_lag(log.model())
    short = plain.theta_s
    if short < FEWEST_SAMPLES_IN_THETA * sample_time_s:
        wanted_s = short / WANTED_SAMPLES_IN_THETA
        way = "A clear setpoint step would bound it"
        if wanted_s > MOST_FASTER * sample_time_s:
            digit = 10.0 ** math.floor(math.log10(wanted_s))
            way = f"Export at {math.floor(wanted_s / digit) * digit:g} s or faster"
        return f"the dead time (about {short:.1g} s) is shorter than the {sample_time_s:.3g} s logging interval. {way}"
    if short > settings.theta_share * span_s:
        return (
            f"the dead time (about {short:.2g} s) is {100 * short / span_s:.0f} % of the record, and no event is "
            "recorded long enough. Record longer"
        )
    gain_std = max(log.gain_uncertainty(sample_time_s), gain_spread(around, sample_time_s))
    if gain_std > settings.gain_std_limit:
        known, needed = factors_text(gain_std, settings.gain_std_limit)
        return f"Kc is uncertain by {known}x (limit {needed}x): the record excites the process too little"
    lag_std = log.lag_uncertainty()
    if plain.theta_s < plain.tau1_s < 8 * plain.theta_s and lag_std > settings.lag_std_limit:
        return "the lag is uncertain by {}x (limit {}x)".format(*factors_text(lag_std, settings.lag_std_limit))
    return ""


NAMES = {
    ProcessType.FOPDT: "first order + dead time",
    ProcessType.SOPDT: "second order + dead time",
    ProcessType.INTEGRATING: "integrating + dead time",
    ProcessType.INTEGRATING_LAG: "integrating with lag + dead time",
    ProcessType.SOPDT_INVERSE: "second order with inverse response + dead time",
    ProcessType.SOPDT_LEAD: "second order with a lead + dead time",
    ProcessType.TOPDT: "third order + dead time",
}
"""The structures in words."""
