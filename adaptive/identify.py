"""From a record to a process model with its covariance: maximum likelihood, or "not identifiable".

Minimised is the output-error misfit (output_error.py) plus the prior,

    |r(p)|^2 + (x - m)' P^-1 (x - m),   x = the first three of p,

from the starts of search.py. The number of load steps is chosen by an information criterion. The residuals
are counted in the noise that the record itself shows; where the best fit leaves more than that, sigma grows to it, and
where what is left is correlated, the record counts as the fewer independent samples that it holds: a model that does
not explain a record must not become sure of it. The prior inside the nonlinear fit is the iterated extended Kalman
update (Bell & Cathey 1993); see tracker.py.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares

from retuner.adaptive.estimate import LogModel, ModelEstimate, proper_covariance
from retuner.adaptive.noise import noise_sigma
from retuner.adaptive.output_error import PROCESS_PARAMETERS, OutputError
from retuner.adaptive.sample import FloatArray, Window
from retuner.adaptive.search import starts


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Settings of identification.

    most_loads : load steps looked for in one record; 0 to 4, default 2 (0 for an open-loop experiment).
    most_samples : longer records are condensed to this many; 200 to 10000, default 1500 (a fit then takes well under a
        second, and the rest of the information is noise averaged away).
    starts : refinements per number of load steps; 1 to 8, default 3 (nested local optima, estimation study).
    gain_std_limit : largest standard deviation of ln |G(j/theta)| with which settings may be given; 0.05 to 1,
        default 0.25 (SIMC at tau_c = theta has a gain margin of 3, so two such deviations leave a factor of 1.9).
    lag_std_limit : the same of ln(tau) where tau decides (theta < tau < 8 theta); default 0.7.
    start_spread : how far from rest a record may begin, as a fraction of pv's range; default 0.3, 0 for an
        experiment that is known to begin at rest.
    explained_limit : smallest share of pv's variance that must be explained; default 0.5.
    """

    most_loads: int = 2
    starts: int = 3
    most_samples: int = 1500
    gain_std_limit: float = 0.25
    lag_std_limit: float = 0.7
    start_spread: float = 0.3
    explained_limit: float = 0.5


OPEN_LOOP = FitSettings(most_loads=0, start_spread=0.0)
"""For an experiment in manual that begins at rest."""


FEWEST_INDEPENDENT = 6.0
"""However smooth a remainder is, it counts as this many independent samples: a tenfold better fit is believed."""
MODEL_ERROR = 0.02
"""What a first-order model leaves of a real response (order, curvature): rms as a share of pv's range."""
LEAST_PRECISION = 1e-6
"""A direction that a record says nothing about has a standard deviation of e^1000, not an infinite one."""
GAIN_RANGE = 1e9
"""k' is looked for within this factor round (range of pv) / (range of co, length of the record)."""
LARGEST_RHO = 0.98
"""Autocorrelations above this are not told apart; a hundred samples then count as one."""


@dataclass(frozen=True, slots=True)
class _Fit:
    """One refined optimum of one misfit."""

    misfit: OutputError
    p: FloatArray
    deviance: float


def identify_window(
    window: Window, sign: int | None = None, prior: LogModel | None = None, settings: FitSettings | None = None
) -> ModelEstimate:
    """Fit first order + dead time to a record.

    Parameters
    ----------
    window : the record: open-loop step, closed-loop setpoint or load responses.
    sign : sign of the process gain where it is known (a closed loop shows it); else both are tried.
    prior : what is known already.
    settings : see FitSettings.

    Raises
    ------
    ValueError
        co or pv do not change at all in the record: there is nothing to identify from.
    """
    settings = settings or FitSettings()
    window = window.condensed(settings.most_samples)
    origin_s = float(window.t_s[0])  # seconds since 1970 leave too few digits for derivatives by the dead time
    window = replace(window, t_s=window.t_s - origin_s)
    for name, values in (("co", window.co), ("pv", window.pv)):
        if np.ptp(values) == 0:
            raise ValueError(f"{name} stays at {values[0]:g} in the whole record: nothing to identify from")
    noise = max(noise_sigma(window.pv), 1e-7 * float(np.ptp(window.pv)))
    signs = (sign or (prior.sign if prior else 0),) if sign or prior else (1, -1)
    fit = _best([OutputError(window, noise, s, settings.start_spread) for s in signs], prior, settings)
    estimate = _estimate(fit, prior, settings)
    return replace(estimate, load_times_s=tuple(origin_s + t for t in estimate.load_times_s))


def _best(misfits: list[OutputError], prior: LogModel | None, settings: FitSettings) -> _Fit:
    """The best optimum over signs and starts, with as many load steps as are worth their two unknowns each."""
    fits: list[list[_Fit]] = [[] for _ in range(settings.most_loads + 1)]
    for misfit in misfits:
        points = starts(misfit, settings.most_loads, settings.starts)
        if prior is not None:
            points += [np.concatenate([prior.x, p[PROCESS_PARAMETERS:]]) for p in points]
        for p in _distinct(points):
            fits[len(p) - PROCESS_PARAMETERS].append(_refine(misfit, p, prior))
    closest = [min(same, key=lambda fit: fit.deviance) for same in fits if same]
    chosen = closest[0]
    for fit in closest[1:]:
        if _worth(chosen, fit):
            chosen = fit
    return chosen


def _worth(simple: _Fit, rich: _Fit) -> bool:
    """Whether more load steps explain so much more that they are no mere cover for a wrong structure.

    The information criterion n ln(misfit) + unknowns ln n, with n the number of independent samples in what the
    simpler fit leaves: a smooth remainder of a hundred samples is a few pieces of evidence, not a hundred. What any
    structure leaves of a real process (MODEL_ERROR) is no evidence at all.
    """
    r = simple.misfit.residuals(simple.p)[:-1]
    independent = max(len(r) / _correlation(r), FEWEST_INDEPENDENT)
    unknowns = 2 * (len(rich.p) - len(simple.p))
    allowance = len(r) * (MODEL_ERROR * float(np.ptp(simple.misfit.window.pv)) / simple.misfit.sigma) ** 2
    gain = math.log((simple.deviance + allowance) / (rich.deviance + allowance))
    return independent * gain > unknowns * math.log(len(r))


def _distinct(points: list[FloatArray]) -> list[FloatArray]:
    """Without repetitions."""
    return list({tuple(np.round(p, 9)): p for p in points}.values())


def _root(prior: LogModel) -> FloatArray:
    """L' with P^-1 = L L'."""
    return np.linalg.cholesky(np.linalg.inv(prior.p)).T


def _refine(misfit: OutputError, start: FloatArray, prior: LogModel | None) -> _Fit:
    """Trust-region Gauss-Newton from one start, kept inside what the record can show at all."""
    t = misfit.window.t_s
    dt, span = misfit.window.sample_time_s, float(t[-1] - t[0])
    loads = len(start) - PROCESS_PARAMETERS
    usual = math.log(float(np.ptp(misfit.window.pv)) / float(np.ptp(misfit.window.co)) / span)
    reach = math.log(GAIN_RANGE)
    low = np.array([usual - reach, math.log(0.02 * dt), math.log(0.3 * dt), *[float(t[0])] * loads])
    high = np.array([usual + reach, math.log(0.9 * span), math.log(100.0 * span), *[float(t[-1]) - dt] * loads])
    root = None if prior is None else _root(prior)

    def residuals(p: FloatArray) -> FloatArray:
        r = misfit.residuals(p)
        if prior is None or root is None:
            return r
        return np.concatenate([r, root @ (p[:PROCESS_PARAMETERS] - prior.x)])

    scale = np.concatenate([np.full(PROCESS_PARAMETERS, 0.3), np.full(loads, 5 * dt)])
    inside = np.clip(start, low + 1e-9, high - 1e-9)
    found = least_squares(residuals, inside, bounds=(low, high), x_scale=scale, max_nfev=60, xtol=1e-7, ftol=1e-8)
    return _Fit(misfit, np.asarray(found.x, dtype=np.float64), 2 * float(found.cost))


def _estimate(fit: _Fit, prior: LogModel | None, settings: FitSettings) -> ModelEstimate:
    """Covariance, compression for the Kalman filter, and the verdict on identifiability."""
    misfit = fit.misfit
    r = misfit.residuals(fit.p)
    inflation = _inflation(r[:-1], len(fit.p))
    information, score = _compress(misfit, fit.p, inflation)
    precision = information.T @ information + (0.0 if prior is None else np.linalg.inv(prior.p))
    x = fit.p[:PROCESS_PARAMETERS]
    weakest = float(np.min(np.linalg.eigvalsh(precision)))
    covariance = np.linalg.inv(precision + max(LEAST_PRECISION - weakest, 0.0) * np.eye(PROCESS_PARAMETERS))
    log = LogModel(x, proper_covariance(np.asarray(covariance, dtype=np.float64)), misfit.sign)
    residual_std = float(np.std(r[:-1])) * misfit.sigma
    identifiable, reason = _judge(log, residual_std, float(np.std(misfit.window.pv)), settings)
    loads = tuple(float(s) for s in fit.p[PROCESS_PARAMETERS:])
    return ModelEstimate(log, identifiable, reason, loads, residual_std, misfit.sigma, fit.deviance, information, score)


def _inflation(r: FloatArray, parameters: int) -> float:
    """Factor on sigma: misfit above the noise, and the information that correlated residuals do not hold."""
    dof = max(len(r) - parameters - 2, 1)
    variance = float(r @ r) / dof
    return math.sqrt(max(variance, 1.0) * _correlation(r))


def _correlation(r: FloatArray) -> float:
    """How many correlated samples count as one: (1 + rho)/(1 - rho) for a first-order autocorrelation rho >= 0."""
    rho = float(r[1:] @ r[:-1]) / max(float(r @ r), 1e-300)
    rho = min(max(rho, 0.0), LARGEST_RHO)
    return (1 + rho) / (1 - rho)


def _compress(misfit: OutputError, p: FloatArray, inflation: float) -> tuple[FloatArray, FloatArray]:
    """R (3, 3) and z (3,) with R x = z + unit noise: the linearised record, load times taken out, by QR."""
    jacobian = misfit.jacobian(p) / inflation
    r = misfit.residuals(p) / inflation
    loads = jacobian[:, PROCESS_PARAMETERS:]
    process = jacobian[:, :PROCESS_PARAMETERS]
    if loads.shape[1]:
        q, _ = np.linalg.qr(loads)
        process, r = process - q @ (q.T @ process), r - q @ (q.T @ r)
    q, triangle = qr(process, mode="economic")
    z = triangle @ p[:PROCESS_PARAMETERS] - q.T @ r
    return np.asarray(triangle, dtype=np.float64), np.asarray(z, dtype=np.float64)


def _judge(log: LogModel, residual_std: float, pv_std: float, settings: FitSettings) -> tuple[bool, str]:
    """Whether settings may follow from this estimate, and the sentence that says why."""
    model = log.model()
    explained = 1 - (residual_std / pv_std) ** 2
    if explained < settings.explained_limit:
        return False, f"the model explains {explained:.0%} of pv's variance; {settings.explained_limit:.0%} are needed"
    gain_std = log.gain_uncertainty()
    if gain_std > settings.gain_std_limit:
        return False, (
            f"the controller gain that follows is known to a factor of {_factor(gain_std)}; "
            f"{_factor(settings.gain_std_limit)} is needed: the record moves the process too little"
        )
    lag_std = math.sqrt(float(log.p[2, 2]))
    if model.theta_s < model.tau1_s < 8 * model.theta_s and lag_std > settings.lag_std_limit:
        return False, f"the lag is known to a factor of {_factor(lag_std)}; {_factor(settings.lag_std_limit)} is needed"
    return True, f"first order + dead time explains {explained:.1%} of pv's variance"


def _factor(log_std: float) -> str:
    """A standard deviation of a logarithm as the factor people think in."""
    return f"{math.exp(log_std):.2f}" if log_std < math.log(1000) else "over 1000"
