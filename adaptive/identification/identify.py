"""From a record to a process model with its covariance: maximum likelihood, or "not identifiable".

The fit engine (fit/) refines every structure with as many load steps as pay and whitens what is left; here the winner
is turned into parameters with standard deviations, the record is compressed for the Kalman filter, and it is judged
whether settings may follow:

    R x = z + unit noise     the record linearised at the optimum, load times taken out, by QR
    P^-1 = R'R + prior       sigma is the remainder's own; where the remainder is not white even through its filter, the
                             record counts as the fewer independent samples that it holds

A model that does not explain a record must not become sure of it. The prior inside the nonlinear fit is the iterated
extended Kalman update (Bell & Cathey 1993); see tracker.py.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import Fit, Prior
from retuner.adaptive.fit.structure import SIZE
from retuner.adaptive.identification.candidate import Candidate, with_priors
from retuner.adaptive.identification.estimate import (
    Alternative,
    LogModel,
    ModelEstimate,
    gain_spread,
    proper_covariance,
)
from retuner.adaptive.identification.plausible import Plausible, plausible
from retuner.adaptive.identification.structure_choice import ChoiceSettings, candidates
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.rules.simc import without_second_lag
from retuner.adaptive.signals.sample import FloatArray, Window


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Settings of identification.

    choice : how structures and load steps are looked for; see ChoiceSettings.
    most_samples : longer records are condensed to this many; 200 to 10000, default 1500 (a fit then takes well under a
        second, and the rest of the information is noise averaged away).
    gain_std_limit : largest standard deviation of ln |C|, the controller that follows, with which settings may be
        given; 0.05 to 1, default 0.2 (SIMC at tau_c = theta has a gain margin of 3, so two such deviations leave a
        factor of 2).
    lag_std_limit : the same of ln(tau) where tau decides (theta < tau < 8 theta); default 0.7.
    explained_limit : smallest share of pv's variance that must be explained; default 0.5.
    """

    choice: ChoiceSettings = field(default_factory=ChoiceSettings)
    most_samples: int = 1500
    gain_std_limit: float = 0.2
    lag_std_limit: float = 0.7
    explained_limit: float = 0.5


OPEN_LOOP = FitSettings(ChoiceSettings(seeded_loads=0, most_loads=0, start_spread=0.0))
"""For an experiment in manual that begins at rest."""

LARGEST_RHO = 0.98
"""Autocorrelations above this are not told apart; a hundred samples then count as one."""
FEWEST_SAMPLES_IN_THETA = 1.0
"""An effective dead time of fewer sampling intervals is a guess."""
WANTED_SAMPLES_IN_THETA = 4
"""Sampling intervals in the effective dead time with which a record is easy to identify from."""
WIDEST_STD = 3.0
"""A time constant that a record says nothing of is still known to a factor of e^3: shorter than the record, longer than
nothing."""
WIDEST_GAIN_STD = 20.0
"""The same of the slope gain."""


def identify_window(
    window: Window,
    sign: int | None = None,
    priors: Mapping[ProcessType, LogModel] | None = None,
    settings: FitSettings | None = None,
) -> ModelEstimate:
    """Find the process behind a record.

    Parameters
    ----------
    window : the record: open-loop step, closed-loop setpoint or load responses, several of them.
    sign : sign of the process gain where it is known (a closed loop shows it); else both are tried.
    priors : what is known already, by structure.
    settings : see FitSettings.

    Raises
    ------
    ValueError
        co or pv do not change at all in the record: there is nothing to identify from.
    """
    settings = settings or FitSettings()
    signs = (sign,) if sign else tuple({log.sign for log in (priors or {}).values()}) or (1, -1)
    found = fitted(window, signs, settings)
    origin_s = float(window.t_s[0])
    if not priors:
        return estimate_of(found, origin_s, {}, settings)
    known = {t: Prior.of(log.x, log.p) for t, log in priors.items() if log.sign == found[0].fit.misfit.sign}
    return estimate_of(with_priors(found, known), origin_s, known, settings)


def fitted(window: Window, signs: tuple[int, ...], settings: FitSettings) -> list[Candidate]:
    """The fits of a record by itself, best first.

    Raises
    ------
    ValueError
        co or pv do not change at all in the record.
    """
    for name, values in (("co", window.co), ("pv", window.pv)):
        if np.ptp(values) == 0:
            raise ValueError(f"{name} stays at {values[0]:g} in the whole record: nothing to identify from")
    return candidates(window, signs, settings.choice, settings.most_samples)


def estimate_of(
    found: list[Candidate], origin_s: float, priors: Mapping[ProcessType, Prior], settings: FitSettings
) -> ModelEstimate:
    """The candidates, best first, as an estimate. origin_s : the record's zero in the user's time."""
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
    identifiable, reason = _judge(log, around, explained, record, settings)
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
    )


def _alternative(candidate: Candidate, prior: Prior | None) -> Alternative:
    """Covariance, and compression for the Kalman filter."""
    fit = candidate.fit
    record, d = fit.misfit.record, SIZE[fit.misfit.type]
    inflation = inflation_of(fit)
    information, score = _compress(fit.misfit.jacobian(fit.at) / inflation, fit.at.r / inflation, fit.p, d)
    precision = information.T @ information
    precision = precision + (_broad(d) if prior is None else prior.root.T @ prior.root)
    covariance = proper_covariance(np.asarray(np.linalg.inv(precision), dtype=np.float64))
    log = LogModel(fit.x.copy(), covariance, fit.misfit.sign, fit.misfit.type)
    n = len(record.pv)
    evidence = candidate.criterion - d * math.log(n)
    return Alternative(log, evidence, information, score, n)


def inflation_of(fit: Fit) -> float:
    """Factor on sigma with which a fit's residuals count: above the noise, correlated, finer than the resolution."""
    record = fit.misfit.record
    floor = record.resolution / fit.misfit.sigma
    return max(_inflation(fit.at.r[: len(record.pv)], len(fit.p)), floor)


def _broad(d: int) -> FloatArray:
    """Precision of what is known of any process before any record."""
    return np.diag([WIDEST_GAIN_STD**-2, *[WIDEST_STD**-2] * (d - 1)])


def _inflation(r: FloatArray, parameters: int) -> float:
    """Factor on sigma: what is left above it, and the information that correlated residuals do not hold."""
    dof = max(len(r) - parameters - 2, 1)
    return math.sqrt(float(r @ r) / dof * _correlation(r))


def _correlation(r: FloatArray) -> float:
    """How many correlated samples count as one: (1 + rho)/(1 - rho) for a first-order autocorrelation rho >= 0."""
    rho = float(r[1:] @ r[:-1]) / max(float(r @ r), 1e-300)
    rho = min(max(rho, 0.0), LARGEST_RHO)
    return (1 + rho) / (1 - rho)


def _compress(jacobian: FloatArray, r: FloatArray, p: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """R (d, d) and z (d,) with R x = z + unit noise: the linearised record, load times taken out."""
    process, loads = jacobian[:, :d], jacobian[:, d:]
    if loads.shape[1]:
        q, _ = np.linalg.qr(loads)
        process, r = process - q @ (q.T @ process), r - q @ (q.T @ r)
    q, triangle = np.linalg.qr(process)
    z = triangle @ p[:d] - q.T @ r
    return np.asarray(triangle, dtype=np.float64), np.asarray(z, dtype=np.float64)


def _judge(
    log: LogModel, around: tuple[Plausible, ...], explained: float, record: Record, settings: FitSettings
) -> tuple[bool, str]:
    """Whether settings may follow from this estimate, and the sentence that says why."""
    model = log.model()
    if explained < settings.explained_limit:
        return False, f"the model explains {explained:.0%} of pv's variance; {settings.explained_limit:.0%} are needed"
    short = without_second_lag(model).theta_s
    if short < FEWEST_SAMPLES_IN_THETA * record.sample_time_s:
        return False, (
            f"the effective dead time comes out as {short:.3g} s, less than the sampling interval of "
            f"{record.sample_time_s:.3g} s: sample at least {WANTED_SAMPLES_IN_THETA} times in it"
        )
    gain_std = max(log.gain_uncertainty(record.sample_time_s), gain_spread(around, record.sample_time_s))
    if gain_std > settings.gain_std_limit:
        return False, (
            f"the controller gain that follows is known to a factor of {_factor(gain_std)}; "
            f"{_factor(settings.gain_std_limit)} is needed: the record moves the process too little"
        )
    plain = without_second_lag(model)
    lag_std = log.lag_uncertainty()
    if plain.theta_s < plain.tau1_s < 8 * plain.theta_s and lag_std > settings.lag_std_limit:
        return False, f"the lag is known to a factor of {_factor(lag_std)}; {_factor(settings.lag_std_limit)} is needed"
    return True, f"{NAMES[log.type]} explains {explained:.1%} of pv's variance"


NAMES = {
    ProcessType.FOPDT: "first order + dead time",
    ProcessType.SOPDT: "second order + dead time",
    ProcessType.INTEGRATING: "integrating + dead time",
    ProcessType.INTEGRATING_LAG: "integrating with lag + dead time",
}
"""The structures in words."""


def _factor(log_std: float) -> str:
    """A standard deviation of a logarithm as the factor people think in."""
    return f"{math.exp(log_std):.2f}" if log_std < math.log(1000) else "over 1000"
