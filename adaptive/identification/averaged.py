"""The process behind averaged responses to setpoint steps to and fro, under a load of any size that never rests.

    mean(s pv) = T(G) sp + noise,    T = G C / (1 + G C)

The setpoint and the control law C are known, and the setpoint knows nothing of the load: so the loop's own response to
it is fitted (indirect identification, Van den Hof & Schrama 1993), never pv against co, which the load moves both. Then
no noise model makes the estimate wrong, it only weighs the samples. The noise is that of the stretches about their
mean: autoregressive by the equations of Yule and Walker, and known before any process is. Averages of many sequences
are fitted as one, those under other gains too. What whitened residuals are over what their noise says counts as less
information.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from retuner.adaptive.fit.structure import LAG, SECOND, SLOPE, THETA, dynamics_at, model_at
from retuner.adaptive.identification.estimate import (
    Alternative,
    LogModel,
    ModelEstimate,
    factors_text,
    proper_covariance,
)
from retuner.adaptive.identification.identify import NAMES, FitSettings, broad, left_open
from retuner.adaptive.identification.plausible import MOST_EXCESS, OUT, Plausible
from retuner.adaptive.identification.usual_dead_time import unusual, usual
from retuner.adaptive.loop.sampled import SampledLaw, setpoint_response
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.rules.simc import simc
from retuner.adaptive.signals.sample import FloatArray
from retuner.adaptive.signals.to_and_fro import Averaged

TYPES = (ProcessType.FOPDT, ProcessType.SOPDT, ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG)
STRENGTHS = (0.05, 0.15, 0.4, 1.0)
"""First guesses of kp k' t, with t the half time of the response: how strongly the loop is fed back."""
DEAD = (0.3, 0.8)
"""First guesses of the dead time over that half time."""
LAGS = (0.3, 1.0, 3.0, 10.0)
"""First guesses of the lag over the integral time."""
STARTS = 3
"""Of all first guesses so many are refined."""
STEPS = 15
"""Of a refinement at the most."""
SLOPE_STEP = 1e-3
"""Of a logarithm, for derivatives."""
DAMPING, LESS, MORE = 1e-2, 0.2, 5.0
"""First lambda, and factors on it after a step that helped, and one that did not (Marquardt 1963)."""
TRIES = 6
"""Of one step, each shorter than the one before."""
ENOUGH = 1e-3
"""A fall of the deviance that is the end."""
PRICE = 2.0
"""Of a parameter, in deviance (Akaike 1974): a lag that is left out because it hardly shows would pass for known, and
the integral time with it."""
BELIEVED = 4.0
"""Excess up to which a model counts for the integral action: two standard deviations."""
FAR = 40.0
"""Largest logarithm of a parameter."""


@dataclass(frozen=True, slots=True)
class Found:
    """One structure fitted. slopes : derivatives of the whitened residuals by x. deviance : their squares, and what is
    unusual of x.
    """

    type: ProcessType
    x: FloatArray
    residuals: FloatArray
    slopes: FloatArray
    deviance: float


class Fitting:
    """Averages with the filters of their noise, and what models say of them. sign : of the process gain."""

    def __init__(self, averages: Sequence[Averaged], sign: int, b: float, filter_s: float) -> None:
        self.averages, self.sign = averages, sign
        self._laws = [SampledLaw(one.gains, one.dt_s, b, filter_s) for one in averages]
        self._filters = [_filter(averages, one) for one in averages]

    def residuals(self, type_: ProcessType, x: FloatArray) -> FloatArray:
        """Whitened, in standard deviations of the noise; not finite where the loop would run away."""
        known: dict[SampledLaw, FloatArray] = {}
        parts = []
        with np.errstate(all="ignore"):
            for one, law, (ar, std) in zip(self.averages, self._laws, self._filters, strict=True):
                if law not in known or len(known[law]) < one.reach:
                    known[law] = self._response(type_, x, law, one.reach)
                parts.append(_whitened(np.array(one.pv) - one.said(known[law]), ar) / std)
        return np.concatenate(parts)

    def _response(self, type_: ProcessType, x: FloatArray, law: SampledLaw, n: int) -> FloatArray:
        """Of the loop to a unit step of the setpoint."""
        since = np.arange(n, dtype=np.float64) * law.dt_s - math.exp(x[THETA])
        held = self.sign * math.exp(x[SLOPE]) * dynamics_at(type_, x).step(since)
        return setpoint_response(np.asarray(held, dtype=np.float64), law)

    def deviance(self, type_: ProcessType, x: FloatArray) -> float:
        """Sum of squares with what is unusual of x; infinite where the loop would run away."""
        cost = float(np.sum(self.residuals(type_, x) ** 2)) + unusual(type_, x) ** 2
        return cost if math.isfinite(cost) else math.inf

    def starts(self, type_: ProcessType) -> Iterator[FloatArray]:
        """First guesses, by the newest average."""
        one = self.averages[-1]
        half_s = _half_time(one)
        tau_i = abs(one.gains.kp / one.gains.ki) if one.gains.ki else half_s
        for dead, strength, lag in product(DEAD, STRENGTHS, LAGS if type_ in LAG else LAGS[:1]):
            x = [math.log(strength / (abs(one.gains.kp) * half_s)), math.log(max(dead * half_s, one.dt_s / 2))]
            if type_ in LAG:
                x.append(math.log(lag * tau_i))
            if type_ in SECOND:
                x.append(x[THETA] + math.log(DEAD[0]))
            yield np.array(x)

    def best(self, type_: ProcessType) -> Found | None:
        """The best of the refined guesses; None where no loop with this structure is stable."""
        costs = [(self.deviance(type_, x), tuple(x)) for x in self.starts(type_)]
        near = sorted(cost for cost in costs if math.isfinite(cost[0]))[:STARTS]
        refined = [self._refined(type_, np.array(x), cost) for cost, x in near]
        return min(refined, key=lambda found: found.deviance, default=None)

    def _refined(self, type_: ProcessType, x: FloatArray, cost: float) -> Found:
        """Down from a start."""
        damping, here = DAMPING, self.residuals(type_, x)
        slopes = self._slopes(type_, x, here)
        for _ in range(STEPS):
            there, ahead = x, math.inf
            for _ in range(TRIES):
                there = _stepped(type_, x, here, slopes, damping)
                ahead = self.deviance(type_, there)
                if ahead < cost:
                    break
                damping *= MORE
            if not ahead < cost:
                break
            fell, x, cost, damping = cost - ahead, there, ahead, damping * LESS
            here = self.residuals(type_, x)
            slopes = self._slopes(type_, x, here)
            if fell < ENOUGH:
                break
        return Found(type_, x, here, slopes, cost)

    def _slopes(self, type_: ProcessType, x: FloatArray, here: FloatArray) -> FloatArray:
        """Of the residuals, shape (n, d). here : the residuals at x."""
        return np.stack([(self.residuals(type_, x + e) - here) / SLOPE_STEP for e in SLOPE_STEP * np.eye(len(x))], 1)


def _stepped(type_: ProcessType, x: FloatArray, here: FloatArray, slopes: FloatArray, damping: float) -> FloatArray:
    """A damped step (Levenberg 1944, Marquardt 1963)."""
    normal, gradient = slopes.T @ slopes, slopes.T @ here
    known = usual(type_, x)
    if known is not None:
        normal, gradient = normal + known.root.T @ known.root, gradient + known.root.T @ known.residuals(x)
    diagonal = np.diag(normal) + 1e-12 * max(float(np.max(np.diag(normal))), 1e-300)
    step = np.linalg.solve(normal + damping * np.diag(diagonal), -gradient)
    step /= max(float(np.max(np.abs(step))), 1.0)
    return np.asarray(np.clip(x + step, -FAR, FAR), dtype=np.float64)


def process_behind(
    averages: Sequence[Averaged], sign: int, settings: FitSettings, b: float = 1.0, filter_s: float = 0.0
) -> ModelEstimate | None:
    """What all averages say together; None where no loop explains them.

    Parameters
    ----------
    averages : one at least, the newest last. sign : of the process gain. b, filter_s : setpoint weight, and filter time
    of the derivative.
    """
    fitting = Fitting(averages, sign, b, filter_s)
    found = [one for one in map(fitting.best, TYPES) if one is not None and np.all(np.isfinite(one.slopes))]
    if not found:
        return None
    n = sum(len(one.pv) for one in averages)
    inflation = max(min(one.deviance / max(n - len(one.x), 1) for one in found), 1.0)
    ranked = sorted(found, key=lambda one: one.deviance / inflation + PRICE * len(one.x))
    alternatives = tuple(_alternative(one, sign, inflation, n) for one in ranked)
    log = alternatives[0].log
    around = tuple(_plausible(fitting, ranked, log, inflation))
    newest = averages[-1]
    noise = math.sqrt(newest.scatter[0] / len(newest.signs))
    open_ = left_open(log, around, newest.dt_s, newest.reach * newest.dt_s, settings)
    open_ = open_ or _integral_open(around, newest.dt_s, settings)
    steps = sum(len(one.signs) for one in averages)
    reason = f"{steps} setpoint steps to and fro, averaged: {open_ or NAMES[log.type]}"
    explained = 1.0 - min(noise**2 / max(float(np.var(newest.pv)), noise**2), 1.0)
    left = noise * math.sqrt(inflation)
    return ModelEstimate(not open_, reason, (), left, noise, alternatives, 0, around, explained)


def _plausible(fitting: Fitting, ranked: Sequence[Found], log: LogModel, inflation: float) -> Iterator[Plausible]:
    """The best, models along the axes of its covariance, and the other structures that come close."""
    best = ranked[0]
    yield Plausible(log.model(), 0.0)
    values, vectors = np.linalg.eigh(log.p)
    for (value, axis), side in product(zip(values, vectors.T, strict=True), (1.0, -1.0)):
        x = best.x + side * OUT * math.sqrt(max(float(value), 0.0)) * axis
        for _ in range(TRIES):
            excess = (fitting.deviance(best.type, x) - best.deviance) / inflation
            if excess <= MOST_EXCESS:
                yield Plausible(model_at(best.type, x, fitting.sign), max(excess, 0.0))
                break
            x = (x + best.x) / 2
    for one in ranked[1:]:
        fewer = max(len(best.x) - len(one.x), 0)
        excess = max((one.deviance - best.deviance) / inflation - PRICE * fewer, 0.0)
        if excess < MOST_EXCESS:
            yield Plausible(model_at(one.type, one.x, fitting.sign), excess)


def _integral_open(around: Sequence[Plausible], dt_s: float, settings: FitSettings) -> str:
    """That the models still allowed ask for integral actions too far from each other; empty where they agree.

    An average without its slow end leaves a lag open of which the gain knows nothing.
    """
    logs = [math.log(abs(simc(p.model.seen_by_controller(dt_s)).gains.ki)) for p in around if p.excess <= BELIEVED]
    spread = (max(logs) - min(logs)) / (2 * OUT)
    if spread <= settings.gain_std_limit:
        return ""
    known, needed = factors_text(spread, settings.gain_std_limit)
    return f"the integral action is uncertain by a factor of {known} (limit {needed})"


def _alternative(one: Found, sign: int, inflation: float, n: int) -> Alternative:
    """Covariance, and compression for the Kalman filter."""
    q, information = np.linalg.qr(one.slopes / math.sqrt(inflation))
    score = information @ one.x - q.T @ (one.residuals / math.sqrt(inflation))
    known = usual(one.type, one.x)
    precision = information.T @ information + broad(len(one.x))
    precision = precision if known is None else precision + known.root.T @ known.root
    covariance = proper_covariance(np.asarray(np.linalg.inv(precision), dtype=np.float64))
    return Alternative(LogModel(one.x, covariance, sign, one.type), one.deviance / inflation, information, score, n)


def _filter(averages: Sequence[Averaged], one: Averaged) -> tuple[FloatArray, float]:
    """Whitening filter of the noise in an average, by all under the same gains, and what is left of it after that."""
    same = [other for other in averages if other.gains == one.gains]
    counts = [len(other.signs) * len(other.pv) for other in same]
    scatter = np.average([other.scatter for other in same], axis=0, weights=counts)
    n, best = sum(counts), (math.inf, np.zeros(0), 1.0)
    for order in range(len(scatter)):
        lags = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
        a = np.linalg.solve(scatter[lags], -scatter[1 : order + 1]) if order else np.zeros(0)
        variance = max(float(scatter[0] + a @ scatter[1 : order + 1]), 1e-12 * float(scatter[0]))
        criterion = n * math.log(variance) + order * math.log(n)
        if criterion < best[0]:
            best = (criterion, a, variance)
    return best[1], math.sqrt(best[2] / len(one.signs))


def _whitened(values: FloatArray, ar: FloatArray) -> FloatArray:
    """Through the filter; the first values, of which the past is not known, count as nothing."""
    order = len(ar)
    found = values[order:].copy()
    for lag, a in enumerate(ar, 1):
        found += a * values[order - lag : len(values) - lag]
    return found


def _half_time(one: Averaged) -> float:
    """From the last step until half of it is done, seconds: of the average."""
    way = np.array(one.pv) / one.steps[-1]
    level = (float(np.mean(way[:3])) + 0.5) / 2
    done = np.nonzero(way > level)[0]
    return one.dt_s * max(float(done[0]) if len(done) else len(way) / 2, 2.0)
